"""The command line: wires only. What each command can be asked for stands in `settings`; the
commands have a file each in `commands`, imported when they are called."""

import copy
import dataclasses
import gc
import inspect
import sys
from collections.abc import Iterator
from importlib import import_module, metadata
from typing import Annotated, Any, NoReturn, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

from poseterior.reports import console, options, settings, signals
from poseterior.reports.fields import OPTION
from poseterior.reports.options import Screen

COMMANDS: dict[str, type] = {
    "demo": settings.DemoSettings,
    "hypotheses": settings.HypothesesSettings,
    "sample": settings.SampleSettings,
    "frames": settings.FramesSettings,
    "film": settings.FilmSettings,
    "show": settings.ShowSettings,
    "detect": settings.DetectSettings,
    "measure": settings.MeasureSettings,
    "export": settings.ExportSettings,
    "prior": settings.PriorSettings,
    "check": settings.CheckSettings,
    "compare": settings.CompareSettings,
    "benchmark list": settings.BenchmarkListSettings,
    "benchmark draws": settings.BenchmarkDrawsSettings,
    "benchmark judge": settings.BenchmarkJudgeSettings,
    "evaluate": settings.EvaluateSettings,
    "coverage": settings.CoverageSettings,
    "coverage judge": settings.CoverageJudgeSettings,
    "learn": settings.LearnSettings,
    "calibrate": settings.CalibrateSettings,
}
app = typer.Typer(
    name="poseterior",
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="Exit codes: 2 bad input, 3 a sampler that could not make what was asked for, 1 a bug.",
)


COMMAND_GROUPS = {
    "benchmark": typer.Typer(help="Frozen targets with exact draws, for those who build samplers."),
    "coverage": typer.Typer(invoke_without_command=True, subcommand_metavar="[judge …]"),
}
"""Commands that have commands of their own; those in `COMMANDS` do something by themselves too."""
for _name, _group in COMMAND_GROUPS.items():
    app.add_typer(_group, name=_name)


def command() -> NoReturn:
    """The process of the `poseterior` command."""
    # Where xarray finds Dask it imports all of it, for arrays that nothing here has.
    sys.modules.setdefault("dask", None)  # type: ignore[arg-type]
    try:
        main()
    except SystemExit as end:
        signals.depart(int(end.code or 0))
    raise AssertionError("commands end by an exit code")


def main() -> None:
    """The `poseterior` command; ends by `SystemExit`."""
    # Imports and compilers make millions of objects that live to the end: Python's own rhythm of
    # looking through them all takes a twentieth of a short run.
    gc.set_threshold(100_000, 20, 50)
    console.guarded(app)


def _show_version(wanted: bool) -> None:
    if wanted:
        console.say(f"poseterior {metadata.version('poseterior')}")
        raise typer.Exit


@app.callback()
def _about(
    version: Annotated[
        bool,
        typer.Option(
            "--version", "-v", callback=_show_version, is_eager=True, help="Say the version."
        ),
    ] = False,
) -> None:
    """Posteriors over human 3D pose given 2D joint detections: weighted draws, and exact ones by
    rejection."""


def declared(group: Any, given: object = None) -> Iterator[inspect.Parameter]:
    """The options of a settings class, its groups' among them, as typer wants to see them.

    Parameters
    ----------
    group
        A dataclass whose fields are annotated options, arguments, or such classes again.
    given
        An instance whose values are the defaults, instead of the class's own.
    """
    hints = get_type_hints(group, include_extras=True)
    for field in dataclasses.fields(group):
        default = field.default if given is None else getattr(given, field.name)
        hint = hints[field.name]
        if dataclasses.is_dataclass(hint):
            yield from declared(hint, None if default is dataclasses.MISSING else default)
            continue
        shared = get_origin(hint) is Annotated
        option = copy.copy(hint.__metadata__[0] if shared else field.metadata[OPTION])
        if isinstance(option, OptionInfo) and hasattr(group, "PANEL"):
            option.rich_help_panel = group.PANEL
        yield inspect.Parameter(
            field.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=inspect.Parameter.empty if default is dataclasses.MISSING else default,
            annotation=Annotated[hint.__origin__ if shared else hint, option],
        )


def built[T](group: type[T], values: dict[str, Any]) -> T:
    """Settings, with their groups, from the values of their options."""
    hints = get_type_hints(group)
    return group(
        **{
            field.name: built(hints[field.name], values)
            if dataclasses.is_dataclass(hints[field.name])
            else values[field.name]
            for field in dataclasses.fields(group)  # type: ignore[arg-type]
        }
    )


def _register(name: str, kind: Any) -> None:
    """Makes a command of a settings class; `commands.NAME.run(settings, screen)` does its work,
    where a command of a group has `GROUP.NAME` for a name."""
    group, _, own = name.rpartition(" ")

    def command(context: typer.Context, **values: Any) -> None:
        if context.invoked_subcommand:
            return
        options.prepare_jax()
        wanted: Any = built(kind, values)
        options.require_meaning(wanted, {word for word in values if _typed(context, word)})
        options.require_other_files(values)
        screen = built(Screen, values)
        with console.progress("reading", screen.quiet):
            options.check(wanted)
        if root := getattr(wanted, "drawn", None):
            _compile_ahead(root, screen)
        import_module(f"poseterior.reports.commands.{name.replace(' ', '.')}").run(wanted, screen)

    parameters = [*declared(kind), *declared(Screen)]
    command.__name__ = own
    command.__annotations__ = {one.name: one.annotation for one in parameters}
    command.__annotations__["context"] = typer.Context
    first = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    command.__signature__ = inspect.Signature([first, *parameters])  # type: ignore[attr-defined]
    paragraphs = (inspect.getdoc(kind) or "").split("\n\n")
    about = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    examples = "\n\n".join(f"  poseterior {line}" for line in kind.EXAMPLES)
    home = COMMAND_GROUPS[group] if group else app
    texts: dict[str, Any] = {"help": about, "epilog": f"Examples:\n\n{examples}"}
    if name in COMMAND_GROUPS:
        COMMAND_GROUPS[name].callback(**texts)(command)
    else:
        home.command(own, **texts)(command)


def _compile_ahead(root: str, screen: Screen) -> None:
    """Begins to compile what draws under this kind of root need and this machine has never
    compiled, and says so."""
    from poseterior.inference.exact import warm_up

    if warm_up.missing(root) and not screen.quiet:
        console.warn(
            "compiling the sampling loops, once: this call takes some fifteen seconds longer than"
            " the next one"
        )
    warm_up.begin(root)


def _typed(context: typer.Context, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name in ("COMMANDLINE", "DEFAULT_MAP")


for _name, _kind in COMMANDS.items():
    _register(_name, _kind)
