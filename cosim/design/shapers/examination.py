"""Shaper study of a scene: designs input shapers, co-simulates each and recommends one; as a table, CSV and plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.design.shapers.recommendation import Recommendation, compare_slower, recommend, shaper_toml
from flexfmu.cosim.design.shapers.study import (
    CandidateResult,
    DesignModes,
    Drive,
    alternatives,
    candidates,
    design_modes,
    payload_errors,
    slower,
    studied,
    study,
)
from flexfmu.cosim.engine.showing import ShowProgress, csv_text
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.schema import Scene

COARSE, FINE = 5, 7
"""Number of payload errors over the band. With the payload the phases change in which the vibrations of start, corners
and end superpose, so the residual vibration may be worst anywhere in the band, not only at its ends or middle."""


@dataclass(frozen=True)
class ShaperStudy:
    """A scene's shaper study.

    Attributes:
        scene: the simulated scene.
        design: modes that the shapers were designed for.
        results: of the unshaped motion and of every shaper.
        slower: of the unshaped motion, slower by the time that the recommended shaper adds; None where it adds none.
        recommendation: the recommended shaper.
        left_out: shaper and application → why it can't be applied.
    """

    scene: Scene
    design: DesignModes
    results: Sequence[CandidateResult]
    slower: CandidateResult | None
    recommendation: Recommendation
    left_out: Mapping[str, str]


@one_blas_thread()
def examine(
    scene: Scene,
    band: float,
    count: int,
    show: ShowProgress,
    drive: Drive | None = None,
    limits: Mapping[str, float] = MappingProxyType({}),
) -> ShaperStudy:
    """Design shapers for a scene, co-simulate them and recommend one.

    Args:
        scene: the scene.
        band: largest relative error of the payload's mass.
        count: number of payload errors, odd.
        show: called with the current activity and the finished fraction.
        drive: perfect drive or the scene's controllers, see `studied`.
        limits: of the recommended motion, see `exceeded`.

    Raises:
        InputError: nothing vibrates, or there is no controller.
        CosimError: a simulation failed.
    """
    show("calculating the modes along the path", None)
    # shapers for the modes at the end pose and over the payload band
    errors = payload_errors(scene, band, count)
    design = design_modes(plan(scene), errors)
    scene = studied(scene, design.modes[0].frequency, drive)
    motion = plan(scene)
    tried, left_out = candidates(motion, alternatives(design))
    fmu_path = build_scene(scene).path

    def simulating(fraction: float) -> None:
        show("simulating", fraction)

    # the recommendation, and an unshaped motion that is slower by the same time
    results = list(study(tried, errors, motion.duration, fmu_path, simulating))
    recommendation = recommend(results, scene.cosimulation.settling_band, limits)
    chosen = recommendation.result
    added = chosen.added_time
    compared = next(study([slower(motion, added)], errors, motion.duration, fmu_path)) if added > 0.0 else None
    return ShaperStudy(scene, design, results, compared, recommendation, left_out)


def study_data(found: ShaperStudy) -> dict[str, Any]:
    """Return the study as plain data in SI units; ``toml`` applies the recommended shaper, empty for the unshaped motion."""
    design, chosen = found.design, found.recommendation.result.candidate
    return {
        "scene": found.scene.name,
        "design": {
            "modes": [{"frequency": mode.frequency, "ratio": mode.ratio} for mode in design.modes],
            "first_frequency_along_path": list(design.path_range),
            "first_frequency_over_payload_band": list(design.first_band),
            "frequencies_over_payload_band": list(design.band),
        },
        "alternatives": [result_data(result) for result in found.results],
        "slower": None if found.slower is None else result_data(found.slower),
        "left_out": dict(found.left_out),
        "recommendation": {
            "shaper": chosen.name,
            "shapes": chosen.application,
            "reason": found.recommendation.reason,
            "keeps_limits": found.recommendation.keeps_limits,
            "toml": shaper_toml(chosen.section),
        },
    }


def report(found: ShaperStudy, folder: Path, output: Path | None) -> list[RenderableType]:
    """Return the study for the terminal: design, table, recommendation and folder of the files.

    Args:
        found: the study.
        folder: of the results.
        output: the shaped scene's file, if there is one.
    """
    design, recommended = found.design, found.recommendation.result
    # design modes, and title of the table
    modes = ", ".join(f"{mode.frequency:.2f} Hz (damping ratio {mode.ratio:.4f})" for mode in design.modes)
    designed = (
        f"Designed for {modes} at the end pose; the first mode is {design.path_range[0]:.2f} to {design.path_range[1]:.2f} Hz "
        f"along the path and {design.first_band[0]:.2f} to {design.first_band[1]:.2f} Hz over the payload band."
    )
    drive = ", ".join(each.name or each.kind for each in found.scene.controller) or "a perfect drive"
    title = f"{found.scene.name}: input shapers, co-simulated with {drive}"
    # the recommendation, the slower motion, and the shapers that can't be applied
    lines = []
    if found.recommendation.keeps_limits:
        lines.append(f"Recommended: {recommended.candidate.label}: {found.recommendation.reason}.")
    if found.slower is not None:
        lines.append(compare_slower(recommended, found.slower, found.scene.cosimulation.settling_band) + ".")
    lines += [f"Left out: {what}: {why}." for what, why in found.left_out.items()]
    # the recommended shaper's table in the scene file
    if toml := found.recommendation.keeps_limits and shaper_toml(recommended.candidate.section):
        written = f", which {output} has" if output is not None else ""
        lines.append(f"In the scene file{written}:\n\n{toml}")
    lines.append(f"shapers.json, shapers.csv, sensitivity.png and sensitivity.svg are in {folder}")
    return [Text(designed), terminal_table(title, found.results, recommended), *map(Text, lines)]


COLUMNS = ("shaper", "shapes", "added ms", "nominal µm", "worst µm", "at rest ms", "deviation mm", "torque N·m")
"""Columns of the table on the terminal."""


def terminal_table(title: str, results: Sequence[CandidateResult], recommended: CandidateResult) -> Table:
    """Return a table with a line for each result, the recommended one in bold."""
    table = titled_table(title, *COLUMNS[:2], numbers=COLUMNS[2:])
    for result in results:
        nominal, rest = result.nominal, result.time_to_rest
        table.add_row(
            result.candidate.name, result.candidate.application, f"{1e3 * result.added_time:.1f}",
            f"{1e6 * nominal.residual:.2f}", f"{1e6 * result.worst_residual:.2f}",
            "–" if rest is None else f"{1e3 * rest:.1f}", f"{1e3 * result.path_deviation:.3f}",
            f"{nominal.peak_torque:.1f}", style="bold" if result is recommended else None,
        )  # fmt: skip
    return table


def to_csv(results: Sequence[CandidateResult]) -> str:
    """Return CSV with one line for each simulation, in SI units; a settling time beyond the dwell is left empty."""
    drive, rows = "controllers" if results[0].candidate.motion.scene.controller else "motion-driven", []
    for result in results:
        data = result_data(result)
        shared = {"drive": drive, **{key: data[key] for key in ("shaper", "shapes", "added_time", "path_deviation")}}
        rows += [{**shared, **trial, "peak_jerk": result.peak_jerk} for trial in data["trials"]]
    return csv_text(rows)


def result_data(result: CandidateResult) -> dict[str, Any]:
    """Return a result as plain data in SI units."""
    candidate = result.candidate
    trials = [
        {
            "payload_error": trial.payload_error,
            "residual_vibration": trial.residual,
            "settling_time": trial.settling_time,
            "peak_torque": trial.peak_torque,
        }
        for trial in result.trials
    ]
    return {
        "shaper": candidate.name,
        "shapes": candidate.application,
        "impulses": {"times": list(candidate.sequence.times), "amplitudes": list(candidate.sequence.amplitudes)},
        "added_time": result.added_time,
        "path_deviation": result.path_deviation,
        "residual_vibration": result.nominal.residual,
        "worst_residual_vibration": result.worst_residual,
        "time_to_rest": result.time_to_rest,
        "peak_torque": result.nominal.peak_torque,
        "worst_peak_torque": result.peak_torque,
        "peak_jerk": result.peak_jerk if isfinite(result.peak_jerk) else None,
        "section": dict(candidate.section),
        "trials": trials,
    }
