"""Arguments and options that several commands share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.run_options import RUN_OPTIONS

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming


def option(metavar: str, help: str, *names: str, min: float | None = None, max: float | None = None) -> Any:
    """An option with a value: what it takes, what it is for with its default, and its names where it isn't called like its argument."""
    return typer.Option(*names, metavar=metavar, help=help, min=min, max=max)


def flag(help: str, *names: str) -> Any:
    """An option without a value, or with one of a few words that its type names."""
    return typer.Option(*names, help=help)


def folder_option(ending: str = "") -> Any:
    """The folder of a command's results."""
    return option("DIR", f"Folder of the results. Default: results/<name of the scene>{ending}.")


def run_option(name: str, *names: str) -> Any:
    """The option of a run that `flexfmu.cosim.experiment.run_options` describes."""
    described = RUN_OPTIONS[name]
    return option(described.takes, described.help, *names) if described.takes else flag(described.help, *names)


_SCENE = typer.Argument(
    metavar="SCENE",
    help="A scene file (TOML), or the name of a shipped scene: barnard2012-6kg, barnard2012-0.1kg.",
    show_default=False,
)
SceneArgument = Annotated[str, _SCENE]
OptionalScene = Annotated[str | None, _SCENE]
NamingOption = Annotated[
    str, option("CONVENTION", "structured (link11.bending[1]) or flat (link11_bending_1), for tools that need it.")
]
PlatformOption = Annotated[
    list[str] | None,
    option(
        "NAME", "linux64, win64, darwin64, aarch64-linux or aarch64-darwin; may be repeated. Default: this machine's."
    ),
]
ProcessesOption = Annotated[
    int | None, option("N", "Processes. Default: one for each processor.", "-j", "--processes", min=1)
]
SetOption = Annotated[
    list[str] | None,
    option(
        "KEY=VALUE",
        "Change a key of the scene: payload.mass=3, trajectory.profile.kind=poly5, controller[0].derivative=120, "
        "controller.pd.derivative=120, effects.gravity=[0,0]; may be repeated. Without --out the results have a folder of their own, named after the changes. Default: the scene as it is.",
        "--set",
    ),
]
JsonOption = Annotated[bool, flag("Print the result as JSON and nothing else. Default: text.", "--json")]


def naming_convention(name: str) -> Naming:
    """What `NamingOption` stands for.

    Raises:
        InputError: there is no such naming convention.
    """
    from flexfmu.fmu_build.naming import NAMINGS

    if name not in NAMINGS:
        raise InputError(f"unknown naming convention {name!r}; choose from {', '.join(NAMINGS)}")
    return NAMINGS[name]
