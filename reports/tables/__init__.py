"""What is shown as a table: one file a subject, one kind of table (`sheet.Sheet`).

Here are the tables of one person's posterior; those of studies are in `comparison`, `coverage`,
`evaluation` and `bias`.
"""

from reports.tables.check import broken_table, check_json, check_table
from reports.tables.detection import people_table, reading_table
from reports.tables.frames import stream_json, stream_lines, stream_table
from reports.tables.posterior import (
    MILLIMETRES,
    candidates_table,
    heaviest,
    hypotheses_table,
    posterior_table,
    summary_json,
    summary_lines,
    values,
)
from reports.tables.sheet import Column, Sheet, sheet_of
from reports.tables.words import facing_words, pose_facing, spoken

__all__ = [
    "MILLIMETRES",
    "Column",
    "Sheet",
    "broken_table",
    "candidates_table",
    "check_json",
    "check_table",
    "facing_words",
    "heaviest",
    "hypotheses_table",
    "people_table",
    "pose_facing",
    "posterior_table",
    "reading_table",
    "sheet_of",
    "spoken",
    "stream_json",
    "stream_lines",
    "stream_table",
    "summary_json",
    "summary_lines",
    "values",
]
