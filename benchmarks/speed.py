"""How fast flexfmu is, against its targets, and whether it has become slower.

The paper's motion of 0.43 s with a dwell of 0.25 s, recorded at 1 kHz: the values of all outputs, or these and two derivatives
of each, which metrics and interpolation need. Times are processor times of one core, the best of
several runs, after building and loading. `floor` is the time of the generated functions that a run calls, by themselves
(`fmu_cost.py` shows more of it). Other tools are compared by the errors that they reach.

    python benchmarks/speed.py [--out results/speed.json] [--update]

The exit status is 1 where a figure has grown beyond its tolerance in `baseline.json`; missed targets
don't change it. Counters of the integrator are the same on every machine; times are relative to a fixed piece of arithmetic, the
yardstick, measured in the same run, which cancels most of the difference between processors and of other load. With --update,
today's figures become the baseline.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path

from speed_command_line import command_line_figures
from speed_controllers import controller_figures
from speed_design import design_figures
from speed_figure import SpeedFigure
from speed_loops import loop_figures
from speed_measurements import RECORDINGS, Peers, Whole, cold_build, overheads, variants, whole_runs, yardstick
from speed_metrics import metric_figures
from speed_motions import motion_figures
from speed_recording import recording_figures
from speed_sweep import sweep_figures
from speed_variants import lockstep_figures

REPEAT = 30
"""Rounds of runs of which the fastest counts."""


WHOLE_TARGETS = {
    (12, 1e-3, "values"): 2.0,
    (12, 1e-5, "values"): 1.7,
    (6, 1e-3, "values"): 2.0,
    (6, 1e-5, "values"): 1.1,
    (12, 1e-3, "2 derivatives"): 2.0,
    (12, 1e-5, "2 derivatives"): 2.6,
    (6, 1e-3, "2 derivatives"): 2.0,
    (6, 1e-5, "2 derivatives"): 2.0,
}
"""(degrees of freedom, tolerance, what is recorded) → processor time [ms]."""

INTEGRATION_TARGETS = {(12, 1e-5): 1.4}
"""(degrees of freedom, tolerance) → processor time [ms] of the FMU alone, called from C, without its outputs."""

FLOOR_TARGET = 1.5
"""Of a whole run, in terms of the generated functions that it calls."""


def whole_figures(found: dict[tuple[int, float, str], Whole]) -> Iterator[SpeedFigure]:
    """Whole runs, as times and in terms of their floors."""
    for (n, tolerance, what), each in found.items():
        inside = (
            f"integration {1e3 * each.integration:.2f}, FMU {1e3 * each.inside:.2f}, floor {1e3 * each.floor:.2f} ms"
        )
        counters = f"{each.counters['steps']} steps, {each.counters['evaluations']} evaluations"
        name = f"run, {n} degrees of freedom, {tolerance:.0e}, {what}"
        yield SpeedFigure(name, 1e3 * each.time, WHOLE_TARGETS[n, tolerance, what], "ms", note=f"{inside}; {counters}")
        yield SpeedFigure(f"{name}, of its floor", each.time / each.floor, FLOOR_TARGET, "×")
        if what == "values" and (target := INTEGRATION_TARGETS.get((n, tolerance))):
            name = f"integration, {n} degrees of freedom, {tolerance:.0e}"
            yield SpeedFigure(name, 1e3 * each.integration, target, "ms", note=counters)


def overhead_figures(folder: Path) -> Iterator[SpeedFigure]:
    """The master for each communication step."""
    found, values = overheads(folder, REPEAT // 2), overheads(folder, REPEAT // 2, RECORDINGS["values"][0])
    note = "50 outputs and their first two derivatives recorded"
    yield SpeedFigure("master per step, compiled slaves", 1e6 * found["compiled"], 0.15, "µs", note=note)
    yield SpeedFigure(
        "master per step, compiled slaves, values", 1e6 * values["compiled"], 0.15, "µs", note="50 outputs recorded"
    )
    yield SpeedFigure("master per step, one slave in Python", 1e6 * found["python"], 5.0, "µs", note=note)


def variant_figures() -> Iterator[SpeedFigure]:
    """Many runs in one process."""
    yield SpeedFigure(
        "1,000 variants of one FMU, 1e-3", variants(), 5.0, "s", note="planning included, peak torque of each"
    )


def build_figures() -> Iterator[SpeedFigure]:
    """The way from a scene to its FMU."""
    yield SpeedFigure(
        "cold build of the FMU", cold_build(), 10.0, "s", note="model, C, compiler, archive; nothing cached"
    )


def peer_figures() -> Iterator[SpeedFigure]:
    """Other tools, each at the error that it then has."""
    peers = Peers()
    for name, (own, other), target in (
        ("faster than SciPy's Radau at 1e-5", (peers.own(1e-5), peers.radau(1e-5)), 50.0),
        ("faster than Exudyn at 1e-3, same effects", peers.exudyn(), 1000.0),
    ):
        note = (
            f"{1e3 * other.time:.0f} ms for an error of {other.error:.0e}, {1e3 * own.time:.1f} ms for {own.error:.0e}"
        )
        yield SpeedFigure(name, other.time / own.time, target, "×", True, note)


BASELINE = Path(__file__).with_name("baseline.json")

COUNTER_TOLERANCE = 0.02
"""Of counters: another order of rounding may cost a step."""

TIME_TOLERANCE = 0.4
"""Of times in terms of the yardstick; between runs on a shared machine they differ by 15 %."""

Compared = Mapping[str, Mapping[str, float]]
"""``counters`` and ``times`` → name → figure."""


def regressions(measured: Compared) -> list[str]:
    """A sentence for each figure that has grown beyond its tolerance, or that isn't in the baseline."""
    known = json.loads(BASELINE.read_text(encoding="utf-8"))
    found = []
    for kind, tolerance in (("counters", COUNTER_TOLERANCE), ("times", TIME_TOLERANCE)):
        for name, value in measured[kind].items():
            before = known.get(kind, {}).get(name)
            if before is None:
                found.append(f"{name} isn't in {BASELINE.name}: take it up with --update")
            elif value > before * (1.0 + tolerance):
                found.append(f"{name} has grown from {before:g} to {value:g}, by more than {tolerance:.0%}")
    return found


def update(measured: Compared) -> None:
    """Make these the baseline."""
    BASELINE.write_text(json.dumps(measured, indent=2) + "\n", encoding="utf-8")


def main() -> int:
    """Measure, print, compare; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("results/speed.json"), help="where the figures go as JSON")
    parser.add_argument("--update", action="store_true", help="make these figures the baseline")
    options = parser.parse_args()
    # measure and print
    with tempfile.TemporaryDirectory(prefix="flexfmu-speed-") as name:
        folder = Path(name)
        unit, runs = yardstick(folder), whole_runs(folder, REPEAT)
        figures = [*printed(whole_figures(runs)), *printed(overhead_figures(folder))]
    measures = (
        build_figures,
        command_line_figures,
        variant_figures,
        lockstep_figures,
        metric_figures,
        motion_figures,
        loop_figures,
        controller_figures,
        recording_figures,
        sweep_figures,
        peer_figures,
        design_figures,
    )
    for measure in measures:
        figures += printed(measure())
    # compare with the baseline
    compared = {"counters": counters(runs), "times": times(figures, unit)}
    write(options.out, figures, compared)
    if options.update:
        update(compared)
        return 0
    grown = regressions(compared)
    print(*grown, sep="\n", file=sys.stderr, end="\n" if grown else "")
    return 1 if grown else 0


def printed(figures: Iterator[SpeedFigure]) -> Iterator[SpeedFigure]:
    """The figures, printed as they come."""
    for each in figures:
        print(each.line(), flush=True)
        yield each


def counters(runs: dict[tuple[int, float, str], Whole]) -> dict[str, float]:
    """The integrator's counters, which don't depend on the machine."""
    return {
        f"{name}, {n} degrees of freedom, {tolerance:.0e}": value
        for (n, tolerance, _), each in runs.items()
        for name, value in each.counters.items()
    }


def times(figures: list[SpeedFigure], unit: float) -> dict[str, float]:
    """Times in terms of the yardstick."""
    seconds = {"ms": 1e-3, "µs": 1e-6, "s": 1.0}
    own = {each.name: each.value * seconds[each.unit] / unit for each in figures if each.unit in seconds}
    return {name: float(f"{value:.3g}") for name, value in own.items()}


def write(path: Path, figures: list[SpeedFigure], compared: dict[str, dict[str, float]]) -> None:
    """The figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"figures": [{**asdict(each), "met": each.met} for each in figures], **compared}
    path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
