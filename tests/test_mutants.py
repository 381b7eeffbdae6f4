"""The faults of `make mutants` as data: each applies to the tree as it is, and the tests that must
notice it are there. Whether they do notice, `make mutants` says."""

from pathlib import Path

from tests.mutants import Fault, problems, read_faults

HERE = "tests/test_mutants.py::test_every_fault_applies_and_names_tests_that_exist"
GOOD = Fault("good", "why", "a.py", "x = 1", "x = 2", [HERE])


def test_every_fault_applies_and_names_tests_that_exist() -> None:
    faults = read_faults()
    assert len(faults) >= 60
    assert list(problems(faults)) == []


def test_faults_that_say_nothing_are_found_out(tmp_path: Path) -> None:
    """Old texts that occur never or twice, new ones that are the old or no Python, tests that do
    not exist, slow ones that are not called slow."""
    (tmp_path / "tests").mkdir()
    (tmp_path / "a.py").write_text("x = 1\ny = 3\nz = 3\n")
    (tmp_path / "tests" / "test_mutants.py").write_text(
        "import pytest\n\n\n@pytest.mark.slow\ndef test_slow():\n    pass\n\n\n"
        f"def {HERE.partition('::')[2]}():\n    pass\n"
    )
    wrong = {
        "good: its old text occurs 0 times in a.py": GOOD._replace(old="x = 7"),
        "good: its old text occurs 2 times in a.py": GOOD._replace(old=" = 3"),
        "good: its new text is the old one": GOOD._replace(new="x = 1"),
        "invalid syntax": GOOD._replace(new="x = = 2"),
        "good: a test that it names does not exist": GOOD._replace(tests=[HERE, HERE + "s"]),
        "good: slow must be true": GOOD._replace(tests=["tests/test_mutants.py::test_slow"]),
        "good: slow must be false": GOOD._replace(slow=True),
    }
    assert list(problems([GOOD], tmp_path)) == []
    assert len(list(problems([GOOD._replace(tests=[])], tmp_path))) == 1
    assert len(list(problems([GOOD, GOOD], tmp_path))) == 1
    for sentence, fault in wrong.items():
        (said,) = problems([fault], tmp_path)
        assert sentence in said
