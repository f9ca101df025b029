"""The results of a shaper study as text: a table for the terminal, Markdown, CSV and plain data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isfinite
from typing import Any

from rich.table import Table

from flexfmu.cosim.design.shapers.alternatives import DesignModes
from flexfmu.cosim.design.shapers.recommendation import Recommendation, shaper_toml
from flexfmu.cosim.design.shapers.study import CandidateResult, PayloadTrial
from flexfmu.cosim.engine.rows import csv_text
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.reports.text import markdown_table

COLUMNS = ("shaper", "shapes", "added ms", "nominal µm", "worst µm", "at rest ms", "deviation mm", "torque N·m")
"""Columns of the table on the terminal."""

QUANTITIES: tuple[tuple[str, Callable[[PayloadTrial], str]], ...] = (
    ("Residual vibration [µm]", lambda trial: f"{1e6 * trial.residual:.2f}"),
    ("Settling time [ms]", lambda trial: milliseconds(trial.settling_time)),
    ("Peak torque [N·m]", lambda trial: f"{trial.peak_torque:.1f}"),
)
"""Quantity of each Markdown table → its text for a trial."""


def terminal_table(title: str, results: Sequence[CandidateResult], recommended: CandidateResult) -> Table:
    """Return a table with a line for each result, the recommended one in bold."""
    table = titled_table(title, *COLUMNS[:2], numbers=COLUMNS[2:], keys=2)
    for result in results:
        nominal = result.nominal
        table.add_row(
            *_named(result), f"{1e6 * nominal.residual:.2f}", f"{1e6 * result.worst_residual:.2f}",
            milliseconds(result.time_to_rest), f"{1e3 * result.path_deviation:.3f}", f"{nominal.peak_torque:.1f}",
            style="bold" if result is recommended else None,
        )  # fmt: skip
    return table


def _named(result: CandidateResult) -> tuple[str, str, str]:
    """Name, application and added time [ms]."""
    return result.candidate.name, result.candidate.application, f"{1e3 * result.added_time:.1f}"


def milliseconds(time: float | None) -> str:
    """Format a time [s] in ms; a dash for None."""
    return "–" if time is None else f"{1e3 * time:.1f}"


def drive_of(results: Sequence[CandidateResult]) -> str:
    """Return the drive of a study."""
    return "controllers" if results[0].candidate.motion.scene.controller else "motion-driven"


def markdown(title: str, results: Sequence[CandidateResult]) -> str:
    """Return a Markdown table for each quantity: shapers in rows, payload errors in columns."""
    errors = [trial.payload_error for trial in results[0].trials]
    # columns of each table: shaper, added time, path deviation, then the quantity for each payload error
    parts = [f"# {title}\n"]
    for name, text in QUANTITIES:
        head = ["Shaper", "Shapes", "Added time [ms]", "Path deviation [mm]", *(f"{error:+.0%}" for error in errors)]
        rows = [
            [*_named(result), f"{1e3 * result.path_deviation:.3f}", *map(text, result.trials)] for result in results
        ]
        rule = ["---", "---", *["---:"] * (len(head) - 2)]
        parts.append(f"## {name}, {drive_of(results)}, by payload error\n")
        parts.append(markdown_table(head, rule, rows) + "\n")
    return "\n".join(parts)


def to_csv(results: Sequence[CandidateResult]) -> str:
    """Return CSV with one line for each simulation, in SI units; a settling time beyond the dwell is left empty."""
    return csv_text(
        [
            {
                "drive": drive_of(results),
                "shaper": result.candidate.name,
                "shapes": result.candidate.application,
                "added_time": result.added_time,
                "path_deviation": result.path_deviation,
                **trial_data(trial),
                "peak_jerk": result.peak_jerk,
            }
            for result in results
            for trial in result.trials
        ]
    )


def trial_data(trial: PayloadTrial) -> dict[str, float | None]:
    """Return a simulation as plain data in SI units."""
    return {
        "payload_error": trial.payload_error,
        "residual_vibration": trial.residual,
        "settling_time": trial.settling_time,
        "peak_torque": trial.peak_torque,
    }


def design_data(design: DesignModes) -> dict[str, Any]:
    """Return the design modes as plain data; frequencies in Hz."""
    return {
        "modes": [{"frequency": mode.frequency, "ratio": mode.ratio} for mode in design.modes],
        "first_frequency_along_path": list(design.path_range),
        "first_frequency_over_payload_band": list(design.first_band),
        "frequencies_over_payload_band": list(design.band),
    }


def result_data(result: CandidateResult) -> dict[str, Any]:
    """Return a result as plain data in SI units."""
    candidate = result.candidate
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
        "trials": [trial_data(trial) for trial in result.trials],
    }


def recommendation_data(recommendation: Recommendation) -> dict[str, Any]:
    """Return the recommendation as plain data; ``toml`` is the table that applies it, empty for the unshaped motion."""
    candidate = recommendation.result.candidate
    return {
        "shaper": candidate.name,
        "shapes": candidate.application,
        "reason": recommendation.reason,
        "keeps_limits": recommendation.keeps_limits,
        "toml": shaper_toml(candidate.section),
    }
