"""From the sections of a scene file to slaves: named, connected, and each with what it needs to know of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.lag import Lag
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.slave import Sampled, Slave
from flexfmu.cosim.experiment.loop import PayloadError, Shaper
from flexfmu.cosim.experiment.parameters import holding_torques
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.section_blocks import controller_block, imperfection_block
from flexfmu.cosim.experiment.user_slaves import Names, as_slave, from_source
from flexfmu.model.modes import damped_modes
from flexfmu.model.scene.imperfections import PayloadErrorSection
from flexfmu.model.scene.loop import FmuSection, LoopSection, PythonSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.shapers import ImpulseShaperSection, SpecifiedInsensitivitySection
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.shapers.catalogue import design
from flexfmu.trajectories.shapers.sequence import Oscillator
from flexfmu.trajectories.shapers.specified_insensitivity import specified_insensitivity

if TYPE_CHECKING:
    from flexfmu.trajectories.shapers.sequence import ImpulseSequence, Oscillator


class LoopBuilder:
    """Makes the slaves of a scene's sections.

    Args:
        scene: the scene.
        planned: its planned motion, before shapers.
        names: gives every slave a name of its own.

    Attributes:
        connect: ``slave.input`` → source, from the sections made so far.
    """

    def __init__(self, scene: Scene, planned: MotionPlan, names: Names) -> None:
        self._scene, self._planned, self._names = scene, planned, names
        self.connect: dict[str, str] = {}
        self._controllers: list[Slave] = []

    def controller(self, section: Any, motion: MotionPlan) -> Slave:
        """The controller of a section.

        Args:
            section: the section.
            motion: the motion with shapers, repeated where a controller learns.

        Raises:
            InputError: it can't be made.
        """
        custom = isinstance(section, (PythonSection, FmuSection))
        slave = self._custom(section) if custom else self._slave(controller_block(section, motion), section)
        self._controllers.append(slave)
        return slave

    def shaper(self, section: Any) -> Any:
        """The shaper of a section: a `Shaper`, or a slave.

        Raises:
            InputError: it can't be made.
            TrajectoryError: it doesn't exist for these modes.
        """
        if isinstance(section, (PythonSection, FmuSection)):
            return self._custom(section)
        return Shaper(
            self._impulses(section), section.apply, section.sample_time, section.offset, section.name or "shaper"
        )

    def imperfection(self, section: Any) -> Any:
        """The imperfection of a section: a slave, or a `PayloadError`.

        Raises:
            InputError: it can't be made.
        """
        if isinstance(section, PayloadErrorSection):
            return PayloadError(section.relative)
        if isinstance(section, (PythonSection, FmuSection)):
            return self._custom(section)
        name = self._names.chosen(section.name, section.kind.replace("-", "_"))
        made = imperfection_block(section, name, self._sample_time, self._before)
        return self._connected(made if isinstance(made, Lag) else BlockSlave(made, name), section)

    def _slave(self, block: SymbolicBlock, section: LoopSection) -> Slave:
        """A block as a slave, named and connected as its section says."""
        return self._connected(as_slave(block, self._names, section.name), section)

    def _custom(self, section: PythonSection | FmuSection) -> Slave:
        """A slave from Python or from an FMU."""
        if isinstance(section, FmuSection):
            path = section.path
            named = self._names.of_file(path, section.name)
            slave = fmu_slave(
                path,
                named,
                section.parameters,
                sample_time=section.sample_time,
                offset=section.offset,
                output_order=section.output_order,
            )
            return self._connected(slave, section)
        made = from_source(section.source, section.arguments, section.folder)
        return self._connected(as_slave(made, self._names, section.name), section)

    def _connected(self, slave: Slave, section: LoopSection) -> Slave:
        """The slave, its explicit connections noted; an input without a slave's name is its own, misspelt or not."""
        own = {variable.name for variable in slave.variables if variable.causality == "input"}
        heads = {head for name in own if (head := name.partition(".")[0]) not in self._names}
        for target, source in section.connect.items():
            head, dot, _ = target.partition(".")
            is_own = target in own or not dot or head in heads
            self.connect[f"{slave.name}.{target}" if is_own else target] = source
        return slave

    def _before(self, kind: str) -> Sequence[float]:
        """Values of both joints before the start, at rest; no torques for a robot that is driven by its motion."""
        if kind == "torque":
            return self._holding_torques
        if kind == "position":
            return tuple(float(angle) for angle in self._planned.joints.evaluate(0.0, 0, "left")[0, 0])
        return (0.0, 0.0)

    @cached_property
    def _holding_torques(self) -> Sequence[float]:
        return tuple(holding_torques(self._scene).values())

    @property
    def _sample_time(self) -> float:
        """Sample time of imperfections that have none of their own [s]; the controllers have been made."""
        own = (slave.sample_time for slave in self._controllers if isinstance(slave, Sampled))
        return next(own, self._scene.cosimulation.step)

    def _impulses(self, section: ImpulseShaperSection | SpecifiedInsensitivitySection) -> ImpulseSequence:
        """The impulses that a section asks for."""
        if isinstance(section, SpecifiedInsensitivitySection):
            return specified_insensitivity(*section.band, section.tolerance, section.ratio)
        if section.modes is None:
            return design(section.kind, self._modes_at_the_end(section.mode_count))
        return design(section.kind, [Oscillator(mode.frequency, mode.ratio) for mode in section.modes])

    def _modes_at_the_end(self, count: int) -> list[Oscillator]:
        """The lowest vibration modes at the end pose, where the residual vibration is."""
        end = self._planned.joints.evaluate(self._planned.duration, 0, "left")[0, 0]
        found = damped_modes(self._scene, end)
        if len(found.frequencies) < count:
            raise InputError(
                f"`shaper.mode_count` = {count}, but scene {self._scene.name} has {len(found.frequencies)} modes that vibrate; "
                "take fewer, or name `modes`"
            )
        pairs = zip(found.frequencies[:count], found.ratios[:count], strict=True)
        return [Oscillator(float(frequency), float(ratio)) for frequency, ratio in pairs]
