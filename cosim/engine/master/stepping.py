"""Slaves advance over a communication step: one after the other, or again and again until they agree."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.engine.master.algorithms import Algorithm
from flexfmu.cosim.engine.master.couplings import Couplings, StepGroup, step_groups
from flexfmu.cosim.engine.master.ports import InputPort, OutputPort, columns
from flexfmu.cosim.engine.master.repeated_steps import LoopSignals, StateKeeper, check_can_save
from flexfmu.cosim.engine.master.system import System
from flexfmu.cosim.engine.slave import Indices, RealArray, Slave

REMEDY = "take a smaller communication step, a solver with more rounds or a larger tolerance"


@dataclass(frozen=True, slots=True)
class Stepper:
    """A slave that is advanced, with its ports."""

    index: int
    slave: Slave
    inputs: InputPort
    interpolating: bool
    outputs: OutputPort


class Stepping:
    """Advances all slaves that are stepped.

    Attributes:
        single: the slaves in order.
        iterates: whether some of them repeat steps until they agree.

    Raises:
        InputError: a slave would have to be repeated but can't go back.
    """

    def __init__(
        self,
        system: System,
        algorithm: Algorithm,
        ports: tuple[Sequence[InputPort], Sequence[OutputPort]],
        coupled: Couplings,
        active: c_int,
    ) -> None:
        self._active = active
        inputs, outputs = ports
        steppers = [
            Stepper(i, slave, inputs[i], bool(inputs[i].interpolating), outputs[i])
            for i, slave in enumerate(system.slaves)
        ]
        groups = step_groups(system, algorithm)
        self.single = single = [steppers[i] for group in groups for i in group.slaves]
        self.iterates = any(group.solver for group in groups)
        self._interpolating = [each.inputs for each in single if each.interpolating]
        # bound once: this is what a run spends its time with
        self._calls = [
            (
                each.index,
                each.inputs.interpolate if each.interpolating else None,
                each.slave.step,
                each.outputs.read,
            )
            for each in single
        ]
        self._groups = [self._group(system, group, steppers, coupled) for group in groups]
        self.advance = self._advance_groups if self.iterates else self._advance

    def reset(self) -> None:
        """Forget the solutions of a run before."""
        for group in self._groups:
            group.reset()

    def _advance(self, begin: float, end: float) -> None:
        """Step all slaves from one communication point to the next and read them."""
        step, active = end - begin, self._active
        for inputs in self._interpolating:
            inputs.remember()
        for index, interpolate, advance, read in self._calls:
            active.value = index
            if interpolate is not None:
                interpolate(step)
            advance(begin, step)
            read(end)

    def _advance_groups(self, begin: float, end: float) -> None:
        """The same, groups of slaves that feed each other again and again until they agree."""
        for inputs in self._interpolating:
            inputs.remember()
        for group in self._groups:
            group.advance(begin, end)

    def _group(
        self, system: System, group: StepGroup, steppers: Sequence[Stepper], coupled: Couplings
    ) -> IteratedGroup:
        """A group as it runs."""
        members = [steppers[i] for i in group.slaves]
        if group.solver is not None:
            check_can_save([each.slave for each in members], "repeating a step")
        unknowns: dict[OutputPort, tuple[Indices, int]] = {}
        for source in dict.fromkeys(each.source for each in group.torn):
            torn = [each for each in group.torn if each.source == source]
            rows = 1 + max(coupled[each.source, each.target].ends or 0 for each in torn)
            port = steppers[source].outputs
            unknowns[port] = np.unique(columns(port, torn)), rows
        name = ", ".join(system.describe(each) for each in group.torn)
        return IteratedGroup(group, name, members, LoopSignals(unknowns), self._active)


class IteratedGroup:
    """Slaves that are advanced together."""

    def __init__(
        self, group: StepGroup, name: str, members: Sequence[Stepper], signals: LoopSignals, active: c_int
    ) -> None:
        self._solver = group.solver
        self._name = name
        self._members = members
        self._signals = signals
        self._active = active

    def reset(self) -> None:
        """Forget the solutions of a run before."""
        self._signals.reset()

    def advance(self, begin: float, end: float) -> None:
        """Step to ``end`` so that what is assumed about the signals there comes back.

        Raises:
            LoopError: the iteration has not converged.
        """
        if self._solver is None:
            self._around(np.empty(0), begin, end)
            return
        with StateKeeper([each.slave for each in self._members]) as states:

            def around(values: RealArray) -> RealArray:
                states.restore()
                return self._around(values, begin, end)

            guess = self._signals.extrapolated(end - begin)
            solution = self._solver.solve(around, guess, self._signals.scale)
        self._signals.accept(solution, self._name, end, REMEDY)

    def _around(self, values: RealArray, begin: float, end: float) -> RealArray:
        """Advance every slave once with the signals at the end assumed; what comes back."""
        self._signals.scatter(values)
        for each in self._members:
            self._active.value = each.index
            if each.interpolating:
                each.inputs.interpolate(end - begin)
            each.slave.step(begin, end - begin)
            each.outputs.read(end)
        return self._signals.gather()
