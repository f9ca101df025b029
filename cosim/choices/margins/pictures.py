"""Bode, Nyquist and root-locus pictures of a loop, by python-control, and a table of its margins as a file."""

from __future__ import annotations

import csv
from collections.abc import Callable
from io import StringIO
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.choices.margins.linear_loop import Perturbation
from flexfmu.cosim.choices.margins.margins import ALL
from flexfmu.cosim.choices.margins.scene_margins import MarginsResult
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder

POINTS = 2000
"""Frequencies of a picture."""

GAINS = np.geomspace(0.05, 20.0, 160)
"""Factors of the torques of a root locus."""


def responses(result: MarginsResult) -> list[Any]:
    """Loop transfer functions at each pose and each single cut, as python-control's `FrequencyResponseData`.

    Of loops with several samples a period they are the parts that keep the frequency.

    Raises:
        InputError: python-control isn't installed.
    """
    control = _control()
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


def write_margins(result: MarginsResult, folder: Path) -> list[Path]:
    """Write ``margins.csv``, ``bode.png``, ``nyquist.png`` and ``root-locus.png`` into a folder.

    Raises:
        InputError: python-control isn't installed.
        ResultsError: a file can't be written.
    """
    out, text, rows = OutputFolder(folder), StringIO(), result.rows()
    out.prepare()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    control = _control()
    import matplotlib.pyplot as plt

    plt.switch_backend("Agg")
    loops, written = responses(result), [out.write("margins.csv", text.getvalue())]
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
    import matplotlib.pyplot as plt

    draw_grid: Any = _control().grid.zgrid
    draw_grid()
    for pose, loop in zip(result.poses, result.linear, strict=True):
        count = len(loop.channels)
        values = [
            np.linalg.eigvals(loop.closed(Perturbation((factor,) * count, (0.0,) * count))) for factor in GAINS.tolist()
        ]
        points = np.concatenate(values)
        now = np.linalg.eigvals(loop.closed(Perturbation((1.0,) * count, (0.0,) * count)))
        (line,) = plt.plot(points.real, points.imag, ".", markersize=1.5, label=f"s = {pose.s:.2f}")
        plt.plot(now.real, now.imag, "x", color=line.get_color())
    plt.gca().set_aspect("equal", adjustable="box")
    plt.xlim(-1.3, 1.3)
    plt.ylim(-1.3, 1.3)
    plt.legend(markerscale=6.0)
    plt.title("Eigenvalues over a period, torques times 0.05 to 20 (x: times 1)")


def _control() -> Any:
    try:
        import control
    except ImportError:
        raise InputError('pictures of margins need python-control: pip install "flexfmu[control]"') from None
    return control
