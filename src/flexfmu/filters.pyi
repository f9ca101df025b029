from collections.abc import Mapping
from collections.abc import Sequence
from flexfmu.model.scene.filters import BiquadSection
from flexfmu.model.scene.filters import HighPassSection
from flexfmu.model.scene.filters import LeadLagSection
from flexfmu.model.scene.filters import LowPassSection
from flexfmu.model.scene.filters import NotchSection
from typing import Any
from typing import Literal

__all__ = ['biquad', 'high_pass', 'lead_lag', 'low_pass', 'notch']

def biquad(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    numerator: Sequence[float],
    denominator: Sequence[float],
    prewarp: float | None = ...,
) -> BiquadSection: ...
def high_pass(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    frequency: float | None = ...,
    at: str | None = ...,
    pose: Literal['start', 'middle', 'end'] = ...,
    order: int = ...,
) -> HighPassSection: ...
def lead_lag(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    zero: float,
    pole: float,
) -> LeadLagSection: ...
def low_pass(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    frequency: float | None = ...,
    at: str | None = ...,
    pose: Literal['start', 'middle', 'end'] = ...,
    order: int = ...,
) -> LowPassSection: ...
def notch(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    frequency: float | None = ...,
    at: str | None = ...,
    pose: Literal['start', 'middle', 'end'] = ...,
    damping: float = ...,
    depth: float = ...,
) -> NotchSection: ...
