"""The command line: puts the commands together.

Each command is a function whose arguments are the options, whose docstring is the help text, and which
returns the exit status. It imports what it needs while it runs: CasADi, SciPy and Matplotlib are too slow to load for ``--help``.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

import typer

from flexfmu.cosim.cli import console
from flexfmu.cosim.cli.design import effects, identify, margins, modes, plan, response, shaper, tune
from flexfmu.cosim.cli.export import build, cache, export, fmus, validate, wrap
from flexfmu.cosim.cli.options import help_and_signature
from flexfmu.cosim.cli.run import run
from flexfmu.cosim.cli.scenes import new, scenes, schema
from flexfmu.cosim.cli.studies import compare, paper, sweep, workprec

app = typer.Typer(
    name="flexfmu",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    # plain help: loading rich's would take as long as all the rest
    rich_markup_mode=None,
    # a default for --help: to check one that isn't given, typer would load pydantic
    context_settings={"help_option_names": ["-h", "--help"], "default_map": {"help": False}},
    epilog="Exit status: 0 done, 1 it ran and failed, 2 wrong usage or input, 129, 131, 143 ended by SIGHUP, SIGQUIT, SIGTERM. Results go to "
    "standard output, progress to standard error.",
)


WITHOUT_SCIPY = (new, scenes, schema, cache, validate)
"""Commands that do with less memory than the others."""


def main() -> None:
    """Entry point of the command ``flexfmu``."""
    gc.disable()  # until the command's modules are loaded, see `end_loading`
    # no search of all installed packages for plugins of pydantic
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    if not console.has_descriptors():
        console.show_note("too few files can be opened: close some, or raise the limit (ulimit -n)")
        sys.exit(console.FAILURE)
    console.keep_stdout()
    try:
        with console.orderly_termination():
            app()
    except OSError as error:  # a help text that can't be written; the commands catch their own
        console.abandon_stdout()
        console.show_note(f"can't write to standard output: {error.strerror or error}")
        sys.exit(console.FAILURE)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        with console.one_line_errors():
            console.print_text(f"flexfmu {version('flexfmu')}\n")
        raise typer.Exit


@app.callback()
def _flexfmu(
    show_version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Build the model of a flexible five-bar robot as an FMU, and co-simulate pick-and-place motions with it."""


def _reporting(command: Callable[..., int]) -> Callable[..., None]:
    """The command for typer: it ends with the exit status that the function returns, or with the one of its error."""

    @wraps(command)
    def run_command(**arguments: Any) -> None:
        if command is not run:  # which loads most and ends it itself
            console.end_loading()
        with console.one_line_errors():
            if command not in WITHOUT_SCIPY:
                console.check_room()
            raise typer.Exit(command(**arguments))

    run_command.__doc__, parameters = help_and_signature(command)
    run_command.__annotations__ = {name: each.annotation for name, each in parameters.parameters.items()}
    run_command.__signature__ = parameters  # type: ignore[attr-defined]
    return run_command


for _command in (
    new,
    scenes,
    build,
    fmus,
    export,
    run,
    compare,
    identify,
    sweep,
    tune,
    plan,
    paper,
    modes,
    margins,
    response,
    effects,
    shaper,
    workprec,
    validate,
    wrap,
    schema,
    cache,
):
    app.command(short_help=(_command.__doc__ or "").partition("\n")[0])(_reporting(_command))
