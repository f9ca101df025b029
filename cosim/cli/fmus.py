"""`flexfmu fmus`: every slave of a scene as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from flexfmu.cosim.cli.console import load_resolved, print_rich, print_text, progress
from flexfmu.cosim.cli.options import (
    JsonOption,
    NamingOption,
    PlatformOption,
    SceneArgument,
    SetOption,
    naming_convention,
    option,
)
from flexfmu.cosim.cli.result_files import usual_folder
from flexfmu.cosim.reports.text import to_json

if TYPE_CHECKING:
    from rich.table import Table

    from flexfmu.cosim.exchange.slave_export import ExportedSystem


def fmus(
    scene: SceneArgument,
    out: Annotated[Path | None, option("DIR", "Folder of the FMUs. Default: results/<name of the scene>/fmus.")] = None,
    slave: Annotated[
        list[str] | None, option("NAME", "Name of a slave in the scene; may be repeated. Default: all of them.")
    ] = None,
    platform: PlatformOption = None,
    naming: NamingOption = "structured",
    settings: SetOption = None,
    json: JsonOption = False,
) -> int:
    """Export a scene's slaves as FMUs: robot, trajectory, controllers, shapers and imperfections.

    With --json it also lists the connections between them.
    """
    from flexfmu.cosim.exchange.slave_export import export_slaves

    # choose effects where the scene leaves them open, then export
    convention = naming_convention(naming)
    robot = load_resolved(scene, settings)
    folder = out or usual_folder(robot.name, settings) / "fmus"
    with progress() as show:
        show("building the FMU of the robot", None)
        system = export_slaves(
            robot, folder, names=slave or None, platforms=platform or None, naming=convention, progress=show
        )
    # standard output
    if json:
        print_text(to_json(_facts(system)))
    else:
        from rich.text import Text

        connected = f"connections between them: {len(system.connections)}, listed by --json"
        print_rich(_table(system), Text(f"{folder}: {len(system.slaves)} FMUs; {connected}"))
    return 0


def _facts(system: ExportedSystem) -> dict[str, object]:
    """What `--json` prints."""
    # slaves by the names that the connections refer to
    slaves = [
        {
            "name": each.name,
            "description": each.facts.description,
            "fmu": str(each.path),
            "sample_time": each.facts.sample_time,
            "offset": each.facts.offset,
            "parameters": dict(each.parameters),
        }
        for each in system.slaves
    ]
    connections = [{"from": source, "to": target} for source, target in system.connections]
    return {"slaves": slaves, "connections": connections, "step": system.step, "stop_time": system.stop_time}


def _table(system: ExportedSystem) -> Table:
    """A line for each slave."""
    from rich.text import Text

    from flexfmu.cosim.reports.terminal import titled_table

    table = titled_table("", "FMU", "what it is", "sample time", "set before the start")
    for each in system.slaves:
        sample_time = "" if each.facts.sample_time is None else f"{each.facts.sample_time:g} s"
        starts = ", ".join(f"{name} = {value}" for name, value in each.parameters.items())
        table.add_row(Text(each.path.name), Text(each.facts.description), sample_time, Text(starts))
    return table
