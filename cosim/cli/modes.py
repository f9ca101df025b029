"""`flexfmu modes`: natural frequencies along the path."""

from __future__ import annotations

from typing import Annotated

from flexfmu.cosim.cli.console import load_resolved, print_rich, print_text, progress
from flexfmu.cosim.cli.options import JsonOption, SceneArgument, SetOption, option
from flexfmu.cosim.reports.text import to_json


def modes(
    scene: SceneArgument,
    poses: Annotated[
        int, option("N", "Poses along the path: an odd number, so that the middle is one.", min=3, max=10_001)
    ] = 11,
    settings: SetOption = None,
    json: JsonOption = False,
) -> int:
    """Natural frequencies along the path, with the motors locked, about the static equilibrium."""
    from flexfmu.cosim.experiment.planning import plan
    from flexfmu.cosim.reports.modes_table import modes_along_path, modes_table

    robot = load_resolved(scene, settings)
    with progress() as show:
        show("frequencies along the path", None)
        found = modes_along_path(plan(robot), poses, lambda fraction: show("frequencies along the path", fraction))
    # standard output
    if json:
        print_text(to_json({"scene": robot.name, "poses": [pose.to_dict() for pose in found]}))
    else:
        print_rich(*modes_table(robot.name, found))
    return 0
