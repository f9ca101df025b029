"""One function for each kind of controller, shaper and imperfection of the scene file: from its section to a block."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from flexfmu.cosim.controllers.computed_torque import computed_torque, inverse_dynamics_feedforward
from flexfmu.cosim.controllers.limits import Limits, symmetric
from flexfmu.cosim.controllers.linear_system import linear_system
from flexfmu.cosim.controllers.pd import pd
from flexfmu.cosim.controllers.pid import pid
from flexfmu.cosim.controllers.state_space import state_space
from flexfmu.cosim.errors import InputError
from flexfmu.cosim.imperfections.channels import Channel, joint_channels
from flexfmu.cosim.imperfections.delay import delay
from flexfmu.cosim.imperfections.jitter import jitter
from flexfmu.cosim.imperfections.lag import lag
from flexfmu.cosim.imperfections.noise import gaussian_noise
from flexfmu.cosim.imperfections.quantisation import encoder, quantisation
from flexfmu.cosim.imperfections.rate_limit import rate_limit
from flexfmu.cosim.imperfections.saturation import saturation
from flexfmu.cosim.loop import Names, PayloadError, Shaper, as_slave
from flexfmu.cosim.lqg import LqgWeights, lqg
from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.python_source import from_source
from flexfmu.cosim.sampled_fmu import fmu_slave
from flexfmu.cosim.slave import Slave
from flexfmu.model import scene_sections as sections
from flexfmu.model.block import SymbolicBlock
from flexfmu.model.scene import Scene


class LoopBuilder:
    """Makes the slaves of a scene's sections.

    Args:
        scene: the scene.
        motion: its planned motion, before shapers.
        names: gives every slave a name of its own.

    Attributes:
        connect: ``slave.input`` → source, from the sections made so far.
    """

    def __init__(self, scene: Scene, motion: MotionPlan, names: Names) -> None:
        self._scene, self._motion, self._names = scene, motion, names
        self.connect: dict[str, str] = {}

    def controller(self, section: Any) -> Slave:
        """The controller of a section.

        Raises:
            InputError: it can't be made.
        """
        match section:
            case sections.PdSection():
                make = partial(pd, section.proportional, section.derivative, limits=_limits(section.torque_limit))
            case sections.PidSection():
                make = partial(
                    pid,
                    section.proportional,
                    section.integral,
                    section.derivative,
                    filter_time=section.filter_time,
                    setpoint_weight=section.setpoint_weight,
                    derivative_weight=section.derivative_weight,
                    limits=_limits(section.torque_limit),
                )
            case sections.ComputedTorqueSection():
                inverse, limits = self._inverse_dynamics(section.payload), _limits(section.torque_limit)
                make = partial(computed_torque, inverse, section.proportional, section.derivative, limits=limits)
            case sections.FeedforwardSection():
                make = partial(inverse_dynamics_feedforward, self._inverse_dynamics(section.payload))
            case sections.StateFeedbackSection():
                weights = LqgWeights(
                    section.position_error,
                    section.velocity_error,
                    section.torque_deviation,
                    section.torque_noise,
                    section.measurement_noise,
                )
                limits = _limits(section.torque_limit)
                make = partial(lqg, self._scene, self._pose(section.pose), weights, limits=limits)
            case sections.StateSpaceSection():
                return self._slave(_state_space(section), section)
            case _:
                return self._custom(section)
        return self._slave(make(sample_time=section.sample_time, offset=section.offset), section)

    def shaper(self, section: Any) -> Any:
        """The shaper of a section: a `Shaper`, or a slave.

        Raises:
            InputError: it can't be made.
            TrajectoryError: it doesn't exist for these modes.
        """
        if not isinstance(section, sections.ImpulseShaperSection):
            return self._custom(section)
        from flexfmu.trajectories.shapers.catalogue import design
        from flexfmu.trajectories.shapers.oscillator import Oscillator

        given = section.modes
        modes = (
            self._modes_at_the_end(section.mode_count)
            if given is None
            else [Oscillator(mode.frequency, mode.ratio) for mode in given]
        )
        sequence = design(section.kind, modes)
        return Shaper(sequence, section.apply, section.sample_time, section.offset, section.name or "shaper")

    def imperfection(self, section: Any) -> Any:
        """The imperfection of a section: a slave, or a `PayloadError`.

        Raises:
            InputError: it can't be made.
        """
        if isinstance(section, sections.PayloadErrorSection):
            return PayloadError(section.relative)
        if isinstance(section, (sections.PythonSection, sections.FmuSection)):
            return self._custom(section)
        sampling = {"sample_time": section.sample_time or self._sample_time, "offset": section.offset}
        if isinstance(section, sections.EncoderSection):
            block = encoder(section.counts_per_turn, window=section.window, **sampling)
            return self._slave(block, section)
        channels = self._channels(section)
        match section:
            case sections.SaturationSection():
                limits = list(section.limit)
                block = saturation(channels, [-limit for limit in limits], limits, **sampling)
            case sections.RateLimitSection():
                block = rate_limit(channels, section.rate, **sampling)
            case sections.DelaySection():
                block = delay(channels, section.time, **sampling)
            case sections.QuantisationSection():
                block = quantisation(channels, section.resolution, **sampling)
            case sections.NoiseSection():
                name = section.name or "noise"  # the numbers depend on it
                block = gaussian_noise(channels, section.standard_deviation, section.seed, name=name, **sampling)
            case sections.JitterSection():
                name = section.name or "jitter"
                block = jitter(channels, section.time, section.seed, name=name, **sampling)
            case sections.LagSection():
                block = lag(channels, section.time_constant, **sampling)
        return self._slave(block, section)

    def _slave(self, block: SymbolicBlock, section: sections.LoopSection) -> Slave:
        """A block as a slave, named and connected as its section says."""
        return self._connected(as_slave(block, self._names, section.name), section)

    def _custom(self, section: Any) -> Slave:
        """A slave from Python or from an FMU."""
        if isinstance(section, sections.FmuSection):
            path = section.path
            named = self._names.unused(section.name) if section.name else self._names.of_file(path)
            return self._connected(fmu_slave(path, named, section.parameters), section)
        made = from_source(section.source, section.arguments)
        return self._connected(as_slave(made, self._names, section.name), section)

    def _connected(self, slave: Slave, section: sections.LoopSection) -> Slave:
        """The slave, its explicit connections noted; an input without a slave's name is its own."""
        own = {variable.name for variable in slave.variables if variable.causality == "input"}
        for target, source in section.connect.items():
            self.connect[f"{slave.name}.{target}" if target in own else target] = source
        return slave

    def _channels(self, section: Any) -> tuple[Channel, ...]:
        """The signals of a section, with their values before the start."""
        if section.signal == "torque":
            return joint_channels("torque", self._holding_torques)
        joints = self._start_angles
        if section.signal != "reference":
            return joint_channels(section.signal, joints if section.signal == "position" else (0.0, 0.0))
        names = ("joint1.reference", "joint2.reference")
        positions = joint_channels("position", joints, names)
        if not isinstance(section, (sections.DelaySection, sections.JitterSection, sections.LagSection)):
            return positions
        others = (joint_channels(kind, (0.0, 0.0), names) for kind in ("velocity", "acceleration"))
        return (*positions, *(channel for pair in others for channel in pair))

    @cached_property
    def _holding_torques(self) -> Sequence[float]:
        from flexfmu.cosim.loop_sections import holding_torques

        return tuple(holding_torques(self._scene).values())

    @property
    def _start_angles(self) -> Sequence[float]:
        return tuple(float(angle) for angle in self._motion.joints.evaluate(0.0, 0, "left")[0, 0])

    @property
    def _sample_time(self) -> float:
        """Sample time of imperfections that have none of their own [s]."""
        own = (getattr(section, "sample_time", None) for section in self._scene.controller)
        return next((time for time in own if time is not None), self._scene.cosimulation.step)

    def _inverse_dynamics(self, payload: float | None) -> Any:
        """Rigid inverse dynamics with the payload that a controller reckons with [kg]."""
        from flexfmu.model.rigid_dynamics import inverse_dynamics

        return inverse_dynamics(self._scene if payload is None else self._scene.replace({"payload.mass": payload}))

    def _pose(self, name: str) -> tuple[float, float]:
        """A point of the path [m]."""
        path = self._motion.along_path.path
        x, y = path.jets(np.array([{"start": 0.0, "middle": 0.5, "end": 1.0}[name] * path.length]), order=0)
        return float(x.value[0]), float(y.value[0])

    def _modes_at_the_end(self, count: int) -> list[Any]:
        """The lowest vibration modes at the end pose, where the residual vibration is."""
        from flexfmu.model.modes import damped_modes
        from flexfmu.trajectories.shapers.oscillator import Oscillator

        end = self._motion.joints.evaluate(self._motion.duration, 0, "left")[0, 0]
        found = damped_modes(self._scene, end)
        if len(found.frequencies) < count:
            raise InputError(
                f"`shaper.mode_count` = {count}, but scene {self._scene.name} has {len(found.frequencies)} modes that vibrate; "
                "take fewer, or name `modes`"
            )
        pairs = zip(found.frequencies[:count], found.ratios[:count], strict=True)
        return [Oscillator(float(frequency), float(ratio)) for frequency, ratio in pairs]


def _limits(limit: tuple[float, float] | None) -> Limits | None:
    """Symmetric torque limits."""
    return None if limit is None else symmetric(limit)


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
