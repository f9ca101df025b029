"""`flexfmu fmus`: every slave of a scene as an FMU."""

from __future__ import annotations

from pathlib import Path

from rich import box
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.cli.console import load_resolved, print_rich, print_text, progress
from flexfmu.cosim.cli.fmu import naming_convention
from flexfmu.cosim.engine.files import RESULTS
from flexfmu.cosim.exchange.slave_export import ExportedSystem, export_slaves
from flexfmu.cosim.reports.text import to_json


def fmus_command(
    source: str, out: Path | None, names: list[str], platforms: list[str], naming: str, as_json: bool
) -> int:
    """Export the slaves and print where they are; the exit status.

    Raises:
        InputError: there is no such naming convention.
    """
    convention = naming_convention(naming)
    scene = load_resolved(source)
    folder = out or RESULTS / scene.name / "fmus"
    with progress() as show:
        show("building the FMU of the robot", None)
        system = export_slaves(
            scene, folder, names=names or None, platforms=platforms or None, naming=convention, progress=show
        )
    if as_json:
        print_text(to_json(_facts(system)))
    else:
        connected = f"connections between them: {len(system.connections)}, listed by --json"
        print_rich(_table(system), Text(f"{folder}: {len(system.slaves)} FMUs; {connected}"))
    return 0


def _facts(system: ExportedSystem) -> dict[str, object]:
    """What `--json` prints."""
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
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("FMU", "what it is", "sample time", "set before the start"):
        table.add_column(heading)
    for each in system.slaves:
        sample_time = "" if each.facts.sample_time is None else f"{each.facts.sample_time:g} s"
        starts = ", ".join(f"{name} = {value}" for name, value in each.parameters.items())
        table.add_row(Text(each.path.name), Text(each.facts.description), sample_time, Text(starts))
    return table
