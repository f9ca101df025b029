"""Which shaper to take: the one after which the robot is at rest soonest, whatever the payload in its band; and as TOML: the table
that applies it, and the scene file with it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from flexfmu.cosim.choices.shapers.study import UNSHAPED_NAME, CandidateResult
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.model.scene.file import load_scene, read_scene_text

RESOLUTION = 1e-4
"""Times to rest [s] that differ by less count as equal; then the smaller path deviation decides."""


@dataclass(frozen=True)
class ShaperLimits:
    """What a recommended motion must not exceed; None for no limit.

    Attributes:
        deviation: from the path [m].
        added_time: [s].
        jerk: of either joint's reference [rad/s3].
        torque: of either motor, over the payload band [N.m].
    """

    deviation: float | None = None
    added_time: float | None = None
    jerk: float | None = None
    torque: float | None = None

    def exceeded(self, result: CandidateResult) -> list[str]:
        """A phrase for each limit that a result exceeds."""
        return [
            f"{what} {scale * value:.4g} {unit} above {scale * limit:.4g} {unit}"
            for what, value, limit, scale, unit in self._compared(result)
            if value > limit * (1.0 + ROUNDING)
        ]

    def _compared(self, result: CandidateResult) -> list[tuple[str, float, float, float, str]]:
        """Quantity, value, limit, factor to the unit shown and that unit, for each limit there is."""
        rows = (
            ("path deviation", result.path_deviation, self.deviation, 1e3, "mm"),
            ("added time", result.added_time, self.added_time, 1e3, "ms"),
            ("joint jerk", result.peak_jerk, self.jerk, 1.0, "rad/s³"),
            ("peak torque", result.peak_torque, self.torque, 1.0, "N·m"),
        )
        return [(what, value, limit, scale, unit) for what, value, limit, scale, unit in rows if limit is not None]


ROUNDING = 1e-9
"""Limits are kept to within this share of themselves."""


@dataclass(frozen=True)
class Recommendation:
    """The choice among the results.

    Attributes:
        result: the recommended one; the unshaped motion where no shaper is of use, or nothing keeps the limits.
        reason: why, in one sentence.
        keeps_limits: whether the result keeps all limits; if it doesn't, nothing that was tried does.
    """

    result: CandidateResult
    reason: str
    keeps_limits: bool = True


def recommend(
    results: Sequence[CandidateResult], settling_band: float, limits: ShaperLimits | None = None
) -> Recommendation:
    """The result with the shortest time to rest over the payload band; of equal ones that with the smallest deviation.

    Where none comes to rest within the dwell for all payloads, the one with the smallest worst residual vibration. Only
    what keeps the limits counts.

    Args:
        results: the unshaped motion and the shaped ones.
        settling_band: radius around the equilibrium that counts as rest [m].
        limits: what the motion must not exceed; None for no limits.
    """
    unshaped = next(result for result in results if result.candidate.name == UNSHAPED_NAME)
    limits = limits or ShaperLimits()
    allowed = [result for result in results if not limits.exceeded(result)]
    if not allowed:
        nearest = min(results, key=lambda result: len(limits.exceeded(result)))
        return Recommendation(
            unshaped,
            f"nothing keeps the limits; nearest is {nearest.candidate.label}: {', '.join(limits.exceeded(nearest))}",
            keeps_limits=False,
        )
    results = allowed
    # where none comes to rest, the smallest vibration counts
    settled = [(result.time_to_rest, result) for result in results if result.time_to_rest is not None]
    if not settled:
        best = min(results, key=lambda result: result.worst_residual)
        return Recommendation(best, _smallest_residual(best, unshaped, settling_band))
    # soonest at rest, and among equals the one nearest to the path
    shortest = min(time for time, _ in settled)
    best = min((r for time, r in settled if time <= shortest + RESOLUTION), key=lambda result: result.path_deviation)
    if best is unshaped:
        return Recommendation(
            best,
            f"no shaper brings the robot to rest sooner; the unshaped motion: {_rest(best, settling_band)}{_payloads(best)}",
        )
    return Recommendation(
        best,
        f"{_rest(best, settling_band)}{_payloads(best)}, with a path deviation of {1e3 * best.path_deviation:.3g} mm; "
        f"the unshaped motion: {_rest(unshaped, settling_band)}",
    )


def compare_slower(result: CandidateResult, slower: CandidateResult, settling_band: float) -> str:
    """What the added time would bring without a shaper, as a sentence."""
    return f"An unshaped motion slower by the same {1e3 * result.added_time:.1f} ms: {_rest(slower, settling_band)}"


def _rest(result: CandidateResult, band: float) -> str:
    """When a motion comes to rest, for all payloads."""
    if result.time_to_rest is None:
        return f"{1e6 * result.worst_residual:.3g} µm, no rest within {1e6 * band:g} µm during the dwell"
    return f"rest within {1e6 * band:g} µm {1e3 * result.time_to_rest:.1f} ms after the end of the scene's own motion"


def _smallest_residual(best: CandidateResult, unshaped: CandidateResult, band: float) -> str:
    return (
        f"nothing comes to rest within {1e6 * band:g} µm during the dwell{_payloads(best)}; this leaves the smallest "
        f"residual vibration, {1e6 * best.worst_residual:.3g} µm at worst instead of {1e6 * unshaped.worst_residual:.3g} µm"
    )


def _payloads(result: CandidateResult) -> str:
    errors = [trial.payload_error for trial in result.trials]
    return f" for payloads from {100.0 * min(errors):+.0f} % to {100.0 * max(errors):+.0f} %" if len(errors) > 1 else ""


def shaper_toml(section: Mapping[str, Any]) -> str:
    """The `[[shaper]]` table of these keys; empty for no keys."""
    if not section:
        return ""
    document = tomlkit.document()
    document.append("shaper", _tables(section))
    return tomlkit.dumps(document)


def write_shaped(source: str, section: Mapping[str, Any], target: Path) -> None:
    """Write a scene file with this shaper in place of its own ones; comments and order of the rest stay.

    Args:
        source: path of a scene file, or name of a shipped scene.
        section: keys of the shaper; without any the scene is written without shapers.
        target: the new file; paths in the scene are rewritten to count from its folder.

    Raises:
        ResultsError: the file can't be written.
    """
    text, _, folder = read_scene_text(source)
    # the scene without its shapers, its paths as seen from the new folder
    document = tomlkit.parse(text)
    document.pop("shaper", None)
    for table in (*document.get("controller", ()), *document.get("imperfection", ())):
        key = {"fmu": "path", "python": "folder"}.get(table["kind"])
        if key is not None and folder is not None:
            table[key] = os.path.relpath(folder / table.get(key, "."), target.resolve().parent)
    # the new shaper at the end
    if section:
        document.append("shaper", _tables(section))
    try:
        target.write_text(tomlkit.dumps(document), encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"can't write {target}: {error.strerror or error}; choose another file") from error
    load_scene(target)


def _tables(section: Mapping[str, Any]) -> tomlkit.items.AoT:
    """An array of one table, modes as inline tables."""
    table = tomlkit.table()
    for key, value in section.items():
        table.append(key, _mode_tables(value) if key == "modes" else value)
    tables = tomlkit.aot()
    tables.append(table)
    return tables


def _mode_tables(modes: Any) -> tomlkit.items.Array:
    """One mode a line."""
    array = tomlkit.array().multiline(True)
    for mode in modes:
        inline = tomlkit.inline_table()
        inline.update(mode)
        array.append(inline)
    return array
