"""Writes reports/oracle.md: every row of `tests/inference/test_oracle.py`, in standard errors.

python -m tests.oracle_page
"""

import datetime
import subprocess
import time
from pathlib import Path

import numpy as np

from poseterior.probmodel.errors.laws import Student
from poseterior.probmodel.files import replacing
from poseterior.reports.pages.page import in_doubles
from poseterior.reports.tables import Sheet, sheet_of
from tests import oracle
from tests.inference import test_oracle as table

PAGE = Path(__file__).parents[1] / "reports" / "oracle.md"
WORDS = """# Every sampler against brute force

`tests/oracle.py` computes posteriors of small cases by the plainest route: limbs from the
prior, roots from a wide proposal, weights by formulas that are written out there once more. It
imports NumPy and SciPy, and nothing of the product. Two shoulders, two hips and one arm are
seen, by unequal scores; three torsos are in the dictionary. Here every error law is held
against it under every route and prior of the root: log evidence, means and deviations of
{quantities}, and probabilities ({flags}), {compared} numbers a row.

All differences are in standard errors of both sides together. All {rows} rows together raise a
false alarm in one run of a thousand: the limit is {limit:.1f} for each number. *Scale × s*, a
prior with one factor of the scale too much, and *wider spread*, a law that is 5 % too wide
(under a lens, where the evidence says less of it, 20 %), are the evidence of the same draws
against that of a wrong oracle, and must lie beyond {caught:.1f}, which by chance is one case of
ten thousand.

{sheet}

*Error*: standard error of the log evidence, oracle and draws together. The controls are
computed where there are no faults. Under fixed candidates there are no lens, no faults and no
belief about the upright, and no scale.

A fault of the kind that was once shipped, limbs and torsos under a Student's law left as its
Gaussian envelope proposes them, puts the evidence of the row "{planted_row}" {planted:.0f}
standard errors off, and the worst of the other numbers {planted_moments:.0f}.

Made in one run of commit {commit} on {day}, {minutes:.0f} minutes on a shared machine; `make
test-all` holds every third of these rows to the limit, `make sweeps` the others.
"""


def row_of(row: table.Row) -> tuple[str, ...]:
    """Its cells."""
    draws = table.drawn(row)
    truth = table.known(row.root, row.lens)[table.same(row), ""]
    found = table.apart(row, draws)
    cells = [
        str(row),
        f"{len(draws.joints):,}",
        f"{np.hypot(draws.log_evidence_se, truth.log_evidence_se):.3f}",
        f"{found[0]:.1f}".replace("-", "−"),
        f"{np.abs(found[1:]).max():.1f}",
    ]
    for control in table.CONTROLS:
        if row.faults != "none" or (row.root == table.CANDIDATES and control == "scale × s"):
            cells.append("")
        else:
            cells.append(f"{abs(table.apart(row, draws, control)[0]):.1f}")
    print(*cells, sep=" | ", flush=True)
    return tuple(cells)


def planted_fault(row: table.Row) -> np.ndarray:
    """What is seen of a law that is taken for its envelope."""
    Student.exact = True  # type: ignore[misc]
    try:
        return np.abs(table.apart(row, table.ask(row)))
    finally:
        Student.exact = False  # type: ignore[misc]


def main() -> None:
    """Runs the table and writes the page."""
    in_doubles()
    start = time.monotonic()
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()
    head = ("row", "draws", "error", "evidence", "worst other", *table.CONTROLS)
    sheet: Sheet = sheet_of(head, [row_of(row) for row in table.ROWS])
    planted_row = next(
        row for row in table.ROWS if row.law == "student" and row.route == table.ROOTED[0]
    )
    planted = planted_fault(planted_row)
    text = WORDS.format(
        quantities=", ".join(oracle.NAMES),
        flags=", ".join(oracle.FLAGS),
        compared=table.COMPARED,
        rows=len(table.ROWS),
        limit=table.LIMIT,
        caught=table.CAUGHT,
        sheet=sheet.markdown(),
        planted_row=planted_row,
        planted=planted[0],
        planted_moments=planted[1:].max(),
        commit=commit,
        day=datetime.date.today().isoformat(),
        minutes=(time.monotonic() - start) / 60,
    )
    with replacing(PAGE) as partial:
        partial.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
