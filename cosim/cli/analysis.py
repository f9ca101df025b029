"""`flexfmu modes`, `margins` and `effects`: natural frequencies, distance from instability, and what each effect is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from flexfmu.cosim.cli.console import FAILURE, load_changed, load_resolved, prepared_folder, print_result, progress


def modes(
    scene: str,
    poses: Annotated[int, typer.Option(min=3, max=10_001)] = 11,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Natural frequencies along the path, with the motors locked, about the static equilibrium.

    Args:
        poses (N): Poses along the path: an odd number, so that the middle is one.
    """
    from flexfmu.cosim.experiment.planning import plan
    from flexfmu.cosim.reports.modes_table import modes_along_path, modes_table

    robot = load_resolved(scene, settings)
    with progress() as show:
        show("frequencies along the path", None)
        found = modes_along_path(plan(robot), poses, lambda fraction: show("frequencies along the path", fraction))
    data = {"scene": robot.name, "poses": [pose.to_dict() for pose in found]}
    print_result(json, data, *modes_table(robot.name, found))
    return 0


def margins(
    scene: str,
    poses: Annotated[int, typer.Option(min=1)] = 5,
    payload_band: str | None = None,
    out: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Gain, phase, delay and disk margins of a sampled loop, about standstill along the path.

    The worst poses along the path are searched. The loop is cut at each torque, then at both at once. Holds, delays,
    encoders, lags and several sample rates count exactly;
    rounding and limits don't count. The exit status is 1 if the loop is unstable.

    Args:
        poses (N): Equally spaced poses along the path, in addition to the worst ones; 1 for its end alone.
        payload_band (BAND): Payloads among which the worst one is searched, unknown to the controllers: 0.2 for 20 % to both
            sides, or 4,8 for 4 to 8 kg. Default: the scene's alone.
        out (DIR): Folder for margins.csv, bode.png, nyquist.png and root-locus.png. Default: no files.
    """
    from flexfmu.cosim.design.gains.robustness import band_masses, parse_band
    from flexfmu.cosim.design.margins.scene_margins import margins_data, margins_table, scene_margins, write_margins

    robot = load_changed(scene, settings)
    if out is not None:
        prepared_folder(out)
    masses = () if payload_band is None else band_masses(robot, parse_band(payload_band))
    with progress() as show:
        result = scene_margins(
            robot, poses=poses, payloads=masses, progress=lambda fraction: show("margins along the path", fraction)
        )
        files: list[Path] = []
        if out is not None:
            show("drawing", None)
            files = write_margins(result, out)
    where = [f"files: {', '.join(map(str, files))}"] if files else []
    data = {**margins_data(result), "files": [str(path) for path in files]}
    print_result(json, data, *margins_table(result), *where)
    return 0 if result.is_stable else FAILURE


def effects(
    scene: str,
    tolerance: float | None = None,
    of: list[str] | None = None,
    check: bool = False,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Choose the cheapest elastic effects within a tolerance; shows the accuracy and the cost of each.

    Args:
        tolerance (RELATIVE): Largest error. Default: the scene's, or 0.01.
        of (METRIC): A metric to hold; may be repeated. Default: the scene's, or three of them.
        check: Also run the next richer sets and compare; builds their FMUs. Default: skip.
    """
    from flexfmu.cosim.design.effects.study import comparison_table, comparisons, report, study_data, study_effects

    robot = load_changed(scene, settings)
    with progress() as show:
        study = study_effects(robot, tolerance, tuple(of or []), show)
        checked = tuple(comparisons(study, show)) if check else ()
    compared = [comparison_table(checked)] if check else []
    print_result(json, study_data(study, checked), *report(study), *compared)
    return 0
