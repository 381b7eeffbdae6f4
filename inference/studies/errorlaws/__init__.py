"""A detector's error law, learned from detections whose truth is known (docs/model.md § 10).

found = learn(pairs_of_data(read_data_set("h36m/", detections="cpn_ft_h36m_dbb")))
found = learn(pairs_of_session(read_session("S01/")))
found.errors.write("errors.json")
"""

from poseterior.inference.studies.errorlaws.judge import shares_within
from poseterior.inference.studies.errorlaws.learn import Learned, learn
from poseterior.inference.studies.errorlaws.pairs import Pairs, pairs_of_data, pairs_of_session
from poseterior.inference.studies.errorlaws.times import ErrorTimes, error_times, times_of_session

__all__ = [
    "ErrorTimes",
    "Learned",
    "Pairs",
    "error_times",
    "learn",
    "pairs_of_data",
    "pairs_of_session",
    "shares_within",
    "times_of_session",
]
