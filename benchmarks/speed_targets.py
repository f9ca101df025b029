"""The figures of `speed.py`, each with its target."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from speed_measurements import Peers, Whole, cold_build, overheads, variants

REPEAT = 30
"""Rounds of runs of which the fastest counts."""


@dataclass(frozen=True)
class Figure:
    """A measured figure.

    Attributes:
        name: what was measured.
        value: what came out, in its unit.
        target: what it should be.
        unit: ms, µs, s, or × for a ratio.
        at_least: whether more is better; otherwise less.
        note: what else there is to know.
    """

    name: str
    value: float
    target: float
    unit: str
    at_least: bool = False
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the target is met."""
        return self.value >= self.target if self.at_least else self.value <= self.target

    def line(self) -> str:
        """One line of the table."""
        comparison = "≥" if self.at_least else "≤"
        verdict = "met" if self.met else "missed"
        return f"{self.name:53} {self.value:9.2f} {self.unit:2}  {comparison} {self.target:<6g} {verdict:7} {self.note}"


WHOLE_TARGETS = {(12, 1e-3): 2.0, (12, 1e-5): 4.0, (6, 1e-3): 2.0, (6, 1e-5): 2.0}
"""(degrees of freedom, tolerance) → processor time [ms]."""

FLOOR_TARGET = 1.5
"""Of a whole run, in terms of the generated functions that it calls."""


def whole_figures(found: dict[tuple[int, float, str], Whole]) -> Iterator[Figure]:
    """Whole runs, as times and in terms of their floors."""
    for (n, tolerance, what), each in found.items():
        inside = (
            f"integration {1e3 * each.integration:.2f}, FMU {1e3 * each.inside:.2f}, floor {1e3 * each.floor:.2f} ms"
        )
        counters = f"{each.counters['steps']} steps, {each.counters['evaluations']} evaluations"
        name = f"run, {n} degrees of freedom, {tolerance:.0e}, {what}"
        yield Figure(name, 1e3 * each.time, WHOLE_TARGETS[n, tolerance], "ms", note=f"{inside}; {counters}")
        yield Figure(f"{name}, of its floor", each.time / each.floor, FLOOR_TARGET, "×")


def overhead_figures(folder: Path) -> Iterator[Figure]:
    """The master for each communication step."""
    found = overheads(folder, REPEAT // 2)
    yield Figure("master per step, compiled slaves", 1e6 * found["compiled"], 1.5, "µs", note="recording included")
    yield Figure("master per step, one slave in Python", 1e6 * found["python"], 5.0, "µs", note="recording included")


def variant_figures() -> Iterator[Figure]:
    """Many runs in one process."""
    yield Figure("1,000 variants of one FMU, 1e-3", variants(), 5.0, "s", note="planning included, peak torque of each")


def build_figures() -> Iterator[Figure]:
    """The way from a scene to its FMU."""
    yield Figure("cold build of the FMU", cold_build(), 10.0, "s", note="model, C, compiler, archive; nothing cached")


def peer_figures() -> Iterator[Figure]:
    """Other tools, each at the error that it then has."""
    peers = Peers()
    for name, (own, other), target in (
        ("faster than SciPy's Radau at 1e-5", (peers.own(1e-5), peers.radau(1e-5)), 50.0),
        ("faster than Exudyn at 1e-3, same effects", peers.exudyn(), 1000.0),
    ):
        note = (
            f"{1e3 * other.time:.0f} ms for an error of {other.error:.0e}, {1e3 * own.time:.1f} ms for {own.error:.0e}"
        )
        yield Figure(name, other.time / own.time, target, "×", True, note)
