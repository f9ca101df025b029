"""The clocks of a model description of FMI 3.0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

PERIODIC, TRIGGERED = ("constant", "fixed", "tunable"), "triggered"
"""Values of intervalVariability of clocks; others are changing and countdown."""


@dataclass(frozen=True)
class FmiClock:
    """A clock as its model description states it.

    Attributes:
        reference: value reference.
        variability: intervalVariability.
        is_output: whether it is an output.
        interval, shift: interval of a periodic clock, None if only the FMU knows it, and time from the start to its first tick [s].
        priority: clocks with the least number tick first in scheduled execution.
    """

    reference: int
    variability: str
    is_output: bool
    interval: float | None
    shift: float
    priority: int


def read_clocks(root: ElementTree.Element) -> tuple[FmiClock, ...]:
    """Return the input and output clocks of a model description.

    Raises:
        ValueError: an attribute isn't a number.
    """
    types = {each.get("name"): each.attrib for each in root.iterfind("TypeDefinitions/ClockType")}
    found = []
    for element in root.iterfind("ModelVariables/Clock"):
        stated: Mapping[str, str] = {**types.get(element.get("declaredType"), {}), **element.attrib}
        # as a fraction where there is one, which has less rounding
        resolution = int(stated.get("resolution", 0))
        interval, shift = (
            int(stated[f"{name}Counter"]) / resolution
            if resolution and f"{name}Counter" in stated
            else float(stated[f"{name}Decimal"])
            if f"{name}Decimal" in stated
            else None
            for name in ("interval", "shift")
        )
        if (causality := stated.get("causality")) in ("input", "output"):
            variability, priority = stated["intervalVariability"], int(stated.get("priority", 0))
            reference = int(stated["valueReference"])
            found.append(FmiClock(reference, variability, causality == "output", interval, shift or 0.0, priority))
    return tuple(found)
