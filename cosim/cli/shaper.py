"""`flexfmu shaper`: design input shapers for a scene, try them all in co-simulation, and recommend one."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from flexfmu.cosim.cli.console import FAILURE, load_resolved, print_rich, print_text, progress, show_note
from flexfmu.cosim.cli.result_files import usual_folder
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.reports.text import to_json


def shaper(
    scene: str,
    out: Path | None = None,
    payload_errors: bool = False,
    payload_band: float = 0.3,
    drive: Literal["perfect", "controller"] | None = None,
    max_deviation: float | None = None,
    max_added_time: float | None = None,
    max_jerk: float | None = None,
    max_torque: float | None = None,
    output: Path | None = None,
    settings: list[str] | None = None,
    json: bool = False,
) -> int:
    """Design input shapers for a scene, try them all in co-simulation and recommend one, with the TOML that applies it.

    Writes shapers.json, shapers.csv and the picture: sensitivity, and the vibration before and after.

    Args:
        out (DIR): Folder of the results. Default: results/<name of the scene>.
        payload_errors: Seven payload errors instead of five; writes payload_errors.md too. Default: five.
        payload_band (FRACTION): Largest error of the payload's mass, either way.
        drive: What drives the robot: exactly its references, or the scene's controllers and imperfections. Default: the
            controllers where the scene has some.
        max_deviation (METRES): Largest deviation from the path. Default: no limit.
        max_added_time (SECONDS): Longest time that the shaper may add. Default: no limit.
        max_jerk (RAD/S3): Largest jerk of a joint reference. Default: no limit.
        max_torque (N.M): Largest torque of a motor over the payload band. Default: no limit.
        output (--output, -o FILE.toml): Write the scene with the recommended shaper here. Default: nowhere.
    """
    from flexfmu.cosim.design.shapers.examination import COARSE, FINE, examine, report, study_data
    from flexfmu.cosim.design.shapers.figure import save_sensitivity
    from flexfmu.cosim.design.shapers.recommendation import write_shaped
    from flexfmu.cosim.design.shapers.table import markdown, to_csv
    from flexfmu.model.scene.keys import parse_setting

    # usage
    if not 0.0 <= payload_band < 1.0:
        raise InputError(f"--payload-band must be at least 0 and below 1 (0.3 is 30 %), got {payload_band:g}")
    given = {"deviation": max_deviation, "added_time": max_added_time, "jerk": max_jerk, "torque": max_torque}
    limits = {name: limit for name, limit in given.items() if limit is not None}
    for name, limit in limits.items():
        if not 0.0 <= limit < float("inf"):
            raise InputError(f"--max-{name.replace('_', '-')} must be a number from 0 on, got {limit:g}")
    # design, simulate, and write
    robot = load_resolved(scene, settings)
    folder = OutputFolder(out or usual_folder(robot.name, settings))
    folder.prepare()
    with progress() as show:
        study = examine(robot, payload_band, FINE if payload_errors else COARSE, show, drive, limits)
        show("writing the results", None)
        text = to_json(study_data(study))
        folder.write("shapers.json", text)
        folder.write("shapers.csv", to_csv(study.results))
        if payload_errors:
            folder.write("payload_errors.md", markdown(f"Input shapers on {robot.name}", study.results))
        save_sensitivity(study, folder.path)
    # the shaped scene, and standard output
    if output is not None and study.recommendation.keeps_limits:
        write_shaped(
            scene, study.recommendation.result.candidate.section, output, dict(map(parse_setting, settings or ()))
        )
    if json:
        print_text(text)
    else:
        print_rich(*report(study, folder.path, output))
    # nothing keeps the limits
    if not study.recommendation.keeps_limits:
        show_note(study.recommendation.reason + (f"; {output} is not written" if output is not None else ""))
        return FAILURE
    return 0
