"""Runs a discrete-time block as a slave: a controller, a shaper or an imperfection."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.code import block_function, bound, evaluation
from flexfmu.cosim.engine.binding import Copy, Evaluation, Phase, Reevaluation, SampleCall, Take, is_range
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Call, Indices, RealArray, SlaveVariable
from flexfmu.fmu_build.block_build import check_block
from flexfmu.model.symbolic import SymbolicBlock, Variable


class SampledMemory:
    """Variables of a sampled slave in one array: inputs, parameters, outputs, then its states.

    Args:
        name: name of the slave.
        inputs, parameters, outputs: its variables.
        states: number of its states.
    """

    def __init__(
        self,
        name: str,
        inputs: Sequence[Variable],
        parameters: Sequence[Variable],
        outputs: Sequence[Variable],
        states: int,
    ) -> None:
        self.name, self._fed, self._parameters = name, tuple(inputs), tuple(parameters)
        known = (*inputs, *parameters)
        self.variables = tuple(slave_variable(each) for each in (*known, *outputs))
        self._inputs, self._known = len(inputs), len(known)
        self._memory = np.zeros(len(self.variables) + states)
        self._memory[: self._known] = [each.start or 0.0 for each in known]

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs and parameters (n,).

        Raises:
            InputError: a variable is an output, or a parameter's value isn't finite or is out of range.
        """
        for index, value in zip(indices.tolist(), values.tolist(), strict=True):
            if index >= self._known:
                raise InputError(f"{self.name}.{self.variables[index].name} is an output and can't be set")
            if index >= self._inputs:
                check_parameter(self._parameters[index - self._inputs], value, self.name)
        self._memory[indices] = values

    def get(self, indices: Indices, values: RealArray) -> None:
        """Write the variables' values into ``values`` (n,)."""
        self._memory.take(indices, None, values, "clip")

    def step(self, time: float, step: float) -> None:
        """Do nothing: the outputs are constant between the sample instants."""

    def terminate(self) -> None:
        """Reset the inputs to their start values, so that the next run repeats this one to the last bit."""
        self._memory[: self._inputs] = [each.start or 0.0 for each in self._fed]

    def save(self) -> RealArray:
        """Return a copy of inputs, parameters, outputs and states."""
        return self._memory.copy()

    def restore(self, state: object) -> None:
        """Set the state that `save` returned.

        Raises:
            InputError: the state belongs to another slave.
        """
        if not isinstance(state, np.ndarray) or state.shape != self._memory.shape:
            raise InputError(f"{self.name}: this state was not saved by this slave")
        self._memory[:] = state


class BlockSlave(SampledMemory):
    """Samples a block at its instants and holds the outputs in between.

    Variables are the block's inputs, parameters and outputs, in this order. Before the first sample instant the outputs
    are those of the start states and of the inputs at initialisation. A sample is one call of one
    function on fixed buffers, without allocation.

    Args:
        block: the block.
        name: name of the slave; the block's own by default.
        compiled: True to evaluate in compiled C, False in CasADi's virtual machine; None compiles large blocks.

    Raises:
        ModelError: the block contradicts its contract: sample time, offset, start states or shapes.
        InputError: two variables share a name, or a parameter is out of range.
        MissingCompilerError, CompileError: it can't be compiled.
    """

    def __init__(self, block: SymbolicBlock, name: str = "", *, compiled: bool | None = None) -> None:
        check_block(block)
        check_variables(block)
        super().__init__(
            name or block.name, block.inputs, block.parameters, block.outputs, states=2 * len(block.states)
        )
        # the attributes that the master reads
        self.block = block
        self.sample_time, self.offset, self.instants = block.sample_time, block.offset, block.instants
        self.feedthrough, self.latency = dict(block.feedthrough), dict(block.latency)
        self.has_foreign_code = bool(block.c_files)
        # the function reads and writes the memory in place: variables, states, next states
        self._states, self._next = self._memory[len(self.variables) :].reshape(2, -1)
        self._seen = np.zeros(self._inputs)
        # calls of the function on these buffers: output and update together, and each alone
        self._buffers: list[object] = []
        self._function = function = block_function(block, compiled)
        self._sample = self._bound(function, output=True, update=True)
        self._output = self._bound(function, output=True, update=False)
        self._update = self._bound(function, output=False, update=True)

    @property
    def is_continuous(self) -> bool:
        """Whether the outputs follow the inputs continuously as far as is known: no foreign code, and nothing is rounded."""
        rounding = (casadi.OP_FLOOR, casadi.OP_CEIL)
        functions = () if self.has_foreign_code else (self.block.output, self.block.update)
        operations = (each.instruction_id(k) for each in functions for k in range(each.n_instructions()))
        return bool(functions) and not any(operation in rounding for operation in operations)

    def _bound(self, function: casadi.Function, output: bool, update: bool) -> Call:
        """Bind the function (x, u, p) → (y, next x) to the slave's memory; the call writes the chosen results."""
        inputs, parameters, outputs, _ = np.split(self._memory, [self._inputs, self._known, len(self.variables)])
        results = (outputs if output else None, self._next if update else None)
        buffer, call = bound(function, (self._states, inputs, parameters), results)
        self._buffers.append(buffer)  # the call needs a living buffer
        return call

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set the start states and calculate the outputs; inputs and parameters keep their values."""
        self._states[:] = self.block.states
        self._output()

    def sample(self, time: float) -> None:
        """Calculate outputs and next states from the inputs just set."""
        self._sample()
        self._states[:] = self._next

    def output(self, time: float) -> None:
        """Calculate outputs from the states and the inputs set so far."""
        self._output()

    def update(self, time: float) -> None:
        """Calculate the next states from the inputs just set."""
        self._update()
        self._states[:] = self._next

    def sample_calls(self, phase: Phase) -> tuple[SampleCall, ...] | None:
        """The evaluations of a sample and copies; None if C can't evaluate the block.

        With states the outputs are evaluated together with the next states, and these again only if inputs change later.
        """
        found = evaluation(self._function, self._update if phase == "update" else self._sample)
        if found is None:
            return None
        if not self._next.size:
            return () if phase == "update" else (found,)
        # what is copied: next states to states, inputs to those seen at the output
        count, inputs = self._inputs, self._memory[: self._inputs]
        move = Copy(self._next, self._states, np.arange(self._next.size))
        see = (Copy(inputs, self._seen, np.arange(count)),) if count else ()
        again = (Reevaluation(found, inputs, self._seen),) if count else ()
        return {"sample": (found, move), "output": (found, *see), "update": (*again, move)}[phase]

    def reset(self) -> None:
        """Set start values of inputs and states, and zero elsewhere but for parameters."""
        self.terminate()
        self._memory[self._known :] = self._seen[:] = 0.0
        self._states[:] = self.block.states

    def initial_call(self) -> Evaluation | None:
        """The evaluation of the outputs at initialisation; None if C can't evaluate the block."""
        return evaluation(self._function, self._output)

    def buffers(self, call: Evaluation) -> tuple[RealArray | None, ...]:
        """x, u, p, y and next x of an evaluation of this slave; None where it writes nothing."""
        inputs, parameters, outputs, _ = np.split(self._memory, [self._inputs, self._known, len(self.variables)])
        mine = (
            (each, found)
            for each in ("_sample", "_output", "_update")
            if (found := evaluation(self._function, getattr(self, each))) is not None
        )
        kind = next(name for name, found in mine if found.argument.value == call.argument.value)
        has_output, has_update = kind != "_update", kind != "_output"
        return self._states, inputs, parameters, outputs if has_output else None, self._next if has_update else None

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that sets inputs from ``values`` (n,).

        Raises:
            InputError: a variable is no input.
        """
        if (indices >= self._inputs).any():
            raise InputError(f"{self.name}: only inputs can be connected; set parameters before the run")
        return Copy(values, self._memory, indices)

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that writes variables into ``values`` (n,)."""
        memory = self._memory
        if is_range(indices):
            return Copy(memory[indices[0] : indices[-1] + 1], values, np.arange(indices.size))

        return Take(memory, indices, values)


def check_variables(block: SymbolicBlock) -> None:
    """Check names and parameters of a block.

    Raises:
        InputError: two variables share a name, or a parameter's start isn't finite or is out of range.
    """
    where = f"block {block.name!r}"
    names = [variable.name for variable in (*block.inputs, *block.parameters, *block.outputs)]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{where}: two variables are named {name!r}; give each its own name")
    for parameter in block.parameters:
        check_parameter(parameter, parameter.start, where)


def check_parameter(variable: Variable, value: float | None, where: str) -> None:
    """Check a parameter's value against its range.

    Raises:
        InputError: the value is missing, not finite or out of range.
    """
    if value is None or not isfinite(value):
        raise InputError(f"{where}: {variable.name} must be a finite number in {variable.unit}, got {value}")
    if variable.minimum is not None and value < variable.minimum:
        raise InputError(f"{where}: {variable.name} must be at least {variable.minimum} {variable.unit}, got {value}")
    if variable.maximum is not None and value > variable.maximum:
        raise InputError(f"{where}: {variable.name} must be at most {variable.maximum} {variable.unit}, got {value}")


def slave_variable(variable: Variable) -> SlaveVariable:
    """Return the variable as the master sees it; a variable without a unit connects to any unit, as in an FMU."""
    unit = "" if variable.unit == "1" else variable.unit
    return SlaveVariable(variable.name, variable.causality, unit, variable.start)
