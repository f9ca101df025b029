"""From the sections of controllers in a scene file to their blocks."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from flexfmu.cosim.controllers import anti_windup
from flexfmu.cosim.controllers.computed_torque import computed_torque, inverse_dynamics_feedforward
from flexfmu.cosim.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.controllers.limits import Limits, symmetric
from flexfmu.cosim.controllers.linear_system import linear_system
from flexfmu.cosim.controllers.pd import pd
from flexfmu.cosim.controllers.pid import pid
from flexfmu.cosim.controllers.state_space import state_space
from flexfmu.cosim.cycles import samples_in_a_cycle
from flexfmu.cosim.lqg import LqgWeights, lqg
from flexfmu.cosim.planning import MotionPlan
from flexfmu.model import controller_sections as sections
from flexfmu.model.block import SymbolicBlock


def controller_block(section: Any, motion: MotionPlan) -> SymbolicBlock:
    """The block of a controller's section.

    Args:
        section: one of `flexfmu.model.controller_sections`, but for slaves of the user's own.
        motion: the planned motion, repeated where a controller learns.

    Raises:
        InputError: it can't be made.
    """
    match section:
        case sections.PdSection():
            make = partial(pd, section.proportional, section.derivative, limits=_limits(section))
        case sections.PidSection():
            make = partial(
                pid,
                section.proportional,
                section.integral,
                section.derivative,
                filter_time=section.filter_time,
                setpoint_weight=section.setpoint_weight,
                derivative_weight=section.derivative_weight,
                limits=_limits(section),
                anti_windup=_anti_windup(section.anti_windup),
            )
        case sections.ComputedTorqueSection():
            inverse = _inverse_dynamics(motion, section.payload)
            make = partial(computed_torque, inverse, section.proportional, section.derivative, limits=_limits(section))
        case sections.FeedforwardSection():
            make = partial(inverse_dynamics_feedforward, _inverse_dynamics(motion, section.payload))
        case sections.LearningSection():
            samples = samples_in_a_cycle(motion, section.sample_time)
            lead, forgetting = section.lead, section.forgetting
            make = partial(iterative_learning, section.gain, samples, shift=lead, forgetting=forgetting)
        case sections.StateFeedbackSection():
            make = partial(lqg, motion.scene, _pose(motion, section.pose), _weights(section), limits=_limits(section))
        case sections.StateSpaceSection():
            return _state_space(section)
    return make(sample_time=section.sample_time, offset=section.offset)


def _limits(section: Any) -> Limits | None:
    """Symmetric torque limits."""
    return None if section.torque_limit is None else symmetric(section.torque_limit)


def _anti_windup(section: sections.AntiWindup) -> anti_windup.AntiWindup:
    """What the integral does at the limits."""
    if isinstance(section, sections.BackCalculation):
        return anti_windup.BackCalculation(section.tracking_time)
    return anti_windup.Clamping() if section.kind == "clamping" else anti_windup.Unprotected()


def _inverse_dynamics(motion: MotionPlan, payload: float | None) -> Any:
    """Rigid inverse dynamics with the payload that a controller reckons with [kg]."""
    from flexfmu.model.rigid_dynamics import inverse_dynamics

    return inverse_dynamics(motion.scene if payload is None else motion.scene.replace({"payload.mass": payload}))


def _pose(motion: MotionPlan, name: str) -> tuple[float, float]:
    """A point of the path [m]."""
    path = motion.along_path.path
    x, y = path.jets(np.array([{"start": 0.0, "middle": 0.5, "end": 1.0}[name] * path.length]), order=0)
    return float(x.value[0]), float(y.value[0])


def _weights(section: sections.StateFeedbackSection) -> LqgWeights:
    """What counts as one unit of cost."""
    return LqgWeights(
        section.position_error,
        section.velocity_error,
        section.torque_deviation,
        section.torque_noise,
        section.measurement_noise,
    )


def _state_space(section: sections.StateSpaceSection) -> SymbolicBlock:
    """A linear system with the matrices of the scene file."""
    system = linear_system(
        section.A,
        section.B,
        section.C,
        section.D,
        sample_time=section.sample_time,
        inputs=section.inputs,
        outputs=section.outputs,
    )
    return state_space(system, offset=section.offset)
