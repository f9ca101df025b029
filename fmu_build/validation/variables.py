"""Attributes of a variable: bounds, size, start value, and other admissible values for tests."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any


def is_smooth(variable: Any) -> bool:
    """Whether the variable is a continuous Real."""
    return variable.type == "Real" and (variable.variability or "continuous") == "continuous"


def attribute(variable: Any, name: str) -> float | None:
    """The attribute min, max or nominal of a variable or of its declared type; None if missing."""
    for owner in (variable, variable.declaredType):
        text = getattr(owner, name, None)
        if text is not None:
            with suppress(ValueError):
                return float(text)
    return None


def start_value(variable: Any) -> Any | None:
    """The start value as number, bool or text; None if missing or unreadable."""
    text = variable.start
    if text is None or variable.type == "String":
        return text
    with suppress(ValueError):
        if variable.type == "Boolean":
            return {"true": True, "1": True, "false": False, "0": False}.get(str(text).strip())
        return float(text) if variable.type == "Real" else int(float(text))
    return None


def start_of(variable: Any) -> float:
    """The start value of a Real; 0 if missing or not finite."""
    value = start_value(variable)
    return float(value) if value is not None and math.isfinite(value) else 0.0


def size_of(variable: Any) -> float:
    """Order of magnitude of a variable: nominal value, else start value, else 1."""
    return abs(attribute(variable, "nominal") or 0.0) or abs(start_of(variable)) or 1.0


def within(variable: Any, value: float) -> float:
    """The value, clipped to the bounds of the variable."""
    low, high = attribute(variable, "min"), attribute(variable, "max")
    return min(max(value, -math.inf if low is None else low), math.inf if high is None else high)


def moved(variable: Any, share: float) -> float:
    """Start value of a Real, changed by ``share`` of its size within its bounds; unchanged if the bounds allow no change."""
    start = start_of(variable)
    up = within(variable, start + share * size_of(variable))
    return up if up != start else within(variable, start - share * size_of(variable))


def other_value(variable: Any, share: float = 0.0213) -> Any | None:
    """A value other than the start value, see `moved` for Reals; None if there is none."""
    start = start_value(variable)
    # Real, Boolean, String
    if variable.type == "Real":
        value = moved(variable, share)
        return value if value != start else None
    if variable.type == "Boolean":
        return not start
    if variable.type == "String":
        return f"{start}x"
    # an enumeration has only its items
    if variable.type == "Enumeration":
        items = [int(item.value) for item in (variable.declaredType.items if variable.declaredType else None) or ()]
        return next((item for item in items if item != start), None)
    # an Integer within its bounds
    value = int(within(variable, int(start or 0) + 1))
    return value if value != start else None
