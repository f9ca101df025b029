"""Recommends the shaper after which the robot is at rest soonest for all payloads of the band, and writes it as TOML:
the table that applies it, and the scene file with that table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import tomlkit

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.scene_files import changed_document, toml_item
from flexfmu.cosim.design.shapers.study import UNSHAPED_NAME, CandidateResult
from flexfmu.cosim.engine.files import write_whole
from flexfmu.model.scene.file import load_scene

RESOLUTION = 1e-4
"""Difference of times to rest [s] below which they are equal and the smaller path deviation decides."""


LIMITS: Mapping[str, tuple[str, str, float, str]] = {
    "deviation": ("path_deviation", "path deviation", 1e3, "mm"),
    "added_time": ("added_time", "added time", 1e3, "ms"),
    "jerk": ("peak_jerk", "joint jerk", 1.0, "rad/s³"),
    "torque": ("peak_torque", "peak torque", 1.0, "N·m"),
}
"""What a recommended motion may be limited in → figure of `CandidateResult`, its name, factor to the unit of messages, and that unit."""

ROUNDING = 1e-9
"""Relative tolerance of the limits."""


def exceeded(result: CandidateResult, limits: Mapping[str, float]) -> list[str]:
    """Return a phrase for each limit that a result exceeds.

    Args:
        result: the result.
        limits: key of `LIMITS` → largest value in SI units.
    """
    found = []
    for key, limit in limits.items():
        figure, name, scale, unit = LIMITS[key]
        if not Limit(figure, limit, unit, rounding=ROUNDING, value=(value := getattr(result, figure))).met:
            found.append(f"{name} {scale * value:.4g} {unit} above {scale * limit:.4g} {unit}")
    return found


@dataclass(frozen=True)
class Recommendation:
    """The choice among the results.

    Attributes:
        result: the recommended one; the unshaped motion where no shaper helps, or no result keeps the limits.
        reason: of the recommendation, in one sentence.
        keeps_limits: whether the result keeps all limits; False where no result does.
    """

    result: CandidateResult
    reason: str
    keeps_limits: bool = True


def recommend(
    results: Sequence[CandidateResult], settling_band: float, limits: Mapping[str, float] = MappingProxyType({})
) -> Recommendation:
    """Return the result with the shortest time to rest over the payload band, of equal ones the smallest deviation.

    Where none comes to rest within the dwell for all payloads, it is the one with the smallest worst residual
    vibration. Results that exceed the limits are ignored.

    Args:
        results: the unshaped motion and the shaped ones.
        settling_band: radius around the equilibrium that counts as rest [m].
        limits: see `exceeded`.
    """
    # results that keep the limits
    unshaped = next(result for result in results if result.candidate.name == UNSHAPED_NAME)
    allowed = [result for result in results if not exceeded(result, limits)]
    if not allowed:
        nearest = min(results, key=lambda result: len(exceeded(result, limits)))
        return Recommendation(
            unshaped,
            f"nothing keeps the limits; nearest is {nearest.candidate.label}: {', '.join(exceeded(nearest, limits))}",
            keeps_limits=False,
        )
    results = allowed
    # where none comes to rest, the smallest worst residual vibration
    settled = [(result.time_to_rest, result) for result in results if result.time_to_rest is not None]
    if not settled:
        best = min(results, key=lambda result: result.worst_residual)
        return Recommendation(
            best,
            f"nothing comes to rest within {1e6 * settling_band:g} µm during the dwell{_payloads(best)}; this leaves the smallest "
            f"residual vibration, {1e6 * best.worst_residual:.3g} µm at worst instead of {1e6 * unshaped.worst_residual:.3g} µm",
        )
    # the shortest time to rest, and of equal ones the smallest path deviation
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
    """Return a sentence about an unshaped motion that is slower by the added time."""
    return f"An unshaped motion slower by the same {1e3 * result.added_time:.1f} ms: {_rest(slower, settling_band)}"


def _rest(result: CandidateResult, band: float) -> str:
    """Return a phrase on when a motion comes to rest for all payloads."""
    if result.time_to_rest is None:
        return f"{1e6 * result.worst_residual:.3g} µm, no rest within {1e6 * band:g} µm during the dwell"
    return f"rest within {1e6 * band:g} µm {1e3 * result.time_to_rest:.1f} ms after the end of the scene's own motion"


def _payloads(result: CandidateResult) -> str:
    """Return a phrase with the range of payload errors; empty for a single one."""
    errors = [trial.payload_error for trial in result.trials]
    return f" for payloads from {100.0 * min(errors):+.0f} % to {100.0 * max(errors):+.0f} %" if len(errors) > 1 else ""


def shaper_toml(section: Mapping[str, Any]) -> str:
    """Return the `[[shaper]]` table of these keys as TOML; empty for no keys."""
    if not section:
        return ""
    document = tomlkit.document()
    document.append("shaper", _tables(section))
    return tomlkit.dumps(document)


def write_shaped(
    source: str, section: Mapping[str, Any], target: Path, changes: Mapping[str, Any] | None = None
) -> None:
    """Write a scene file with this shaper instead of its own ones; everything else, comments included, stays.

    Args:
        source: path of a scene file, or name of a shipped scene.
        section: keys of the shaper; empty for a scene without shapers.
        target: the new file; relative paths in the scene become relative to its folder.
        changes: dotted key → value that differs from the scene's.

    Raises:
        ResultsError: the file can't be written.
    """
    document = changed_document(source, target, changes or {})
    document.pop("shaper", None)
    # append the new shaper
    if section:
        document.append("shaper", _tables(section))
    write_whole(target, tomlkit.dumps(document))
    load_scene(target)


def _tables(section: Mapping[str, Any]) -> tomlkit.items.AoT:
    """Return an array of one table, with modes as inline tables, one a line."""
    table, tables = tomlkit.table(), tomlkit.aot()
    for key, value in section.items():
        if key == "modes":
            modes = tomlkit.array().multiline(True)
            modes.extend(toml_item({"": mode})[""] for mode in value)
            table.append(key, modes)
        else:
            table.append(key, value)
    tables.append(table)
    return tables
