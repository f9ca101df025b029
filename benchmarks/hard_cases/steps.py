"""Communication steps of extreme length, references that jump between steps, a controller whose gain is too high for its step, and
motors with stiction that stop and break away.

The references are constant over each step, so that SciPy solves the same piecewise constant problem, restarted at every jump. With
stiction it is a hybrid system: each motor sticks or slips in one direction, `solve_ivp` locates the event that ends the mode, and
the next mode is the one with the fewest slipping motors that contradicts neither torques nor accelerations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from flexfmu.benchmarks.hard_cases.case import (
    ALLOWED,
    ERROR,
    NOT_FINITE,
    STEP,
    TOLERANCE,
    CaseReport,
    Criterion,
    HardCase,
    fmu_of,
    not_finite,
    paper_robot,
)
from flexfmu.benchmarks.hard_cases.scipy_solution import Phase, Solver, signals_of_constant_references
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.plants import build_model
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene

SIGNALS = ("end_effector.position.x", "end_effector.position.y", "link11.tip_deflection", "link21.tip_deflection")
"""Outputs that are compared; all lengths [m]."""

REFERENCES = tuple(
    f"joint{leg}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for leg in (1, 2)
)
"""Inputs, in the order of u = [q_a, v_a, a_a]."""

SOLVER = Solver("DOP853", 1e-10)


DAMPING = 0.01
"""Modal damping ratio of the links, small so that vibrations last."""


@dataclass(frozen=True)
class StepwiseRun:
    """The paper's robot, little damped, from links that are straight and at rest.

    Attributes:
        times: (N + 1,) communication points [s]; the first is 0.
        references: (N, 6) u over each step.
    """

    times: RealArray
    references: RealArray

    def outputs(self) -> RealArray:
        """(N, signals) of the FMU at the ends of the steps.

        Raises:
            SlaveError: the FMU fails.
        """
        plant = FmuSlave(fmu_of(paper_robot()), "plant", {"initial": "undeformed", "damping.ratio": DAMPING})
        known = [variable.name for variable in plant.variables]
        inputs, outputs = (
            np.array([known.index(name) for name in names], dtype=np.intp) for names in (REFERENCES, SIGNALS)
        )
        found = np.empty((self.times.size - 1, outputs.size))
        # inputs of the first step hold during initialisation
        plant.set(inputs, self.references[0])
        try:
            plant.initialize(0.0, float(self.times[-1]), TOLERANCE)
            for n, (begin, end) in enumerate(pairwise(self.times.tolist())):
                plant.set(inputs, self.references[n])
                plant.step(begin, end - begin)
                plant.get(outputs, found[n])
        finally:
            plant.terminate()
        return found

    def reference(self, size: float) -> RealArray:
        """(N, signals) by SciPy; ``size`` is about how far links deflect [m]."""
        damped = paper_robot().replace({"effects.damping.ratio": DAMPING})
        # intervals of constant references; each instant belongs to the one that ends there
        changes = np.flatnonzero(np.any(np.diff(self.references, axis=0) != 0.0, axis=1)) + 1
        edges = [0, *changes.tolist(), self.times.size - 1]
        phases = [Phase(float(self.times[a]), float(self.times[b]), self.references[a]) for a, b in pairwise(edges)]
        return signals_of_constant_references(paper_robot(), damped, phases, SIGNALS, self.times[1:], SOLVER, size)


def start_references() -> RealArray:
    """u (6,) of the paper's start pose, locked."""
    robot = paper_robot()
    return np.concatenate([motor_angles(robot.mechanism, robot.start), np.zeros(4)])


TINY, TINY_STEPS = 1e-9, 10_000
"""Length [s] and number of the shortest steps."""

JUMP = 0.02
"""Jump of the joint angles [rad], physically impossible for a motor."""

ACCELERATION = 200.0
"""Joint acceleration [rad/s2], switched on and off."""


def step_cases() -> Iterator[HardCase]:
    """Steps of 1 ns and 1 s, and references that jump."""
    tiny = f"{TINY_STEPS} steps: links bend by 0.5 nm; 1 ns is 2e-5 of the shortest period"
    huge = "18 800 periods of the fastest mode in one communication step"
    jumps = f"joint angles jump by {1e3 * JUMP:g} mrad, accelerations by {ACCELERATION:g} rad/s2, in steps of 1 ms without input derivatives"
    yield HardCase("steps of 1 ns", tiny, partial(_run_stepwise, tiny_steps))
    yield HardCase("a step of 1 s", huge, partial(_run_stepwise, huge_step))
    yield HardCase("inputs that jump", jumps, partial(_run_stepwise, jumping_inputs))


def tiny_steps() -> StepwiseRun:
    """Straight links begin to bend under the weight."""
    times = TINY * np.arange(TINY_STEPS + 1, dtype=np.float64)
    return StepwiseRun(times, np.tile(start_references(), (TINY_STEPS, 1)))


def huge_step() -> StepwiseRun:
    """Free vibration under the weight."""
    return StepwiseRun(np.array([0.0, 1.0]), start_references()[np.newaxis])


def jumping_inputs() -> StepwiseRun:
    """Angles jump forth and back, then accelerations, in steps of 1 ms."""
    references = np.tile(start_references(), (60, 1))
    references[10:30, :2] += JUMP, -JUMP
    references[20:40, 4:] += ACCELERATION, -ACCELERATION
    return StepwiseRun(1e-3 * np.arange(61, dtype=np.float64), references)


def _run_stepwise(make: Callable[[], StepwiseRun]) -> CaseReport:
    """Against SciPy, each signal relative to its own range."""
    run = make()
    # the FMU, and SciPy with an absolute tolerance that follows from the deflections
    found = run.outputs()
    size = float(np.abs(found[:, 2:]).max())
    expected = run.reference(size)
    # deflections relative to their own range, the end effector relative to the deflections
    error = float((np.abs(found - expected)[:, 2:].max(axis=0) / np.abs(expected[:, 2:]).max(axis=0)).max())
    position = float(np.abs(found - expected)[:, :2].max()) / size
    bent = f"steps completed: {len(found)}; links bend by up to {size:.2g} m"
    checks = (
        Criterion(f"{ERROR} (DOP853)", error, ALLOWED),
        Criterion("error of the end effector", position, ALLOWED),
        Criterion(NOT_FINITE, float(np.count_nonzero(~np.isfinite(found))), 0.0),
    )
    return CaseReport(bent, checks)


INERTIA = 0.1
"""Inertia of each motor [kg.m2]."""

PROPORTIONAL, DERIVATIVE = 1e4, 300.0
"""Gains of the PD controller [N.m/rad], [N.m.s/rad]."""

SHORT_STEP = 1e-4
"""Step and sample time [s] at which the loop with the same gains is stable."""

STABILITY_STEPS = (STEP, SHORT_STEP)

TRACKING = 0.05
"""Limit of the tracking error [rad] of a stable loop: a tenth of the joints' motion."""

NAMED = ("unstable", "plant", "pd", " s: ")
"""Parts of the message: the failure, the slaves, the time."""


def gain_cases() -> Iterator[HardCase]:
    """One case: a PD controller whose gain is too high."""
    overshoot = DERIVATIVE * STEP / INERTIA
    hard = f"a velocity error is over-corrected {overshoot:.0f}-fold in every step of {1e3 * STEP:g} ms"
    yield HardCase("gain too high, coupled by Jacobi", hard, _unstable)


def controlled_robot(step: float) -> Scene:
    """Robot with motors and PD controller, side by side."""
    controller = {"kind": "pd", "proportional": PROPORTIONAL, "derivative": DERIVATIVE, "sample_time": step}
    return paper_robot().replace(
        {
            "cosimulation.drive": "torque",
            "cosimulation.algorithm": "jacobi",
            "cosimulation.step": step,
            "effects.motor_inertia": INERTIA,
            "effects.proximal_bending": 1,
            "effects.distal_axial": 1,
            "controller": [controller],
        }
    )


def _unstable() -> CaseReport:
    """The run reports an unstable coupling, and is stable with the shorter step that the message recommends."""
    run, cured = (
        PreparedScene(controlled_robot(step), fmu_path=fmu_of(controlled_robot(STEP))).run() for step in STABILITY_STEPS
    )
    unnamed = sum(part not in run.message for part in NAMED)
    # largest tracking error of the joints with the short step [rad]; NaN for a run that didn't reach its end
    tracking = float("nan")
    if cured.completed:
        names = ((f"joint{leg}.position", f"joint{leg}.reference.position") for leg in (1, 2))
        errors = (np.abs(cured.recording[a].values - cured.recording[b].values).max() for a, b in names)
        tracking = max(float(error) for error in errors)
    checks = (
        Criterion("outcomes other than an unstable coupling", float(run.outcome is not Outcome.COUPLING_UNSTABLE), 0.0),
        Criterion("slaves or time not named", float(unnamed), 0.0),
        not_finite(run.recording),
        Criterion(f"tracking error in steps of {1e3 * SHORT_STEP:g} ms", tracking, TRACKING, "rad"),
    )
    return CaseReport(run.message, checks)


FrictionModes = tuple[int, ...]

COULOMB, BREAKAWAY = 2.0, 3.0
"""Coulomb and breakaway torque of both motors [N.m]."""

INTERVAL, COUNT = 5e-3, 200
"""Communication step [s], over which torques are constant, and number of steps."""

SWING = np.array([[5.0, 4.0], [3.0, 4.5]])
"""Amplitudes [N.m] and frequencies [Hz] of the torques beyond those that hold the robot."""

INPUTS = ("joint1.torque", "joint2.torque", "force.x", "force.y")
OUTPUTS = ("joint1.position", "joint2.position", "joint1.velocity", "joint2.velocity")


def sticking_cases() -> Iterator[HardCase]:
    """One case: both motors under swinging torques."""
    hard = f"friction of up to {BREAKAWAY:g} N.m stops and releases them, between torques that jump every {1e3 * INTERVAL:g} ms"
    yield HardCase("motors that stick", hard, _sticking)


def sticking_robot() -> Scene:
    """Return a robot with rigid links and stiction in the motors, so that an hour of standstill shows friction alone."""
    friction = {"kind": "stiction", "viscous": 0.5, "coulomb": COULOMB, "breakaway": BREAKAWAY}
    return paper_robot().replace(
        {
            "cosimulation.drive": "torque",
            "effects.motor_inertia": 0.1,
            "effects.proximal_bending": 0,
            "effects.distal_axial": 0,
            "effects.joint_friction": friction,
        }
    )


class Reference:
    """The equations of motion of the robot with modes: -1 and 1 slip in that direction, 0 sticks."""

    def __init__(self, scene: Scene) -> None:
        self._model = build_model(scene)
        parameters = [variable.start or 0.0 for variable in self._model.parameters]
        self._derived = self._model.functions["derive"](parameters).full().ravel()
        self.start = self._model.functions["initial_coordinates"](parameters).full().ravel()

    def forces(self, x: RealArray, a: RealArray, u: RealArray, modes: FrictionModes) -> RealArray:
        """Residual (2,): the torques that the motion lacks [N m]."""
        d = self._derived.copy()
        for friction, mode in zip(self._model.frictions, modes, strict=True):
            d[friction.direction] = mode
        return np.asarray(self._model.functions["residual"](x[:2], x[2:], a, u, d).full()).ravel()

    def acceleration(self, x: RealArray, u: RealArray, modes: FrictionModes) -> RealArray:
        """Return the accelerations (2,) [rad/s2], zero for motors that stick."""
        mass = self._model.functions["mass_matrix"](x[:2], u, self._derived).full()
        free, a = np.flatnonzero(modes), np.zeros(2)
        a[free] = np.linalg.solve(mass[np.ix_(free, free)], -self.forces(x, a, u, modes)[free])
        return a

    def indicators(self, x: RealArray, u: RealArray, modes: FrictionModes) -> RealArray:
        """(2,) Margin of torque until a sticking motor breaks away [N m], or rate in the direction of slip [rad/s]."""
        margin = BREAKAWAY - np.abs(self.forces(x, self.acceleration(x, u, modes), u, modes))
        return np.where(modes, np.array(modes) * x[2:], margin)

    def modes(self, x: RealArray, u: RealArray, released: FrictionModes) -> FrictionModes:
        """The only modes, or those with the fewest slipping motors, that contradict neither torques nor accelerations."""
        # moving motors slip in their direction; those at rest may stick or slip
        rates = [int(r) for r in np.sign(x[2:])]
        choices = [(rates[i] or released[i],) if rates[i] or released[i] else (0, -1, 1) for i in range(2)]
        for modes in sorted(product(*choices), key=lambda each: sum(map(abs, each))):
            a, z = self.acceleration(x, u, modes), self.indicators(x, u, modes)
            if all(
                (z[i] >= 0.0) if not modes[i] else (rates[i] or released[i] or modes[i] * a[i] > 0.0) for i in range(2)
            ):
                return modes
        raise ArithmeticError(f"no modes are possible at {x.tolist()}")

    def over(self, x: RealArray, u: RealArray, span: float) -> tuple[RealArray, int]:
        """The state after ``span`` [s] with constant inputs, and the number of events."""
        # from event to event
        time, count, released = 0.0, 0, (0, 0)
        while True:
            modes = self.modes(x, u, released)
            time, x, happened = self._to_event(x, u, modes, time, span)
            if happened is None:
                return x, count
            count, released = count + 1, (0, 0)
            # a motor that stops sticks from now on, unless the next modes contradict that
            if modes[happened]:
                x[2 + happened] = 0.0
                continue
            # a motor that breaks away slips in the direction of its torque
            direction = -int(np.sign(self.forces(x, self.acceleration(x, u, modes), u, modes)[happened]))
            released = (direction, 0) if happened == 0 else (0, direction)

    def _to_event(
        self, x: RealArray, u: RealArray, modes: FrictionModes, begin: float, end: float
    ) -> tuple[float, RealArray, int | None]:
        """Time and state at the first event, with the motor that has it, or at the end."""

        def rates(_: float, x: RealArray) -> RealArray:
            return np.concatenate([x[2:], self.acceleration(x, u, modes)])

        def watch(motor: int) -> Any:
            def event(_: float, x: RealArray) -> float:
                return float(self.indicators(x, u, modes)[motor])

            event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
            return event

        events = [watch(motor) for motor in range(2)]
        # the earliest terminal event ends the mode
        solution: Any = solve_ivp(rates, (begin, end), x, "DOP853", events=events, rtol=1e-11, atol=1e-13)
        happened = next((i for i in range(2) if solution.t_events[i].size), None)
        return float(solution.t[-1]), solution.y[:, -1], happened


def _sticking() -> CaseReport:
    """Swinging torques against SciPy, an hour of standstill, and the torque that ends it."""
    scene = sticking_robot()
    # swinging torques, step by step
    reference = Reference(scene)
    x, events = np.concatenate([reference.start, [0.0, 0.0]]), 0
    expected: list[RealArray] = []
    holding = reference.forces(x, np.zeros(2), np.zeros(4), (0, 0))
    torques = holding + SWING[0] * np.sin(2 * np.pi * SWING[1] * INTERVAL * np.arange(COUNT)[:, None])
    for torque in torques:
        x, count = reference.over(x, np.concatenate([torque, [0.0, 0.0]]), INTERVAL)
        events, expected = events + count, [*expected, x]
    found, wanted = _stepped(scene, torques, INTERVAL), np.array(expected)

    # an hour a millionth below breakaway, a moment a millionth above
    load = np.array([BREAKAWAY, 0.0])
    still = _stepped(scene, np.tile(holding + (1.0 - 1e-6) * load, (3600, 1)), 1.0)
    freed = _stepped(scene, (holding + (1.0 + 1e-6) * load)[np.newaxis], 1e-2)
    checks = (
        Criterion("error (DOP853)", float(np.abs(found - wanted)[:, :2].max() / np.ptp(wanted[:, :2])), ALLOWED),
        Criterion("steps that stick in one of the two only", float(np.sum((found == 0.0) != (wanted == 0.0))), 0.0),
        Criterion("drift in an hour", float(np.abs(still[-1] - still[0]).max()), 0.0, "rad"),
        Criterion("motors not freed by a millionth more", float(not freed[0, 2] > 0.0), 0.0),
    )
    return CaseReport(f"they stopped and broke away {events} times in {COUNT * INTERVAL:g} s", checks)


def _stepped(scene: Scene, torques: RealArray, step: float) -> RealArray:
    """(N, 4) angles and rates of the FMU after each step with the torques (N, 2)."""
    # torques are constant over each step
    plant = FmuSlave(fmu_of(scene), "plant", {})
    names = [variable.name for variable in plant.variables]
    inputs, outputs = (np.array([names.index(name) for name in each], dtype=np.intp) for each in (INPUTS, OUTPUTS))
    found = np.empty((len(torques), len(OUTPUTS)))
    try:
        plant.initialize(0.0, len(torques) * step, TOLERANCE)
        for n, torque in enumerate(torques):
            plant.set(inputs, np.concatenate([torque, [0.0, 0.0]]))
            plant.step(n * step, step)
            plant.get(outputs, found[n])
    finally:
        plant.terminate()
    return found
