"""Margins as a table and as plain data."""

from __future__ import annotations

from math import degrees, isfinite, log, pi
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Column
from rich.text import Text

from flexfmu.cosim.choices.margins.margins import LoopMargins
from flexfmu.cosim.choices.margins.scene_margins import MarginsResult
from flexfmu.cosim.reports.terminal import titled_table

HEADS = ("gain", "less", "phase °", "delay ms", "disk", "peak S", "bandwidth Hz", "crossover Hz")

SHOWN_POLES = 4
"""Poles that the table's last line names: the slowest."""


def margins_table(result: MarginsResult) -> list[RenderableType]:
    """The margins of each pose and each cut, the worst ones, and what they say."""
    table = titled_table(
        f"Margins of {result.scene.name}", "s", "cut", *(Column(each, justify="right") for each in HEADS), keys=2
    )
    for pose in result.poses:
        for row in pose.loops:
            unstable = "" if pose.is_stable else ", unstable"
            table.add_row(f"{pose.s:.2f}", row.channel.removesuffix(".torque") + unstable, *_texts(row))
    table.add_row("", "worst", *_texts(result.worst))
    return [table, Text(_verdict(result)), Text(_slowest(result))]


def _texts(row: LoopMargins) -> list[str]:
    values = (
        row.gain_margin, row.gain_reduction, degrees(row.phase_margin), 1e3 * row.delay_margin, row.disk_margin,
        row.sensitivity_peak, row.bandwidth / (2 * pi), row.crossover / (2 * pi),
    )  # fmt: skip
    return ["∞" if value == float("inf") else "-" if value != value else f"{value:.3g}" for value in values]


def _verdict(result: MarginsResult) -> str:
    """What the margins say, in a sentence."""
    if not result.is_stable:
        where = ", ".join(f"{pose.s:.2f}" for pose in result.poses if not pose.is_stable)
        growth = max(pose.poles[0].real for pose in result.poses)
        radius = max(pose.radius for pose in result.poses)
        return (
            f"The loop is unstable at s = {where}: small motions grow tenfold in {1e3 * log(10.0) / growth:.3g} ms "
            f"(eigenvalues over a period reach {radius:.4g})."
        )
    worst = result.worst
    return (
        f"The loop is stable: it stays so with torques up to {worst.gain_margin:.3g} times as large, down to "
        f"{worst.gain_reduction:.3g} times, or {1e3 * worst.delay_margin:.3g} ms later."
    )


def _slowest(result: MarginsResult) -> str:
    """The slowest poles at the last pose."""
    poles = [pole for pole in result.poses[-1].poles if pole.imag >= 0.0][:SHOWN_POLES]
    texts = [
        f"{pole.real:.4g}"
        if pole.imag == 0.0
        else f"{pole.real:.4g} ± {pole.imag:.4g}j (damping ratio {-pole.real / abs(pole):.3g})"
        for pole in poles
    ]
    return f"slowest poles at s = {result.poses[-1].s:.2f}, 1/s: " + "; ".join(texts)


def margins_data(result: MarginsResult) -> dict[str, Any]:
    """The margins as plain data, in SI units and rad; None for what is infinite or doesn't exist."""

    def plain(value: Any) -> Any:
        return None if isinstance(value, float) and not isfinite(value) else value

    worst = {name: plain(getattr(result.worst, name)) for name in LoopMargins.__dataclass_fields__ if name != "channel"}
    return {
        "scene": result.scene.name,
        "stable": result.is_stable,
        "worst": worst,
        "rows": [{name: plain(value) for name, value in row.items()} for row in result.rows()],
        "poles": [
            {"s": pose.s, "real": np.real(pose.poles).tolist(), "imaginary": np.imag(pose.poles).tolist()}
            for pose in result.poses
        ],
    }
