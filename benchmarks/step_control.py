"""Step control against fixed steps: the requested error, the true error, and the cost of both.

Three systems that are coupled by extrapolation: an oscillator split at a spring, with a closed form; the torque-driven robot
with a spring and damper at its end effector as a slave of its own; the same with the spring's other end on a trajectory. The
robots' references exchange two derivatives in steps of 50 µs (2e-7 from an implicit coupling), at the very instants of the run.
Errors are those of all signals that are passed on by a slave with states, relative to the largest magnitude of each. A
fixed step of the same error is interpolated between runs with fixed steps; times are CPU times.

    python benchmarks/step_control.py [--quick] [--check]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from math import factorial
from time import process_time

import numpy as np

from flexfmu import load_scene
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.outcome import Simulation
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import System, connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene

FMU_TOLERANCE = 1e-9
REFERENCE_STEP = 5e-5
RATIOS, COST = (0.1, 3.0), 4.0
"""Limits of error / tolerance, and of CPU time over that of fixed steps with the same error."""

HIGHEST = 3
"""Input derivatives that the slaves in Python take."""


class Polynomials:
    """A slave whose inputs are polynomials; what it saves are these and its state."""

    def __init__(
        self, name: str, inputs: Sequence[SlaveVariable], outputs: Sequence[SlaveVariable], order: int
    ) -> None:
        self.name, self.variables = name, (*inputs, *outputs)
        self.max_output_order, self.max_input_order = order, min(2 * order + 1, HIGHEST) if order else 0
        self.fed, self.state = np.zeros((HIGHEST + 1, len(inputs))), np.zeros(2)
        self.fed[0] = [each.start or 0.0 for each in inputs]

    def set(self, indices: Indices, values: RealArray) -> None:
        self.fed[:, indices] = 0.0
        self.fed[0, indices] = values

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.fed[1 : len(derivatives) + 1, indices] = derivatives

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.outputs(0)[0, indices - self.fed.shape[1]]

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        derivatives[:] = self.outputs(len(derivatives))[1:, indices - self.fed.shape[1]]

    def outputs(self, order: int) -> RealArray:
        """(order + 1, outputs): values and derivatives."""
        raise NotImplementedError

    def step(self, time: float, step: float) -> None:
        powers = np.array([step**k / factorial(k) for k in range(HIGHEST + 1)])
        self.fed = np.array([powers[: HIGHEST + 1 - k] @ self.fed[k:] for k in range(HIGHEST + 1)])

    def save(self) -> object:
        return self.fed.copy(), self.state.copy()

    def restore(self, state: tuple[RealArray, RealArray]) -> None:
        self.fed, self.state = state[0].copy(), state[1].copy()


class Mass(Polynomials):
    """x'' = coupling (u - x) - stiffness x with 1 kg, solved exactly."""

    feedthrough = {"x": (), "v": ()}  # noqa: RUF012

    def __init__(self, name: str, start: float, order: int, stiffness: float = 4.0, coupling: float = 9.0) -> None:
        x, v = SlaveVariable("x", "output", "m"), SlaveVariable("v", "output", "m/s")
        super().__init__(name, [SlaveVariable("u", "input", "m", 0.0)], [x, v], order)
        self.start, self.square, self.coupling = start, stiffness + coupling, coupling

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.state = np.array([self.start, 0.0])

    def outputs(self, order: int) -> RealArray:
        x = [*self.state]
        for k in range(order):
            x.append(self.coupling * self.fed[k, 0] - self.square * x[k])
        return np.array([x[: order + 1], x[1:]]).T

    def step(self, time: float, step: float) -> None:
        def particular() -> RealArray:
            u = self.fed[:, 0] * self.coupling / self.square
            return u[:2] - u[2:] / self.square

        (x, v), w = self.state - particular(), np.sqrt(self.square)
        super().step(time, step)
        c, s = np.cos(w * step), np.sin(w * step)
        self.state = particular() + np.array([c * x + s * v / w, c * v - s * w * x])


class Spring(Polynomials):
    """Spring and damper between the end effector and an anchor."""

    def __init__(self, order: int, stiffness: float, damping: float, anchor: tuple[float, float]) -> None:
        ends = {"": (0.0, 0.0), "anchor.": anchor}
        inputs = [
            SlaveVariable(f"{end}{kind}.{axis}", "input", unit, start if kind == "position" else 0.0)
            for end, starts in ends.items()
            for kind, unit in (("position", "m"), ("velocity", "m/s"))
            for axis, start in zip("xy", starts, strict=True)
        ]
        super().__init__("spring", inputs, [SlaveVariable(f"force.{axis}", "output", "N") for axis in "xy"], order)
        self.stiffness, self.damping = stiffness, damping

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None: ...

    def outputs(self, order: int) -> RealArray:
        x, v, anchor, rate = np.split(self.fed[: order + 1], 4, axis=1)
        return self.stiffness * (anchor - x) + self.damping * (rate - v)


class Instants:
    """Does nothing at instants that must be hit."""

    name = "instants"
    variables = (SlaveVariable("y", "output"),)

    def __init__(self, breakpoints: Sequence[float]) -> None:
        self.breakpoints = tuple(breakpoints)

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None: ...
    def set(self, indices: Indices, values: RealArray) -> None: ...
    def step(self, time: float, step: float) -> None: ...
    def restore(self, state: object) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = 0.0

    def save(self) -> object:
        return None


Parts = tuple[list[object], list[tuple[str, str]]]


@dataclass(frozen=True)
class Case:
    """A system that is coupled with an error.

    Attributes:
        name: for people.
        parts: slaves and connections, given how many derivatives are exchanged.
        signals: whose error counts.
        stop: [s].
    """

    name: str
    parts: Callable[[int], Parts]
    signals: tuple[str, ...]
    stop: float

    def system(self, order: int) -> System:
        """The slaves wired together, with that many derivatives."""
        return connect(*self.parts(order))

    def exact(self, times: RealArray) -> RealArray:
        """(signals, N): the solution."""
        return solution(self.name, tuple(times.tolist()), REFERENCE_STEP)

    def solve(self, times: RealArray, step: float) -> RealArray:
        """The same, calculated, for a robot in steps of so many seconds."""
        if self.name == "oscillator":
            together, apart = (np.cos(w * times) for w in np.sqrt([4.0, 22.0]))
            return np.array([(together + apart) / 2.0, (together - apart) / 2.0])
        slaves, wires = self.parts(2)
        system = connect([*slaves, Instants(times)], wires)
        run = simulate(system, self.stop, step, tolerance=1e-2 * FMU_TOLERANCE)
        assert run.outcome is Outcome.COMPLETED, run.message
        at = np.searchsorted(run.recording.time, times)
        np.testing.assert_array_equal(run.recording.time[at], times)
        return np.array([run.recording[name].values[at] for name in self.signals])

    def error(self, run: Simulation) -> float:
        """Largest error relative to the largest magnitude of each signal; infinite for a run that failed."""
        if run.outcome is not Outcome.COMPLETED:
            return np.inf
        times, first = np.unique(run.recording.time, return_index=True)
        found = np.array([run.recording[name].values[first] for name in self.signals])
        exact = self.exact(times)
        return float((abs(found - exact).max(axis=1) / abs(exact).max(axis=1)).max())


def oscillator(order: int) -> Parts:
    """Two masses of 1 kg, the first displaced by 1 m."""
    return [Mass("left", 1.0, order), Mass("right", 0.0, order)], [("left.x", "right.u"), ("right.x", "left.u")]


ENDS = tuple(f"{kind}.{axis}" for kind in ("position", "velocity") for axis in "xy")
ROBOT = load_scene("barnard2012-0.1kg").replace({"cosimulation.drive": "torque"})


def pulled_robot(order: int, *, stiffness: float = 2e3, damping: float = 20.0) -> Parts:
    """The robot with the torques that hold its start pose, pulled 32 mm away from there."""
    spring = Spring(order, stiffness, damping, (-0.15, 0.30))
    wires = [(f"plant.end_effector.{end}", f"spring.{end}") for end in ENDS]
    forces = [(f"spring.force.{axis}", f"plant.force.{axis}") for axis in "xy"]
    return [FmuSlave(build_scene(ROBOT).path, "plant"), spring], wires + forces


def led_robot(order: int) -> Parts:
    """The same, led along its trajectory by a stiffer spring."""
    (plant, spring), wires = pulled_robot(order, stiffness=1e4, damping=50.0)
    led = [
        (f"trajectory.{axis}.reference.{kind}", f"spring.anchor.{kind}.{axis}")
        for axis in "xy"
        for kind in ("position", "velocity")
    ]
    return [TrajectorySlave(plan(ROBOT).task, ("x", "y"), "m", order), plant, spring], wires + led


END_SIGNALS = tuple(f"plant.end_effector.{end}" for end in ENDS)
CASES = {
    "oscillator": Case("oscillator", oscillator, ("left.x", "right.x"), 2.0),
    "robot with a spring": Case("robot with a spring", pulled_robot, END_SIGNALS, 0.5),
    "robot led by a trajectory": Case("robot led by a trajectory", led_robot, END_SIGNALS, 0.55),
}


@cache
def solution(case: str, times: tuple[float, ...], step: float) -> RealArray:
    """(signals, N): the solution of a case, once for each grid."""
    return CASES[case].solve(np.array(times), step)


@dataclass(frozen=True)
class Row:
    """Step control beside a fixed step of the same error."""

    case: str
    order: int
    tolerance: float
    error: float
    steps: int
    seconds: float
    fixed_steps: float
    fixed_seconds: float

    @property
    def cost(self) -> float:
        """CPU time over that of the fixed step."""
        return self.seconds / self.fixed_seconds


def timed(action: Callable[[], Simulation], repetitions: int) -> tuple[Simulation, float]:
    """A run and its least CPU time [s]."""
    times = []
    for _ in range(repetitions):
        begin = process_time()
        run = action()
        times.append(process_time() - begin)
    return run, min(times)


def controlled(case: Case, order: int, tolerance: float, repetitions: int = 3) -> tuple[float, int, float]:
    """Error, steps and CPU time [s] with step control."""
    system, control = case.system(order), StepDoubling(tolerance)
    action = partial(simulate, system, case.stop, 1e-3, tolerance=FMU_TOLERANCE, step_control=control)
    run, seconds = timed(action, repetitions)
    return case.error(run), run.steps, seconds


def fixed(case: Case, order: int, error: float) -> tuple[float, float]:
    """Steps and CPU time [s] of a fixed step with that error, between the nearest ones that have been tried."""
    system, count, tried = case.system(order), 32, []
    while not tried or tried[-1][1] > error:
        run, seconds = timed(partial(simulate, system, case.stop, case.stop / count, tolerance=FMU_TOLERANCE), 3)
        tried.append((count, case.error(run), seconds))
        count *= 2
    tried = [each for each in tried if np.isfinite(each[1])][-2:]
    counts, errors, times = np.log(np.array(tried).T)
    return tuple(np.exp([np.interp(-np.log(error), -errors, each) for each in (counts, times)]))


def row(case: Case, order: int, tolerance: float) -> Row:
    """One line of the table."""
    error, steps, seconds = controlled(case, order, tolerance)
    return Row(case.name, order, tolerance, error, steps, seconds, *fixed(case, order, error))


TRIALS = [
    ("oscillator", 0, (1e-1, 1e-2, 1e-3)),
    ("oscillator", 1, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
    ("oscillator", 2, (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)),
    ("robot with a spring", 0, (1e-1, 1e-2)),
    ("robot with a spring", 1, (1e-2, 1e-3, 1e-4, 1e-5)),
    ("robot led by a trajectory", 0, (1e-1, 1e-2)),
    ("robot led by a trajectory", 1, (1e-2, 1e-3, 1e-4, 1e-5)),
]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave out the tightest tolerances")
    parser.add_argument("--check", action="store_true", help=f"end with status 1 beyond {RATIOS} or a cost of {COST:g}")
    options = parser.parse_args()
    met = True
    print("| system | derivatives | tolerance | error / tolerance | steps | fixed steps | CPU time / fixed |")
    print("| :-- | --: | --: | --: | --: | --: | --: |")
    for name, order, tolerances in TRIALS:
        for tolerance in tolerances[:2] if options.quick else tolerances:
            r = row(CASES[name], order, tolerance)
            met = met and RATIOS[0] < r.error / r.tolerance < RATIOS[1] and r.cost < COST
            print(
                f"| {r.case} | {r.order} | {r.tolerance:g} | {r.error / r.tolerance:.2f} | {r.steps} | {r.fixed_steps:.0f} | "
                f"{r.cost:.1f} |",
                flush=True,
            )
    if options.check and not met:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
