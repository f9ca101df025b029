from collections.abc import Sequence
from flexfmu.model.scene.disturbances import BandNoiseSection
from flexfmu.model.scene.disturbances import CsvSection
from flexfmu.model.scene.disturbances import PayloadChangeSection
from flexfmu.model.scene.disturbances import PulseSection
from flexfmu.model.scene.disturbances import SineSection
from flexfmu.model.scene.disturbances import StepSection
from typing import Literal

__all__ = ['csv', 'noise', 'payload', 'pulse', 'sine', 'step']

def csv(
    *,
    name: str | None = ...,
    signal: Literal['force.x', 'force.y', 'joint1.disturbance', 'joint2.disturbance'],
    start: float = ...,
    duration: float | None = ...,
    sample_time: float | None = ...,
    file: str,
    column: str | None = ...,
    scale: float = ...,
) -> CsvSection: ...
def noise(
    *,
    name: str | None = ...,
    signal: Literal['force.x', 'force.y', 'joint1.disturbance', 'joint2.disturbance'],
    start: float = ...,
    duration: float | None = ...,
    sample_time: float | None = ...,
    standard_deviation: float,
    band: Sequence[float],
    components: int = ...,
    seed: int = ...,
) -> BandNoiseSection: ...
def payload(
    *,
    name: str | None = ...,
    mass: float | None = ...,
    picked_up: float | None = ...,
    dropped: float | None = ...,
) -> PayloadChangeSection: ...
def pulse(
    *,
    name: str | None = ...,
    signal: Literal['force.x', 'force.y', 'joint1.disturbance', 'joint2.disturbance'],
    start: float = ...,
    duration: float,
    amplitude: float,
) -> PulseSection: ...
def sine(
    *,
    name: str | None = ...,
    signal: Literal['force.x', 'force.y', 'joint1.disturbance', 'joint2.disturbance'],
    start: float = ...,
    duration: float | None = ...,
    sample_time: float | None = ...,
    amplitude: float,
    frequency: float,
    phase: float = ...,
) -> SineSection: ...
def step(
    *,
    name: str | None = ...,
    signal: Literal['force.x', 'force.y', 'joint1.disturbance', 'joint2.disturbance'],
    start: float = ...,
    duration: float | None = ...,
    amplitude: float,
) -> StepSection: ...
