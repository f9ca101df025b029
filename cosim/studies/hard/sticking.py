"""Motors with stiction that stop and break away, against SciPy on the same equations with its own modes and events.

The reference is a hybrid system: each motor sticks or slips in one direction, `solve_ivp` locates the event that ends the mode, and
the next mode is the one with the fewest slipping motors that contradicts neither torques nor accelerations.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.studies.hard.case import ALLOWED, TOLERANCE, CaseReport, Criterion, HardCase, fmu_of, paper_robot
from flexfmu.model.plants import build_model
from flexfmu.model.scene.schema import Scene

FrictionModes = tuple[int, ...]

COULOMB, BREAKAWAY = 2.0, 3.0
"""Coulomb and breakaway torque of both motors [N.m]."""

INTERVAL, COUNT = 5e-3, 200
"""Communication step [s], over which torques are constant, and number of steps."""

SWING = np.array([[5.0, 4.0], [3.0, 4.5]])
"""Amplitudes [N.m] and frequencies [Hz] of the torques beyond those that hold the robot."""

INPUTS = ("joint1.torque", "joint2.torque", "force.x", "force.y")
OUTPUTS = ("joint1.position", "joint2.position", "joint1.velocity", "joint2.velocity")


def cases() -> Iterator[HardCase]:
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
