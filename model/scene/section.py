"""Base class and field types of scene sections: strict, frozen tables and quantities with units."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field


class Section(BaseModel):
    """A frozen section of the scene file: unknown keys, wrong types, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)


def quantity(unit: str, **bounds: Any) -> Any:
    """A field with a unit, for error messages and documentation."""
    return Field(json_schema_extra={"unit": unit}, **bounds)


SMALLEST = 1e-9
"""Smallest admissible value of a length, density, stiffness or velocity of the model, in its SI unit."""

LARGEST = 1e9
"""Usual upper limit of a value of the model, in its SI unit."""


def _not_tiny(value: float) -> float:
    if value < SMALLEST:
        raise ValueError(f"must be at least {SMALLEST:g}, got {value:g}")
    return value


NOT_TINY = AfterValidator(_not_tiny)


def as_tuple(value: Any) -> Any:
    """The value as a tuple if it is a list: TOML arrays are lists, vectors are tuples."""
    return tuple(value) if isinstance(value, list) else value


def tuples(value: Any) -> Any:
    """Lists at all levels as tuples."""
    return tuple(map(tuples, value)) if isinstance(value, (list, tuple)) else value


def named_kind(value: Any) -> Any:
    """The table `{ kind = value }` for a text: a table with `kind` alone may be written as this text."""
    return {"kind": value} if isinstance(value, str) else value


def for_both(value: Any) -> Any:
    """A pair of values for both joints, from one number or a list of two.

    Raises:
        ValueError: the value is neither.
    """
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    if isinstance(value, (list, tuple)) and len(value) == 2:
        return tuple(value)
    raise ValueError(f"give one number for both joints, or a list of two, got {value!r}")


PerJoint = Annotated[tuple[float, float], BeforeValidator(for_both)]
NotNegative = Annotated[float, Field(ge=0.0)]
NotNegativePerJoint = Annotated[tuple[NotNegative, NotNegative], BeforeValidator(for_both)]
"""One number for both joints or one for each, stored as a pair."""
Positive = Annotated[float, Field(gt=0.0)]
PositivePerJoint = Annotated[tuple[Positive, Positive], BeforeValidator(for_both)]
Seconds = Annotated[float, quantity("s", gt=0.0)]
SecondsOrZero = Annotated[float, quantity("s", ge=0.0)]
