"""The public interface is documented in numpydoc's layout: every argument, what is returned, and
what is raised, in sections."""

import inspect
import re
from collections.abc import Callable

import pytest

import poseterior

PUBLIC = {
    name: getattr(poseterior, name)
    for name in poseterior.__all__
    if callable(getattr(poseterior, name))
}
FUNCTIONS = {name: one for name, one in PUBLIC.items() if inspect.isfunction(one)}
CLASSES = {
    name: one
    for name, one in PUBLIC.items()
    if inspect.isclass(one) and not issubclass(one, Exception)
}
HEADING = re.compile(r"^(\w[\w ]*)\n-+\n", re.M)
ITEM = re.compile(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : .*)?$", re.M)
INHERITED = ("tree_flatten", "tree_unflatten", "support", "sample", "log_prob")
"""What JAX and NumPyro ask of a class, under their names and with their meaning."""


def sections(docstring: str) -> dict[str, str]:
    """The text of each section by its heading."""
    parts = HEADING.split(inspect.cleandoc(docstring))
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def documented(section: str) -> list[str]:
    """The names that a section of arguments or attributes explains."""
    found = [name.strip(" *") for line in ITEM.findall(section) for name in line.split(",")]
    return [name for name in found if name]


def arguments(function: Callable) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def faults(function: Callable) -> list[str]:
    """What a function's docstring lacks."""
    text = inspect.getdoc(function) or ""
    found = sections(text)
    missing = []
    if not text:
        missing.append("a docstring")
    if documented(found.get("Parameters", "")) != arguments(function):
        missing.append(f"Parameters: {arguments(function)}")
    returns = inspect.signature(function).return_annotation
    if returns not in (None, "None") and not {"Returns", "Yields"} & set(found):
        missing.append("Returns")
    if "Raises `" in text and "Raises" not in found:
        missing.append("Raises")
    return missing


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions(name: str) -> None:
    assert faults(FUNCTIONS[name]) == []


@pytest.mark.parametrize("name", CLASSES)
def test_classes(name: str) -> None:
    """What a class is made of is explained, and every method and property that is its own."""
    kind = CLASSES[name]
    found = sections(inspect.getdoc(kind) or "")
    explained = documented(found.get("Parameters", "")) + documented(found.get("Attributes", ""))
    if not inspect.isabstract(kind):
        assert set(arguments(kind)) <= set(explained)
    members = [
        (key, inspect.unwrap(getattr(value, "__func__", getattr(value, "fget", value)) or value))
        for key, value in vars(kind).items()
        if not key.startswith("_") and key not in INHERITED
    ]
    bare = [
        key for key, one in members if callable(one) and not (inspect.getdoc(one) or "").strip()
    ]
    assert bare == []


@pytest.mark.parametrize("name", CLASSES)
def test_methods(name: str) -> None:
    """One sentence says all of a method of one argument; where there are more, or something is
    raised, there are sections."""
    for key, value in vars(CLASSES[name]).items():
        function = getattr(value, "__func__", value)
        if key.startswith("_") or key in INHERITED or not inspect.isfunction(function):
            continue
        text = inspect.getdoc(function) or ""
        if "Parameters" in sections(text) or len(arguments(function)) > 1:
            assert faults(function) == [], key
        assert "Raises `" not in text, key


def test_a_docstring_that_lacks_something_is_caught() -> None:
    def bare(one: int, other: int) -> int:
        """Adds.

        Parameters
        ----------
        one
            The first.
        """
        return one + other

    assert faults(bare) == ["Parameters: ['one', 'other']", "Returns"]
    assert faults(lambda: None) == ["a docstring", "Returns"]
