"""From the sections of controllers and imperfections in a scene file to their blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypedDict

import numpy as np

from flexfmu.cosim.control.controllers import anti_windup
from flexfmu.cosim.control.controllers.computed_torque import computed_torque, inverse_dynamics_feedforward
from flexfmu.cosim.control.controllers.iterative_learning import iterative_learning
from flexfmu.cosim.control.controllers.limits import Limits, symmetric
from flexfmu.cosim.control.controllers.linear_system import linear_system, state_space
from flexfmu.cosim.control.controllers.pd import pd
from flexfmu.cosim.control.controllers.pid import pid
from flexfmu.cosim.control.imperfections import delay_filter
from flexfmu.cosim.control.imperfections.channels import Channel, joint_channels
from flexfmu.cosim.control.imperfections.delay import delay
from flexfmu.cosim.control.imperfections.jitter import jitter
from flexfmu.cosim.control.imperfections.lag import Lag, lag
from flexfmu.cosim.control.imperfections.noise import gaussian_noise, uniform_noise
from flexfmu.cosim.control.imperfections.quantisation import encoder, quantisation
from flexfmu.cosim.control.imperfections.rate_limit import rate_limit
from flexfmu.cosim.control.imperfections.saturation import saturation
from flexfmu.cosim.control.lqg import LqgWeights, lqg
from flexfmu.cosim.experiment.cycles import samples_in_a_cycle
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.model.numeric import inverse_dynamics
from flexfmu.model.scene import controllers, imperfections
from flexfmu.model.symbolic import SymbolicBlock


def controller_block(section: Any, motion: MotionPlan) -> SymbolicBlock:
    """The block of a controller's section.

    Args:
        section: one of `flexfmu.model.scene.controllers`, but for slaves of the user's own.
        motion: the planned motion, repeated where a controller learns.

    Raises:
        InputError: it can't be made.
    """
    match section:
        case controllers.PdSection():
            make = partial(pd, section.proportional, section.derivative, limits=_limits(section))
        case controllers.PidSection():
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
        case controllers.ComputedTorqueSection():
            inverse = _inverse_dynamics(motion, section.payload)
            make = partial(computed_torque, inverse, section.proportional, section.derivative, limits=_limits(section))
        case controllers.FeedforwardSection():
            make = partial(inverse_dynamics_feedforward, _inverse_dynamics(motion, section.payload))
        case controllers.LearningSection():
            samples = samples_in_a_cycle(motion, section.sample_time)
            lead, forgetting = section.lead, section.forgetting
            make = partial(iterative_learning, section.gain, samples, shift=lead, forgetting=forgetting)
        case controllers.StateFeedbackSection():
            make = partial(lqg, motion.scene, _pose(motion, section.pose), _weights(section), limits=_limits(section))
        case controllers.StateSpaceSection():
            return _state_space(section)
    return make(sample_time=section.sample_time, offset=section.offset)


def _limits(section: Any) -> Limits | None:
    """Symmetric torque limits."""
    return None if section.torque_limit is None else symmetric(section.torque_limit)


def _anti_windup(section: controllers.AntiWindup) -> anti_windup.AntiWindup:
    """What the integral does at the limits."""
    if isinstance(section, controllers.BackCalculation):
        return anti_windup.BackCalculation(section.tracking_time)
    return anti_windup.Clamping() if section.kind == "clamping" else anti_windup.Unprotected()


def _inverse_dynamics(motion: MotionPlan, payload: float | None) -> Any:
    """Rigid inverse dynamics with the payload that a controller assumes [kg]."""
    return inverse_dynamics(motion.scene if payload is None else motion.scene.replace({"payload.mass": payload}))


def _pose(motion: MotionPlan, name: str) -> tuple[float, float]:
    """A point of the path [m]."""
    path = motion.along_path.path
    x, y = path.jets(np.array([{"start": 0.0, "middle": 0.5, "end": 1.0}[name] * path.length]), order=0)
    return float(x.value[0]), float(y.value[0])


def _weights(section: controllers.StateFeedbackSection) -> LqgWeights:
    """What counts as one unit of cost."""
    return LqgWeights(
        section.position_error,
        section.velocity_error,
        section.torque_deviation,
        section.torque_noise,
        section.measurement_noise,
    )


def _state_space(section: controllers.StateSpaceSection) -> SymbolicBlock:
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


class Sampling(TypedDict):
    """When a block samples [s]."""

    sample_time: float
    offset: float


def imperfection_block(
    section: Any, name: str, sample_time: float, before: Callable[[str], Sequence[float]]
) -> SymbolicBlock | Lag:
    """The block of an imperfection's section; a slave for a lag without a sample time.

    Args:
        section: one of `flexfmu.model.scene.imperfections`, but for slaves of the user's own and payload errors.
        name: name of the slave; random numbers follow from it.
        sample_time: [s] of a section that has none of its own.
        before: kind of signal (``position``, ``torque`` ...) → values of both joints before the first sample; none for
            those of the first sample.

    Raises:
        InputError: it can't be made.
    """
    sampling = Sampling(sample_time=section.sample_time or sample_time, offset=section.offset)
    if isinstance(section, imperfections.EncoderSection):
        return encoder(section.counts_per_turn, window=section.window, **sampling)
    channels = _channels(section, before)
    match section:
        case imperfections.SaturationSection(bounds=(lower, upper)):
            return saturation(channels, lower, upper, **sampling)
        case imperfections.RateLimitSection():
            return rate_limit(channels, section.rate, section.falling_rate, **sampling)
        case imperfections.DelaySection():
            return delay(channels, section.time, interpolation=_interpolation(section.interpolation), **sampling)
        case imperfections.QuantisationSection():
            return quantisation(channels, section.resolution, **sampling)
        case imperfections.NoiseSection(half_width=None):
            return gaussian_noise(channels, section.standard_deviation or 0.0, section.seed, name=name, **sampling)
        case imperfections.NoiseSection():
            return uniform_noise(channels, section.half_width or 0.0, section.seed, name=name, **sampling)
        case imperfections.JitterSection():
            return jitter(channels, section.time, section.seed, name=name, **sampling)
    if section.sample_time is None:
        return Lag(channels, section.time_constant, name)
    return lag(channels, section.time_constant, **sampling)


def _interpolation(section: imperfections.Interpolation) -> delay_filter.Interpolation:
    """How a signal is found between its samples."""
    match section:
        case imperfections.Lagrange():
            return delay_filter.Lagrange(section.order)
        case imperfections.Thiran():
            return delay_filter.Thiran(section.order)
    return delay_filter.LINEAR


def _channels(section: Any, before: Callable[[str], Sequence[float]]) -> tuple[Channel, ...]:
    """The signals of a section, with their values before the start."""
    if section.signal != "reference":
        return joint_channels(section.signal, before(section.signal))
    names = ("joint1.reference", "joint2.reference")
    delays = isinstance(section, (imperfections.DelaySection, imperfections.JitterSection, imperfections.LagSection))
    kinds = ("position", "velocity", "acceleration") if delays else ("position",)
    return tuple(channel for kind in kinds for channel in joint_channels(kind, before(kind), names))
