from collections.abc import Mapping
from collections.abc import Sequence
from flexfmu.model.scene.imperfections import BacklashSection
from flexfmu.model.scene.imperfections import DeadZoneSection
from flexfmu.model.scene.imperfections import DelaySection
from flexfmu.model.scene.imperfections import EncoderSection
from flexfmu.model.scene.imperfections import JitterSection
from flexfmu.model.scene.imperfections import LagSection
from flexfmu.model.scene.imperfections import NoiseSection
from flexfmu.model.scene.imperfections import ParameterErrorSection
from flexfmu.model.scene.imperfections import PayloadErrorSection
from flexfmu.model.scene.imperfections import QuantisationSection
from flexfmu.model.scene.imperfections import RateLimitSection
from flexfmu.model.scene.imperfections import SaturationSection
from typing import Any
from typing import Literal

__all__ = ['backlash', 'dead_zone', 'delay', 'encoder', 'jitter', 'lag', 'noise', 'parameter_error', 'payload_error', 'quantisation', 'rate_limit', 'saturation']

def backlash(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    gap: float | Sequence[float],
) -> BacklashSection: ...
def dead_zone(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    half_width: float | Sequence[float],
) -> DeadZoneSection: ...
def delay(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    time: float,
    interpolation: Literal['linear'] | Mapping[str, Any] = ...,
    known: bool = ...,
    longest: float | None = ...,
) -> DelaySection: ...
def encoder(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    counts_per_turn: float,
    window: int = ...,
    sample_time: float | None = ...,
    offset: float = ...,
) -> EncoderSection: ...
def jitter(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    time: float,
    seed: int = ...,
) -> JitterSection: ...
def lag(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    time_constant: float,
) -> LagSection: ...
def noise(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    standard_deviation: float | Sequence[float] | None = ...,
    half_width: float | Sequence[float] | None = ...,
    seed: int = ...,
) -> NoiseSection: ...
def parameter_error(
    *,
    parameters: Mapping[str, Any],
) -> ParameterErrorSection: ...
def payload_error(
    *,
    relative: float,
) -> PayloadErrorSection: ...
def quantisation(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    resolution: float | Sequence[float],
) -> QuantisationSection: ...
def rate_limit(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    rate: float | Sequence[float],
    falling_rate: float | Sequence[float] | None = ...,
) -> RateLimitSection: ...
def saturation(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    signal: Literal['torque', 'position', 'velocity', 'reference'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    limit: float | Sequence[float] | None = ...,
    lower: float | Sequence[float] | None = ...,
    upper: float | Sequence[float] | None = ...,
) -> SaturationSection: ...
