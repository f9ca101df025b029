"""What the description says of a variable: bounds, size, start, and another value to try."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any


def is_smooth(variable: Any) -> bool:
    """Whether it is a Real that changes continuously."""
    return variable.type == "Real" and (variable.variability or "continuous") == "continuous"


def attribute(variable: Any, name: str) -> float | None:
    """The number min, max or nominal of a variable or of its type; None where there is none."""
    for owner in (variable, variable.declaredType):
        text = getattr(owner, name, None)
        if text is not None:
            with suppress(ValueError):
                return float(text)
    return None


def start_value(variable: Any) -> Any | None:
    """The start value as a number, bool or text; None where there is none, or none that can be read."""
    text = variable.start
    if text is None or variable.type == "String":
        return text
    with suppress(ValueError):
        if variable.type == "Boolean":
            return {"true": True, "1": True, "false": False, "0": False}.get(str(text).strip())
        return float(text) if variable.type == "Real" else int(float(text))
    return None


def start_of(variable: Any) -> float:
    """The start value of a Real, 0 where there is none."""
    value = start_value(variable)
    return float(value) if value is not None and math.isfinite(value) else 0.0


def size_of(variable: Any) -> float:
    """Order of magnitude of a variable: its nominal, its start, or 1."""
    return abs(attribute(variable, "nominal") or 0.0) or abs(start_of(variable)) or 1.0


def within(variable: Any, value: float) -> float:
    """The value, or the bound of the variable that it is beyond."""
    low, high = attribute(variable, "min"), attribute(variable, "max")
    return min(max(value, -math.inf if low is None else low), math.inf if high is None else high)


def moved(variable: Any, share: float) -> float:
    """Another value of a Real than its start, by a share of its size, within its bounds."""
    start = start_of(variable)
    up = within(variable, start + share * size_of(variable))
    return up if up != start else within(variable, start - share * size_of(variable))


def other_value(variable: Any, share: float = 0.0213) -> Any | None:
    """Another value than the start, of the variable's type, a Real by a share of its size; None where there may be none."""
    start = start_value(variable)
    # types with values that are easily found
    if variable.type == "Real":
        value = moved(variable, share)
        return value if value != start else None
    if variable.type == "Boolean":
        return not start
    if variable.type == "String":
        return f"{start}x"
    # an enumeration has only the values that it lists
    if variable.type == "Enumeration":
        items = [int(item.value) for item in (variable.declaredType.items if variable.declaredType else None) or ()]
        return next((item for item in items if item != start), None)
    # an Integer within its limits
    value = int(within(variable, int(start or 0) + 1))
    return value if value != start else None
