"""What sections of the scene file are made of: frozen, strict tables and quantities with units."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field


class Section(BaseModel):
    """A frozen section of the scene file: unknown keys, wrong types, NaN and infinity are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def quantity(unit: str, **bounds: Any) -> Any:
    """A field whose unit goes into error messages and documentation."""
    return Field(json_schema_extra={"unit": unit}, **bounds)


def as_tuple(value: Any) -> Any:
    """TOML arrays are lists; vectors are tuples."""
    return tuple(value) if isinstance(value, list) else value


def named_kind(value: Any) -> Any:
    """A table with nothing but a `kind` may be written as that word."""
    return {"kind": value} if isinstance(value, str) else value


def for_both(value: Any) -> Any:
    """One number stands for both joints."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return (value, value)
    if isinstance(value, (list, tuple)) and len(value) == 2:
        return tuple(value)
    raise ValueError(f"give one number for both joints, or a list of two, got {value!r}")


NotNegative = Annotated[float, Field(ge=0.0)]
NotNegativePerJoint = Annotated[tuple[NotNegative, NotNegative], BeforeValidator(for_both)]
"""A number for both joints, or one for each, always kept as two."""
Positive = Annotated[float, Field(gt=0.0)]
PositivePerJoint = Annotated[tuple[Positive, Positive], BeforeValidator(for_both)]
Seconds = Annotated[float, quantity("s", gt=0.0)]
SecondsOrZero = Annotated[float, quantity("s", ge=0.0)]
