"""A user's Python function as a sampled slave: for functions that CasADi can't trace."""

from __future__ import annotations

import re
import traceback
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from flexfmu.cosim.control.blocks.slave import SampledMemory
from flexfmu.cosim.engine.errors import InputError, SlaveError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.symbolic import Variable


class FunctionSlave(SampledMemory):
    """Calls a function (states with the counter of samples, inputs, parameters) → (outputs, next states) at its instants.

    Args:
        name: name of the slave.
        function: the function, of arrays.
        variables: inputs, parameters and outputs.
        states: start values.
        sample_time, offset: [s].
        reason: why it isn't a block.

    Attributes:
        has_foreign_code: True, as the function is the user's.
    """

    has_foreign_code = True

    def __init__(
        self,
        name: str,
        function: Callable[[RealArray, RealArray, RealArray], tuple[Any, Any]],
        variables: tuple[Sequence[Variable], Sequence[Variable], Sequence[Variable]],
        states: Sequence[float],
        sample_time: float,
        offset: float,
        reason: str,
    ) -> None:
        super().__init__(name, *variables, states=len(states) + 1)
        self.reason, self.sample_time, self.offset = reason, sample_time, offset
        # the last state counts the samples
        self._function, self._start, self._end = function, np.array([*states, 0.0]), len(self.variables)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set the start states and calculate the outputs."""
        self._memory[self._end :] = self._start
        self._calculate(start_time)

    def sample(self, time: float) -> None:
        """Calculate outputs and next states from the inputs just set.

        Raises:
            SlaveError: the function fails, or a value isn't finite.
        """
        following = self._calculate(time)
        self._memory[self._end : -1] = following
        self._memory[-1] += 1.0

    def _calculate(self, time: float) -> RealArray:
        """Set the outputs and return the next states."""
        # copies, so that the function can't change what it gets
        values = self._memory.copy()
        inputs, parameters, states = values[: self._inputs], values[self._inputs : self._known], values[self._end :]
        try:
            outputs, following = self._function(states, inputs, parameters)
        except Exception as error:
            raise SlaveError(self.name, described(error), time) from error
        if not (np.isfinite(outputs).all() and np.isfinite(following).all()):
            names = [each.name for each in self.variables[self._known :]]
            wrong = [name for name, value in zip(names, outputs, strict=True) if not np.isfinite(value)]
            raise SlaveError(self.name, f"{wrong[0] if wrong else 'the next state'} isn't finite", time)
        self._memory[self._known : self._end] = outputs
        next_states: RealArray = following
        return next_states


def described(error: BaseException | None) -> str:
    """Type and first line of an error, and the last line of the user's code on the way to it; of our own errors the sentence."""
    if isinstance(error, InputError):
        return str(error)
    frames = traceback.extract_tb(error.__traceback__) if error else []
    own = [each for each in frames if "/casadi/" not in each.filename and "/numpy/" not in each.filename]
    where = f" ({own[-1].filename}, line {own[-1].lineno})" if own else ""
    lines = [re.sub(r"^\S*\.cpp:\d+: ", "", line) for line in str(error).splitlines() if line.strip()]
    return f"{type(error).__name__}: {lines[0] if lines else ''}{where}"
