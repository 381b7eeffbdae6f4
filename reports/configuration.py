"""A file of options, for commands with many of them.

    # options.toml
    num-samples = 1000
    root = "fixed"
    composed = true

    poseterior hypotheses frame.json --config options.toml

Keys are the names of options without their dashes; what is on the command line wins. What a file
says is checked as if it had been typed."""

import tomllib
from pathlib import Path
from typing import Any

import typer

from poseterior.probmodel.failures import BadInput

LARGEST = 1 << 16
"""Bytes of a file; no command has so many options."""
NOT_HERE = {"config", "help"}


def take(context: typer.Context, path: Path | None) -> Path | None:
    """Makes what a file says the defaults of a command, before its other options are read. Raises
    `BadInput` on a file that is not one, and on keys and values that the command has not."""
    if path is not None:
        context.default_map = _defaults(context, path)
    return path


def _defaults(context: typer.Context, path: Path) -> dict[str, Any]:
    """Texts, as they would have been typed, and switches, by the names of parameters."""
    options = {
        spelt.removeprefix("--"): one
        for one in context.command.params
        for spelt in one.opts
        if spelt.startswith("--")
    }
    known = sorted(options.keys() - NOT_HERE)
    found = {}
    for key, value in _table(path).items():
        if key not in known:
            raise BadInput(
                f"{path} has the key {key!r}, but `{context.command_path}` has no such option;"
                f" choose from {', '.join(known)}"
            )
        found[str(options[key].name)] = _typed(options[key], value, f"{key} in {path}")
    return found


def _table(path: Path) -> dict[str, Any]:
    from poseterior.probmodel.files import read_bytes

    data = read_bytes(path, "file of options", "give a TOML file", largest=LARGEST)
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{path} is not TOML ({error}); write lines such as seed = 1") from None


def _typed(option: Any, value: object, where: str) -> str | bool:
    """A value as the command line would have it. Raises `BadInput` where it could not."""
    if getattr(option, "is_flag", False):
        if isinstance(value, bool):
            return value
        raise BadInput(f"{where} is a switch; give true or false")
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise BadInput(f"{where} must be a number or a text in quotes")
    return str(value)
