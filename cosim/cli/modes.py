"""`flexfmu modes`: natural frequencies along the path."""

from __future__ import annotations

from rich.table import Column
from rich.text import Text

from flexfmu.cosim.cli.console import load_resolved, print_rich, print_text, progress
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.reports.modes_table import ModalPose, modes_along_path
from flexfmu.cosim.reports.text import titled_table, to_json

SHOWN_FREQUENCIES = 6
"""Columns of frequencies in the table; all of them are in the JSON."""


def modes_command(source: str, count: int, as_json: bool) -> int:
    """Compute and print the frequencies along a scene's path; the exit status."""
    scene = load_resolved(source)
    with progress() as show:
        show("frequencies along the path", None)
        poses = modes_along_path(plan(scene), count, lambda fraction: show("frequencies along the path", fraction))
    if as_json:
        print_text(to_json({"scene": scene.name, "poses": [pose.to_dict() for pose in poses]}))
    else:
        _print_table(scene.name, poses)
    return 0


def _print_table(name: str, poses: list[ModalPose]) -> None:
    total = len(poses[0].frequencies)
    shown = min(total, SHOWN_FREQUENCIES)
    headings = "s", "x [m]", "y [m]", "q11 [rad]", "q21 [rad]", *(f"f{k}" for k in range(1, shown + 1))
    table = titled_table(
        f"{name}: natural frequencies [Hz], motors locked, about the static equilibrium",
        *(Column(heading, justify="right", no_wrap=True) for heading in headings),
    )
    for pose in poses:
        place = (_signed(value) for value in (pose.x, pose.y, pose.q11, pose.q21))
        table.add_row(f"{pose.s:.3f}", *place, *(f"{f:.2f}" for f in pose.frequencies[:shown]))
    notes = []
    if total == 0:
        notes = ["All links are rigid: there are no natural frequencies."]
    elif total > shown:
        notes = [f"The lowest {shown} of {total}; --json prints all of them."]
    print_rich(table, *(Text(note, style="italic") for note in notes))


def _signed(value: float) -> str:
    """Four decimals without a negative zero."""
    return f"{round(value, 4) + 0.0:.4f}"
