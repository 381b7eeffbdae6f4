"""How settings declare an option of a command: as a field of a dataclass.

    out: Path = option(Path("measures.csv"), "The table.")

Options that several commands share are annotations (`options`), with a default where they stand."""

import dataclasses
from typing import Any

from typer import Option

OPTION = "option"
"""Where a field has its `typer.Option`, among its metadata."""


def option(default: Any, help: str, *flags: str, **given: Any) -> Any:
    """A field of settings that is an option.

    Parameters
    ----------
    default
        Where it is not given.
    help
        What it is.
    *flags
        How it is written, where that is not its name.
    **given
        Anything else that `typer.Option` takes.
    """
    return dataclasses.field(default=default, metadata={OPTION: Option(*flags, help=help, **given)})
