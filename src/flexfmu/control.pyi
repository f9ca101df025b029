from collections.abc import Mapping
from collections.abc import Sequence
from flexfmu.cosim.control.controllers.from_control import control_block as control_block
from flexfmu.cosim.control.controllers.from_control import from_control as from_control
from flexfmu.cosim.control.controllers.state_feedback import Equilibrium as Equilibrium
from flexfmu.cosim.control.controllers.state_feedback import state_feedback as state_feedback
from flexfmu.cosim.control.controllers.state_feedback import static_feedforward as static_feedforward
from flexfmu.model.linear import operating_point as operating_point
from flexfmu.model.scene.controllers import CFunctionSection
from flexfmu.model.scene.controllers import CascadeSection
from flexfmu.model.scene.controllers import ComputedTorqueSection
from flexfmu.model.scene.controllers import DisturbanceObserverSection
from flexfmu.model.scene.controllers import FeedforwardSection
from flexfmu.model.scene.controllers import FrictionCompensationSection
from flexfmu.model.scene.controllers import GravityFeedforwardSection
from flexfmu.model.scene.controllers import HInfinitySection
from flexfmu.model.scene.controllers import LearningSection
from flexfmu.model.scene.controllers import PdSection
from flexfmu.model.scene.controllers import PidSection
from flexfmu.model.scene.controllers import StateFeedbackSection
from flexfmu.model.scene.controllers import StateSpaceSection
from flexfmu.model.scene.loop import FmuSection
from flexfmu.model.scene.loop import PythonSection
from typing import Any
from typing import Literal

__all__ = ['Equilibrium', 'c_function', 'cascade', 'computed_torque', 'control_block', 'disturbance_observer', 'feedforward', 'fmu', 'friction_compensation', 'from_control', 'gravity_feedforward', 'h_infinity', 'learning', 'lqg', 'operating_point', 'pd', 'pid', 'python', 'state_feedback', 'state_space', 'static_feedforward']

def c_function(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    source: str | Sequence[str],
    function: str = ...,
    inputs: Sequence[str],
    outputs: Sequence[str],
    parameters: Mapping[str, Any] | None = ...,
    states: Sequence[float] = ...,
    units: Mapping[str, Any] | None = ...,
) -> CFunctionSection: ...
def cascade(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    position: Mapping[str, Any],
    velocity: Mapping[str, Any],
    current: Mapping[str, Any] | None = ...,
    torque_limit: float | Sequence[float] | None = ...,
    anti_windup: Literal['clamping', 'none'] | Mapping[str, Any] = ...,
) -> CascadeSection: ...
def computed_torque(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    proportional: float | Sequence[float],
    derivative: float | Sequence[float],
    payload: float | None = ...,
    torque_limit: float | Sequence[float] | None = ...,
) -> ComputedTorqueSection: ...
def disturbance_observer(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    time_constant: float | Sequence[float],
    inertia: float | Sequence[float] | None = ...,
    payload: float | None = ...,
    torque_limit: float | Sequence[float] | None = ...,
) -> DisturbanceObserverSection: ...
def feedforward(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    robot: Literal['rigid', 'flexible'] = ...,
    correction: Sequence[float | Sequence[float]] = ...,
    payload: float | None = ...,
) -> FeedforwardSection: ...
def fmu(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    path: str,
    parameters: Mapping[str, Any] | None = ...,
    sample_time: float | None = ...,
    offset: float = ...,
    output_order: int | None = ...,
) -> FmuSection: ...
def friction_compensation(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    viscous: float | Sequence[float] | None = ...,
    coulomb: float | Sequence[float] | None = ...,
    velocity: float | None = ...,
    motion: Literal['reference', 'measured'] = ...,
) -> FrictionCompensationSection: ...
def gravity_feedforward(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    motion: Literal['reference', 'measured'] = ...,
    payload: float | None = ...,
) -> GravityFeedforwardSection: ...
def h_infinity(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    pose: Literal['start', 'middle', 'end'] = ...,
    bandwidth: float | Sequence[float],
    integral_time: float | Sequence[float] | None = ...,
    torque_limit: float | Sequence[float] | None = ...,
) -> HInfinitySection: ...
def learning(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    law: Literal['proportional', 'norm-optimal'] = ...,
    gain: float | Sequence[float] | None = ...,
    cycles: int,
    lead: int = ...,
    forgetting: float = ...,
    q_filter: float | Literal['auto', 'none'] | None = ...,
    payload_error: float = ...,
    regularisation: float = ...,
    payload: float | None = ...,
    response: Sequence[Sequence[Sequence[Sequence[float]]]] | None = ...,
) -> LearningSection: ...
def lqg(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    pose: Literal['start', 'middle', 'end'] = ...,
    position_error: float | Sequence[float] = ...,
    velocity_error: float | Sequence[float] = ...,
    torque_deviation: float | Sequence[float] = ...,
    torque_noise: float = ...,
    measurement_noise: float = ...,
    torque_limit: float | Sequence[float] | None = ...,
) -> StateFeedbackSection: ...
def pd(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    proportional: float | Sequence[float],
    derivative: float | Sequence[float],
    torque_limit: float | Sequence[float] | None = ...,
    schedule: Mapping[str, Any] | None = ...,
) -> PdSection: ...
def pid(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    proportional: float | Sequence[float],
    integral: float | Sequence[float],
    derivative: float | Sequence[float],
    filter_time: float | Sequence[float] = ...,
    setpoint_weight: float = ...,
    derivative_weight: float = ...,
    initial_torque: float | Sequence[float] | None = ...,
    torque_limit: float | Sequence[float] | None = ...,
    anti_windup: Literal['clamping', 'none'] | Mapping[str, Any] = ...,
    schedule: Mapping[str, Any] | None = ...,
) -> PidSection: ...
def python(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    source: str,
    folder: str = ...,
    arguments: Mapping[str, Any] | None = ...,
) -> PythonSection: ...
def state_space(
    *,
    name: str | None = ...,
    connect: Mapping[str, Any] | None = ...,
    sample_time: float,
    offset: float = ...,
    A: Sequence[Sequence[float]],
    B: Sequence[Sequence[float]],
    C: Sequence[Sequence[float]],
    D: Sequence[Sequence[float]] | None = ...,
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> StateSpaceSection: ...
