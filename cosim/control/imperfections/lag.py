"""First-order lag, as of a current loop or an amplifier, in continuous time or sampled."""

from __future__ import annotations

from math import ceil, exp, expm1, factorial, isfinite

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.code import bound, evaluation
from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.blocks.slave import slave_variable
from flexfmu.cosim.control.controllers.joints import PerJoint
from flexfmu.cosim.control.imperfections.channels import REFERENCE_KINDS, Channels, recall, remember
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.binding import Copy, Take
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import Call, Indices, RealArray
from flexfmu.fmu_build.codegen import MAX_INPUT_ORDER
from flexfmu.model.scene.imperfections import LagSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

SAMPLES = 10
"""Least number of samples per time constant where a continuous lag is exported as a sampled block."""


class Lag:
    """Slave T y' + y = u in continuous time, exact for inputs that are polynomials over a communication step.

    With z = h / T and phi_k(x) = sum of x^j / (j + k)! (M. Hochbruck, A. Ostermann, Exponential integrators, Acta
    Numerica 19, 2010, section 2.1)::

        y(t + h) = exp(-z) y(t) + sum of u_k h^k z phi_k+1(-z)        u(t + s) = sum of u_k s^k / k!

    The output derivatives y' = (u - y) / T, y'' = (u' - y') / T .. determine the robot's input polynomial over a step.
    For steps up to T the polynomial's error is 3e-10 of a jump of the input. No output has direct feedthrough, which
    breaks algebraic loops.

    Args:
        section: T [s], 1 / (2 pi f) for a bandwidth f [Hz], and the signal.
        context: the loop's.

    Attributes:
        largest_step: largest admissible step, the shortest time constant [s].
        latency: output → its time constant [s].
    """

    max_input_order = max_output_order = MAX_INPUT_ORDER
    rates_follow_inputs = True

    def __init__(self, section: LagSection, context: LoopContext) -> None:
        self._section, self._context, self.name = section, context, context.name
        self._channels = channels = Channels(section, context, REFERENCE_KINDS)
        times = _time_constants(channels, section.time_constant)
        self.variables = tuple(map(slave_variable, (*channels.inputs, *times, *channels.outputs)))
        self.feedthrough: dict[str, tuple[str, ...]] = {each.name: () for each in channels.outputs}
        self._initial = np.array([each or 0.0 for each in channels.initial])
        # inputs with their derivatives (1 + orders, n), and outputs (n,)
        self._u = np.zeros((1 + MAX_INPUT_ORDER, len(channels)))
        self._u[0] = self._y = self._initial.copy()
        self._buffers: list[object] = []
        self._order = 0
        self._times = np.empty(len(channels))
        self._set_times(np.array([each.start or 0.0 for each in times]))

    def _set_times(self, times: RealArray) -> None:
        """Set the time constants (n,) [s].

        Raises:
            InputError: one isn't positive and finite.
        """
        for channel, time in zip(self._channels.outputs, times.tolist(), strict=True):
            if not (isfinite(time) and time > 0.0):
                raise InputError(
                    f"{self.name}: the time constant of {channel.name} must be positive, got {time} s; leave the lag out"
                )
        self._times[:] = times
        self.largest_step = float(times.min())
        self.latency = {each.name: time for each, time in zip(self._channels.outputs, times.tolist(), strict=True)}

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        """Set the outputs to their initial values."""
        self._y[:] = self._initial

    def terminate(self) -> None:
        """Reset the inputs to their start values."""
        self._u[:] = 0.0
        self._u[0] = self._initial

    def set(self, indices: Indices, values: RealArray) -> None:
        """Set inputs, which are constant unless their derivatives are set next, and time constants.

        Raises:
            InputError: a variable is an output, or a time constant isn't positive.
        """
        n = len(self._channels)
        if (indices >= 2 * n).any():
            raise InputError(f"{self.name}: only inputs and time constants can be set")
        # an input without derivatives is constant
        fed = indices < n
        self._u[0, indices[fed]] = values[fed]
        self._u[1 : self._order + 1, indices[fed]] = 0.0
        # time constants
        if not fed.all():
            times = self._times.copy()
            times[indices[~fed] - n] = values[~fed]
            self._set_times(times)

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Set derivatives (orders, n) of inputs."""
        self._order = max(self._order, len(derivatives))
        self._u[1 : len(derivatives) + 1, indices] = derivatives

    def get(self, indices: Indices, values: RealArray) -> None:
        """Write the variables' values into ``values`` (k,)."""
        values[:] = np.concatenate((self._u[0], self._times, self._y))[indices]

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        """Write the derivatives (orders, n) of outputs: y^(k+1) = (u^(k) - y^(k)) / T."""
        columns = indices - 2 * len(self._channels)
        times, last = self._times[columns], self._y[columns]
        for k in range(len(derivatives)):
            last = derivatives[k] = (self._u[k, columns] - last) / times

    def bind_set(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that sets inputs from ``values`` (n,); raise `InputError` if a variable is no input."""
        if (indices >= len(self._channels)).any():
            raise InputError(f"{self.name}: only inputs can be connected; set time constants before the run")
        return Copy(values, self._u[0], indices)

    def bind_set_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Return a call that sets derivatives of inputs from ``derivatives`` (orders, n)."""
        self._order = max(self._order, len(derivatives))
        places = len(self._channels) * np.arange(1, len(derivatives) + 1)[:, None] + indices
        return Copy(derivatives.reshape(-1), self._u.reshape(-1), places.ravel())

    def bind_get(self, indices: Indices, values: RealArray) -> Call:
        """Return a call that writes variables into ``values`` (n,)."""
        places = indices - 2 * len(self._channels)
        return Take(self._y, places, values) if (places >= 0).all() else lambda: self.get(indices, values)

    def bind_get_derivatives(self, indices: Indices, derivatives: RealArray) -> Call:
        """Return a call that writes derivatives of outputs into ``derivatives`` (orders, n): those of `get_derivatives`."""
        # the recurrence of all orders as one function of inputs, outputs and time constants
        orders, n = len(derivatives), len(self._channels)
        u, y, times = (casadi.SX.sym(name, size) for name, size in (("u", orders * n), ("y", n), ("T", n)))
        columns = (indices - 2 * n).tolist()
        last, rows = y[columns], []
        for k in range(orders):
            last = (u[[k * n + column for column in columns]] - last) / times[columns]
            rows.append(last)
        function = casadi.Function("derivatives", [u, y, times], [casadi.vertcat(*rows)])
        arguments = (self._u.reshape(-1)[: orders * n], self._y, self._times)
        buffer, call = bound(function, arguments, (derivatives.reshape(-1),))
        self._buffers.append(buffer)
        return evaluation(function, call) or call

    def step(self, time: float, step: float) -> None:
        """Advance the outputs exactly, and shift the input polynomials to the end of the step."""
        z, order = step / self._times, self._order
        # constant inputs
        if not order:
            self._y[:] = self._u[0] + (self._y - self._u[0]) * np.exp(-z)
            return
        # polynomial inputs: formula of the class
        powers = step ** np.arange(order + 1.0)
        weights = np.array([_phi(-each, order + 1) for each in z.tolist()]).T
        self._y[:] = weights[0] * self._y + z * ((powers[:, None] * self._u[: order + 1]) * weights[1:]).sum(axis=0)
        # Taylor shift of the input polynomials to the end of the step
        for k in range(order):
            terms = [powers[j] / factorial(j) for j in range(order + 1 - k)]
            self._u[k] = terms @ self._u[k : order + 1]

    def save(self) -> object:
        """Return inputs with their derivatives, outputs and order."""
        return self._u.copy(), self._y.copy(), self._order

    def restore(self, state: object) -> None:
        """Set the state that `save` returned.

        Raises:
            InputError: the state belongs to another slave.
        """
        if not (isinstance(state, tuple) and len(state) == 3):
            raise InputError(f"{self.name}: this state was not saved by this slave")
        self._u[:], self._y[:], self._order = state

    def sampled(self, step: float) -> SymbolicBlock:
        """Return the lag as a block, at least `SAMPLES` samples per time constant, a whole number per ``step`` [s]."""
        sample_time = step / ceil(SAMPLES * step / self.largest_step - 1e-9)
        section = self._section.model_copy(update={"sample_time": sample_time})
        return _block(section, self._context, self._times.tolist())


def _phi(x: float, highest: int) -> list[float]:
    """Return phi_0 .. phi_highest at x <= 0 by the recurrence phi_k = 1 / k! + x phi_k+1.

    It runs upwards, dividing by x, for large |x|, and downwards, multiplying by x, for small |x|.
    """
    # upwards from phi_0
    if x < -1.0:
        found = [exp(x)]
        for k in range(highest):
            found.append((found[k] - 1.0 / factorial(k)) / x)
        return found
    # downwards from a series that converges fast at small x
    last = sum(x**j / factorial(j + highest) for j in range(20))
    found = [last]
    for k in reversed(range(highest)):
        found.append(1.0 / factorial(k) + x * found[-1])
    return found[::-1]


def lag_latency(time: float, sample_time: float) -> float:
    """Mean delay [s] of the impulse response of a lag with a time constant [s] that is sampled."""
    return sample_time / -expm1(-sample_time / time) if time else sample_time


@builds(LagSection)
def lag(s: LagSection, context: LoopContext) -> SymbolicBlock | Lag:
    """Build the slave of a lag in continuous time, or with a sample time the block T y' + y = u.

    The block is exact for inputs that are constant between the samples. With sample time h and a = exp(-h / T)::

        y_k+1 = a y_k + (1 - a) u_k

    (zero-order-hold equivalent: G. F. Franklin, J. D. Powell, M. L. Workman, Digital Control of Dynamic Systems, 3rd
    ed. 1998, section 4.3). The output is a staircase, half a sample late on average; a sample time of T / 10 models a current loop
    well. The block has no direct feedthrough, which breaks algebraic loops. The time constants are parameters
    ``<channel>.time_constant``; zero is a delay of one sample.
    """
    return Lag(s, context) if s.sample_time is None else _block(s, context, s.time_constant)


def _block(s: LagSection, context: LoopContext, time_constant: PerJoint) -> SymbolicBlock:
    """The sampled lag, with one time constant [s] for all channels or one for each."""
    channels = Channels(s, context, REFERENCE_KINDS)
    n, h, times = len(channels), channels.h, _time_constants(channels, time_constant)

    def law(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        time, initial = p[:n], p[n:]
        y = recall(x, channels.start(initial, u))
        return y, remember(u + casadi.exp(-h / time) * (y - u))

    late = [lag_latency(each.start or 0.0, h) for each in times]
    return channels.block("First-order lag", law, [*times, *channels.starts], memory=n, latency=late)


def _time_constants(channels: Channels, values: PerJoint) -> list[Variable]:
    """Parameters ``<channel>.time_constant``."""
    return channels.numbers("time_constant", values, "the time constant", minimum=0.0, unit="s")
