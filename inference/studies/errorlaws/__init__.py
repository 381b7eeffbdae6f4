"""A detector's error law, learned from detections whose truth is known (docs/model.md § 10).

found = learn(pairs_of_data(read_data_set("h36m/", detections="cpn_ft_h36m_dbb")))
found = learn(pairs_of_session(read_session("S01/")))
found.errors.write("errors.json")
"""

from poseterior.inference.studies.errorlaws.definitions import (
    Definitions,
    definitions_of_data,
    definitions_of_session,
    seen_offsets,
)
from poseterior.inference.studies.errorlaws.judge import shares_within
from poseterior.inference.studies.errorlaws.learn import Learned, learn
from poseterior.inference.studies.errorlaws.pairs import Pairs, pairs_of_data, pairs_of_session
from poseterior.inference.studies.errorlaws.times import error_times, times_of_session

__all__ = [
    "Definitions",
    "Learned",
    "Pairs",
    "definitions_of_data",
    "definitions_of_session",
    "error_times",
    "learn",
    "pairs_of_data",
    "pairs_of_session",
    "seen_offsets",
    "shares_within",
    "times_of_session",
]
