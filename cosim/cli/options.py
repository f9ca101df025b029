"""Arguments and options of commands, as their docstrings describe them.

A parameter of a command is an option, one without a default an argument. The section Args of the docstring has its help with its
default, and in brackets what it takes, behind its names where it isn't called like the parameter: `output (-o, --output FILE.toml): ...`.
`SHARED` describes those that several commands have.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from inspect import Parameter, Signature, getdoc, signature
from typing import Annotated, Any, get_type_hints

import typer

SHARED = """
    scene (SCENE): A scene file (TOML), or the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg, starter.
    naming (CONVENTION): structured (link11.bending[1]) or flat (link11_bending_1), for tools that need it.
    fmi (VERSION): Version of the standard: 2 for FMI 2.0, 3 for FMI 3.0.
    platform (NAME): linux64, win64, darwin64, aarch64-linux or aarch64-darwin; may be repeated. wasm32, by itself, gives a WebAssembly
        module for pages and Node. Default: this machine's.
    processes (-j, --processes N): Processes. Default: one for each processor.
    sandbox: Run what files bring without network and with the right to write into the folder of the results alone, within limits of
        memory, files and processes (Linux). Default: with your rights.
    settings (--set KEY=VALUE): Change a key of the scene: payload.mass=3, trajectory.profile.kind=poly5,
        controller[0].derivative=120, controller.pd.derivative=120, effects.gravity=[0,0]; may be repeated. Where results
        have a folder by default, its name has the changes. Default: the scene as it is.
    json: Print the result as JSON and nothing else. Default: text.
"""

OptionalScene = Annotated[str | None, typer.Argument()]
ProcessesOption = Annotated[int | None, typer.Option(min=1)]

_ENTRY = re.compile(r"^    (\w+)(?: \((.*?)\))?: (.+(?:\n     .*)*)", re.MULTILINE)
"""Name, what is in brackets, and help of a parameter."""


def help_and_signature(command: Callable[..., int]) -> tuple[str, Signature]:
    """The help text of a command, and its parameters as typer takes them."""
    text, _, section = (getdoc(command) or "").partition("\n\nArgs:\n")
    described = {name: (taken, " ".join(help.split())) for name, taken, help in _ENTRY.findall(SHARED + section)}
    hints = get_type_hints(command, include_extras=True)
    parameters = signature(command).parameters.values()
    return text, Signature(
        [each.replace(annotation=_annotated(each, hints[each.name], described)) for each in parameters]
    )


def _annotated(parameter: Parameter, kind: Any, described: dict[str, tuple[str, str]]) -> Any:
    """The type of a parameter, annotated with its argument or option; what its annotation has already stays, a least value for example."""
    kind, shown = (kind.__origin__, kind.__metadata__[0]) if hasattr(kind, "__metadata__") else (kind, None)
    if parameter.name in described:
        taken, shown_help = described[parameter.name]
        if shown is None:
            shown = typer.Argument() if parameter.default is Parameter.empty else typer.Option()
        *names, metavar = taken.replace(",", "").split(" ")
        shown.help, shown.metavar = shown_help, metavar or None
        if isinstance(shown, typer.models.ArgumentInfo):
            shown.show_default = False
        elif names:
            shown.param_decls = names
        elif kind is bool and parameter.default is False:
            # what is off by default has no name that switches it off
            shown.param_decls = [f"--{parameter.name.replace('_', '-')}"]
    annotated: Any = Annotated
    return annotated[kind, shown]
