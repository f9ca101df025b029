"""`flexfmu paper`: compute every table and figure, and write them as they become ready."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from flexfmu.cosim.paper.report import PaperReport

DEFAULT_FOLDER = Path("results/paper")
"""Where the results go unless the user says otherwise."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the finished fraction, 0..1."""


def run_paper(out: Path = DEFAULT_FOLDER, *, progress: Progress | None = None) -> PaperReport:
    """Run the paper's experiment and write tables and figures.

    Everything is written as soon as it is known: a run that is interrupted leaves what it has computed so far.
    ``out`` gets ``report.html``, ``paper.md``, ``paper.json``, ``tables/*.csv``, ``simulations.csv`` (every metric of
    every simulation), ``figures/*.png|svg`` and ``overview.png|svg``.

    Args:
        out: folder of the results, made if it isn't there.
        progress: told what is being done.

    Returns:
        The report: `to_markdown()`, `to_json()`, and `flexfmu.cosim.paper.terminal.print_report` for a terminal.

    Raises:
        PaperError: a simulation failed, or ``out`` can't be written.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    raise NotImplementedError
