"""`flexfmu shaper`: design input shapers for a scene, try them all in co-simulation, and recommend one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.text import Text

from flexfmu.cosim.choices.shapers.design import DesignModes, alternatives, design_modes
from flexfmu.cosim.choices.shapers.figure import Vibrations, save_sensitivity
from flexfmu.cosim.choices.shapers.recommendation import (
    Limits,
    Recommendation,
    compare_slower,
    recommend,
    shaper_toml,
    write_shaped,
)
from flexfmu.cosim.choices.shapers.study import (
    CandidateResult,
    Drive,
    candidates,
    payload_errors,
    slower,
    studied,
    study,
    vibration,
)
from flexfmu.cosim.choices.shapers.table import (
    design_data,
    markdown,
    recommendation_data,
    result_data,
    terminal_table,
    to_csv,
)
from flexfmu.cosim.cli.console import FAILURE, Step, load_resolved, print_rich, print_text, progress, show_error
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import RESULTS, OutputFolder
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.reports.text import to_json
from flexfmu.model.scene.schema import Scene

COARSE, FINE = 5, 7
"""Number of payload errors over the band. The residual vibration goes up and down with the payload, since the vibrations
of start, corners and end meet in another phase: its ends and middle alone would miss the worst."""


@dataclass(frozen=True)
class ShaperStudy:
    """Everything that was found out about a scene.

    Attributes:
        scene: what was simulated.
        design: what the shapers were designed for.
        results: unshaped motion and shapers.
        slower: the unshaped motion with the time that the recommended shaper adds; None where that adds none.
        recommendation: which shaper to take.
        left_out: shaper and what it shapes → why it can't be applied.
        vibrations: of the unshaped motion and the recommended one after their ends.
    """

    scene: Scene
    design: DesignModes
    results: Sequence[CandidateResult]
    slower: CandidateResult | None
    recommendation: Recommendation
    left_out: Mapping[str, str]
    vibrations: Vibrations


def shaper_command(
    source: str,
    out: Path | None,
    as_json: bool,
    all_errors: bool,
    band: float,
    drive: Drive | None,
    limits: Limits,
    output: Path | None,
) -> int:
    """Design, simulate, write, print; the exit status: a failure where nothing keeps the limits."""
    # usage
    if not 0.0 <= band < 1.0:
        raise InputError(f"--payload-band must be at least 0 and below 1 (0.3 is 30 %), got {band:g}")
    for name, limit in vars(limits).items():
        if limit is not None and not 0.0 <= limit < float("inf"):
            raise InputError(f"--max-{name.replace('_', '-')} must be a number from 0 on, got {limit:g}")
    # design, simulate, and write
    scene = load_resolved(source)
    folder = OutputFolder(out or RESULTS / scene.name)
    folder.prepare()
    with progress() as show:
        found = examine(scene, band, FINE if all_errors else COARSE, show, drive, limits)
        show("writing the results", None)
        text = to_json(_data(found))
        folder.write("shapers.json", text)
        folder.write("shapers.csv", to_csv(found.results))
        if all_errors:
            folder.write("payload_errors.md", markdown(f"Input shapers on {scene.name}", found.results))
        chosen, band = found.recommendation.result, scene.cosimulation.settling_band
        save_sensitivity(found.results, found.design, chosen, band, found.vibrations, folder.path)
    # the shaped scene, and standard output
    if output is not None and found.recommendation.keeps_limits:
        write_shaped(source, chosen.candidate.section, output)
    if as_json:
        print_text(text)
    else:
        _print(found, folder.path, output)
    if not found.recommendation.keeps_limits:
        show_error(found.recommendation.reason + (f"; {output} is not written" if output is not None else ""))
        return FAILURE
    return 0


def examine(
    scene: Scene, band: float, count: int, show: Step, drive: Drive | None = None, limits: Limits | None = None
) -> ShaperStudy:
    """Design shapers for a scene and co-simulate them.

    Args:
        scene: the scene.
        band: largest relative error of the payload's mass.
        count: number of payload errors, odd.
        show: called with what is being done and the finished fraction.
        drive: what drives the robot, see `studied`.
        limits: what the recommended motion must not exceed.

    Raises:
        InputError: nothing vibrates, or there is no controller.
        CosimError: a simulation failed.
    """
    show("looking at the modes along the path", None)
    # shapers for the modes at the end pose and over the payload band
    errors = payload_errors(scene, band, count)
    design = design_modes(plan(scene), errors)
    scene = studied(scene, design.modes[0].frequency, drive)
    motion = plan(scene)
    tried, left_out = candidates(motion, alternatives(design))
    fmu_path = build_scene(scene).path

    def simulating(fraction: float) -> None:
        show("simulating", fraction)

    # the best one beside an unshaped motion that is slower by the same time
    results = list(study(tried, errors, motion.duration, fmu_path, simulating))
    recommendation = recommend(results, scene.cosimulation.settling_band, limits)
    chosen = recommendation.result
    added = chosen.added_time
    compared = next(study([slower(motion, added)], errors, motion.duration, fmu_path)) if added > 0.0 else None
    shown = {each.candidate.label: vibration(each.candidate, fmu_path) for each in (results[0], chosen)}
    return ShaperStudy(scene, design, results, compared, recommendation, left_out, shown)


def _data(found: ShaperStudy) -> dict[str, Any]:
    """The study as plain data."""
    return {
        "scene": found.scene.name,
        "design": design_data(found.design),
        "alternatives": [result_data(result) for result in found.results],
        "slower": None if found.slower is None else result_data(found.slower),
        "left_out": dict(found.left_out),
        "recommendation": recommendation_data(found.recommendation),
    }


def _print(found: ShaperStudy, folder: Path, output: Path | None) -> None:
    recommended = found.recommendation.result
    lines = []
    if found.recommendation.keeps_limits:
        lines.append(f"Recommended: {recommended.candidate.label}: {found.recommendation.reason}.")
    if found.slower is not None:
        lines.append(compare_slower(recommended, found.slower, found.scene.cosimulation.settling_band) + ".")
    lines += [f"Left out: {what}: {why}." for what, why in found.left_out.items()]
    if toml := found.recommendation.keeps_limits and shaper_toml(recommended.candidate.section):
        written = f", which {output} has" if output is not None else ""
        lines.append(f"In the scene file{written}:\n\n{toml}")
    lines.append(f"shapers.json, shapers.csv, sensitivity.png and sensitivity.svg are in {folder}")
    print_rich(
        Text(_modes_line(found.design)),
        terminal_table(f"{found.scene.name}: input shapers, {_drive_words(found.scene)}", found.results, recommended),
        *(Text(line) for line in lines),
    )


def _drive_words(scene: Scene) -> str:
    """What drove the robot."""
    if not scene.controller:
        return "co-simulated with a perfect drive"
    return f"co-simulated with {', '.join(each.name or each.kind for each in scene.controller)}"


def _modes_line(design: DesignModes) -> str:
    modes = ", ".join(f"{mode.frequency:.2f} Hz (damping ratio {mode.ratio:.4f})" for mode in design.modes)
    return (
        f"Designed for {modes} at the end pose; the first mode is {design.path_range[0]:.2f} to {design.path_range[1]:.2f} Hz "
        f"along the path and {design.first_band[0]:.2f} to {design.first_band[1]:.2f} Hz over the payload band."
    )
