from collections.abc import Mapping
from collections.abc import Sequence
from flexfmu.cosim.control.shapers import Shaper as Shaper
from flexfmu.model.scene.shapers import ImpulseShaperSection
from flexfmu.model.scene.shapers import SpecifiedInsensitivitySection
from flexfmu.trajectories.shapers.designs import extra_insensitive as extra_insensitive
from flexfmu.trajectories.shapers.designs import modified_zero_vibration as modified_zero_vibration
from flexfmu.trajectories.shapers.designs import specified_insensitivity as specified_insensitivity
from flexfmu.trajectories.shapers.designs import unity_magnitude as unity_magnitude
from flexfmu.trajectories.shapers.designs import zero_vibration as zero_vibration
from flexfmu.trajectories.shapers.sequence import ImpulseSequence as ImpulseSequence
from flexfmu.trajectories.shapers.sequence import Oscillator as Oscillator
from typing import Any
from typing import Literal

__all__ = ['ImpulseSequence', 'Oscillator', 'Shaper', 'ei', 'extra_insensitive', 'modified_zero_vibration', 'mzv', 'si', 'specified_insensitivity', 'three_hump_ei', 'two_hump_ei', 'um_zv', 'unity_magnitude', 'zero_vibration', 'zv', 'zvd', 'zvdd', 'zvddd']

def ei(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def mzv(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def si(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    band: Sequence[float],
    tolerance: float = ...,
    ratio: float = ...,
) -> SpecifiedInsensitivitySection: ...
def three_hump_ei(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def two_hump_ei(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def um_zv(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def zv(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def zvd(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def zvdd(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
def zvddd(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    apply: Literal['joints', 'path', 'sampled'] = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    modes: Literal['along-path'] | Sequence[Mapping[str, Any]] | None = ...,
    mode_count: int = ...,
) -> ImpulseShaperSection: ...
