"""Bode, Nyquist and root-locus pictures of a loop, by python-control, and a table of its margins as a file.

Margins as a table and as plain data.
"""

from __future__ import annotations

from collections.abc import Callable
from math import degrees, isfinite, log, pi
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.design.margins.margins import ALL, LoopMargins, PoseMargins
from flexfmu.cosim.design.margins.scene_margins import MarginsResult
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.model.one_thread import one_blas_thread

HEADS = ("gain", "less", "phase\n°", "delay\nms", "disk", "peak\nS", "band-\nwidth\nHz", "cross-\nover\nHz")
"""Of the columns, short enough for 80 characters with all others."""

SHOWN_POLES = 4
"""Poles that the table's last line names: the slowest."""


def margins_table(result: MarginsResult) -> list[RenderableType]:
    """The margins of each pose and each cut, the worst ones, and what they say."""
    tables, payloads = list[Table](), list(dict.fromkeys(each.payload for each in result.poses))
    for payload in payloads:
        several = f", {payload:.4g} kg" if len(payloads) > 1 else ""
        tables.append(titled_table(f"Margins of {result.scene.name}{several}", "s", "cut", numbers=HEADS, keys=2))
        for pose in (each for each in result.poses if each.payload == payload):
            for row in pose.loops:
                # of an unstable loop the crossover alone means something
                texts = _texts(row) if pose.is_stable else [*"-" * 7, _texts(row)[-1]]
                tables[-1].add_row(f"{pose.s:.2f}", row.channel.removesuffix(".torque"), *texts)
    tables[-1].add_row("", "worst", *_texts(result.worst))
    warning = [Text(f"warning: {result.coarse_counts}", style="yellow")] if result.coarse_counts else []
    return [*tables, Text(_verdict(result)), Text(_slowest(result)), *warning]


def _where(result: MarginsResult, pose: PoseMargins) -> str:
    """The share of the path, and the payload if there are several."""
    several = len({each.payload for each in result.poses}) > 1
    return f"{pose.s:.2f}, {pose.payload:.4g} kg" if several else f"{pose.s:.2f}"


def _texts(row: LoopMargins) -> list[str]:
    values = (
        row.gain_margin, row.gain_reduction, degrees(row.phase_margin), 1e3 * row.delay_margin, row.disk_margin,
        row.sensitivity_peak, row.bandwidth / (2 * pi), row.crossover / (2 * pi),
    )  # fmt: skip
    return ["∞" if value == float("inf") else "-" if value != value else f"{value:.3g}" for value in values]


def _verdict(result: MarginsResult) -> str:
    """What the margins say, in a sentence."""
    if not result.is_stable:
        where = "; ".join(_where(result, pose) for pose in result.poses if not pose.is_stable)
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
        "coarse_counts": result.coarse_counts,
        "rows": [{name: plain(value) for name, value in row.items()} for row in result.rows()],
        "poles": [
            {
                "s": pose.s,
                "payload": pose.payload,
                "real": np.real(pose.poles).tolist(),
                "imaginary": np.imag(pose.poles).tolist(),
            }
            for pose in result.poses
        ],
    }


POINTS = 2000
"""Frequencies of a picture."""

GAINS = np.geomspace(0.05, 20.0, 160)
"""Factors of the torques of a root locus."""


@one_blas_thread()
def responses(result: MarginsResult) -> list[Any]:
    """Loop transfer functions at each pose and each single cut, as python-control's `FrequencyResponseData`.

    Of loops with several samples a period they are the parts that keep the frequency.
    """
    import control

    found = []
    for pose in result.poses:
        for row, cut in zip(pose.loops, pose.open, strict=True):
            if row.channel == ALL:
                continue
            highest = pi * cut.size / cut.period
            frequencies = np.geomspace(1e-3 * highest, 0.999 * highest, POINTS)
            name = f"{row.channel.removesuffix('.torque')} at {100.0 * pose.s:.0f} %"
            found.append(control.frd(cut.fundamental(frequencies)[:, 0, 0], frequencies, name=name))
    return found


@one_blas_thread()
def write_margins(result: MarginsResult, folder: Path) -> list[Path]:
    """Write ``margins.csv``, ``bode.png``, ``nyquist.png`` and ``root-locus.png`` into a folder.

    Raises:
        ResultsError: a file can't be written.
    """
    out = OutputFolder(folder)
    out.prepare()
    import control
    import matplotlib.pyplot as plt

    plt.switch_backend("Agg")
    loops, written = responses(result), [out.write("margins.csv", result.to_csv())]
    pictures: dict[str, Callable[[], Any]] = {
        "bode.png": lambda: control.bode_plot(loops, Hz=True, grid=True, initial_phase=0.0),
        "nyquist.png": lambda: control.nyquist_plot(
            loops, unit_circle=True, warn_encirclements=False, warn_nyquist=False
        ),
        "root-locus.png": lambda: _root_locus(result),
    }
    for name, draw in pictures.items():
        figure = plt.figure(figsize=(9.0, 6.5))
        try:
            draw()
            figure.savefig(folder / name, dpi=110, bbox_inches="tight")
        except OSError as error:
            raise ResultsError(f"can't write {folder / name}: {error.strerror or error}") from None
        finally:
            plt.close("all")
        written.append(folder / name)
    return written


def _root_locus(result: MarginsResult) -> None:
    """Eigenvalues over a period, in the z-plane, as all torques grow from a twentieth to twenty times their size."""
    import control
    import matplotlib.pyplot as plt

    draw_grid: Any = control.grid.zgrid
    draw_grid()
    for pose, loop in zip(result.poses, result.linear, strict=True):
        factors = np.append(1.0, GAINS)[:, np.newaxis] * np.ones(len(loop.channels))
        now, *values = np.linalg.eigvals(loop.lifted.closed(factors))
        points = np.concatenate(values)
        (line,) = plt.plot(points.real, points.imag, ".", markersize=1.5, label=f"s = {pose.s:.2f}")
        plt.plot(now.real, now.imag, "x", color=line.get_color())
    plt.gca().set_aspect("equal", adjustable="box")
    plt.xlim(-1.3, 1.3)
    plt.ylim(-1.3, 1.3)
    plt.legend(markerscale=6.0)
    plt.title("Eigenvalues over a period, torques times 0.05 to 20 (x: times 1)")
