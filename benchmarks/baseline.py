"""Figures that shouldn't grow unnoticed, held against those of `baseline.json`.

Counters of the integrator are the same on every machine. Times are in terms of a fixed piece of arithmetic, the yardstick,
measured in the same run: that leaves what processors differ in, and how busy a machine is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

BASELINE = Path(__file__).with_name("baseline.json")

COUNTER_TOLERANCE = 0.02
"""Of counters: another order of rounding may cost a step."""

TIME_TOLERANCE = 0.4
"""Of times in terms of the yardstick; between runs on a shared machine they differ by 15 %."""

Figures = Mapping[str, Mapping[str, float]]
"""``counters`` and ``times`` → name → figure."""


def regressions(measured: Figures) -> list[str]:
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


def update(measured: Figures) -> None:
    """Make these the baseline."""
    BASELINE.write_text(json.dumps(measured, indent=2) + "\n", encoding="utf-8")
