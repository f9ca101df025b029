"""How fast flexfmu is, against its targets, and whether it has become slower.

The paper's motion of 0.43 s with a dwell of 0.25 s, recorded at 1 kHz: the values of all outputs, or these and two derivatives
of each, which metrics and interpolation need. Times are processor times of one core, the best of
several runs, after building and loading. `floor` is what the generated functions take that a run calls, by themselves
(`fmu_cost.py` shows more of it). Other tools are compared by the errors that they reach.

    python benchmarks/speed.py [--out results/speed.json] [--update]

The exit status is 1 where a figure has grown beyond its tolerance in `baseline.json` (see `baseline.py`); missed targets
don't change it. With --update, today's figures become the baseline.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from baseline import regressions, update
from speed_measurements import Whole, whole_runs, yardstick
from speed_targets import (
    REPEAT,
    Figure,
    build_figures,
    overhead_figures,
    peer_figures,
    variant_figures,
    whole_figures,
)


def main() -> int:
    """Measure, print, compare; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/speed.json"), help="where the figures go as JSON")
    parser.add_argument("--update", action="store_true", help="make these figures the baseline")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="flexfmu-speed-") as name:
        folder = Path(name)
        unit, runs = yardstick(folder), whole_runs(folder, REPEAT)
        figures = [*told(whole_figures(runs)), *told(overhead_figures(folder))]
    figures += [*told(build_figures()), *told(variant_figures()), *told(peer_figures())]
    compared = {"counters": counters(runs), "times": times(figures, unit)}
    write(options.out, figures, compared)
    if options.update:
        update(compared)
        return 0
    grown = regressions(compared)
    print(*grown, sep="\n", file=sys.stderr, end="\n" if grown else "")
    return 1 if grown else 0


def told(figures: Iterator[Figure]) -> Iterator[Figure]:
    """The figures, printed as they come."""
    for each in figures:
        print(each.line(), flush=True)
        yield each


def counters(runs: dict[tuple[int, float, str], Whole]) -> dict[str, float]:
    """What doesn't depend on the machine."""
    return {
        f"{name}, {n} degrees of freedom, {tolerance:.0e}": value
        for (n, tolerance, _), each in runs.items()
        for name, value in each.counters.items()
    }


def times(figures: list[Figure], unit: float) -> dict[str, float]:
    """Times in terms of the yardstick."""
    seconds = {"ms": 1e-3, "µs": 1e-6, "s": 1.0}
    own = {each.name: each.value * seconds[each.unit] / unit for each in figures if each.unit in seconds}
    return {name: float(f"{value:.3g}") for name, value in own.items()}


def write(path: Path, figures: list[Figure], compared: dict[str, dict[str, float]]) -> None:
    """The figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"figures": [{**asdict(each), "met": each.met} for each in figures], **compared}
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
