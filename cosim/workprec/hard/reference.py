"""What SciPy's solvers make of a robot's equations: the references that the suite's errors are counted from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.scene_parameters import parameters_for
from flexfmu.cosim.workprec.equations import BoundFunction
from flexfmu.cosim.workprec.hard.robot_equations import ALONG_POLYNOMIALS, HELD, RobotEquations, robot_equations
from flexfmu.cosim.workprec.motion_polynomials import pieces
from flexfmu.cosim.workprec.solver_trials import Method, ends
from flexfmu.cosim.workprec.subject import RunError
from flexfmu.model.scene import Scene
from flexfmu.model.statics import static_equilibrium

Array = NDArray[np.float64]

FREQUENCY = 1e3
"""Angular frequency [rad/s] by which absolute tolerances of rates exceed those of coordinates: about what these links swing at.
Without it, solvers would chase the rounding errors of accelerations where a heavy payload meets light links."""

POSITION = ("end_effector.position.x", "end_effector.position.y")


@dataclass(frozen=True)
class Solver:
    """Which of SciPy's methods, and how exact.

    Attributes:
        method: ``DOP853`` where nothing is stiff, else ``Radau``.
        tolerance: relative; the absolute one follows from it.
        compiled: whether the equations are compiled, which takes a second.
    """

    method: Method = "DOP853"
    tolerance: float = 1e-10
    compiled: bool = True


@dataclass(frozen=True)
class Phase:
    """A time in which the equations have no jump.

    Attributes:
        begin, end: [s].
        numbers: of the drive.
    """

    begin: float
    end: float
    numbers: Array


def positions_along(
    robot: Scene, scene: Scene, motion: MotionPlan, instants: Array, solver: Solver, size: float
) -> Array:
    """End-effector positions [m] of a planned motion, shape (N, 2).

    Args:
        robot: a scene of the same effects, whose equations are taken: scenes that differ in parameters share them.
        scene: whose parameters and start are taken.
        motion: joint motion.
        instants: (N,) ascending times [s] within the motion and its standstill.
        solver: which solver.
        size: about how far the links deflect [m]; absolute tolerances follow from it.

    Raises:
        RunError: the solver gives up.
    """
    equations = robot_equations(robot, ALONG_POLYNOMIALS, POSITION, solver.compiled)
    phases = [Phase(p.begin, p.end, p.numbers) for p in pieces(motion.joints, float(instants[-1]))]
    start = _start(scene, motion, equations.n)
    return _follow(equations, scene, phases, start, instants, solver, size)


def signals_of_held(
    robot: Scene,
    scene: Scene,
    phases: Sequence[Phase],
    signals: tuple[str, ...],
    instants: Array,
    solver: Solver,
    size: float,
) -> Array:
    """Outputs of a robot that starts undeformed and at rest, with references that stay over every phase, shape (N, signals).

    Args and errors: as for `positions_along`.
    """
    equations = robot_equations(robot, HELD, signals, solver.compiled)
    return _follow(equations, scene, phases, np.zeros(2 * equations.n), instants, solver, size)


def _start(scene: Scene, motion: MotionPlan, n: int) -> Array:
    """z at the start (2 n,)."""
    joints = motion.joints.evaluate(0.0, 0)[0, 0]
    is_static = scene.cosimulation.initial == "static"
    elastic = static_equilibrium(scene, joints).elastic if is_static else np.zeros(n)
    return np.concatenate([elastic, np.zeros(n)])


def _follow(
    equations: RobotEquations,
    scene: Scene,
    phases: Iterable[Phase],
    state: Array,
    instants: Array,
    solver: Solver,
    size: float,
) -> Array:
    """The signals at the instants, restarted in every phase; an instant between two phases belongs to the first."""
    values = parameters_for(scene, equations.parameters)
    derived = equations.derive([values[name] for name in equations.parameters]).full().ravel()
    absolute = solver.tolerance * size * np.repeat([1.0, FREQUENCY], equations.n)
    found = []
    for phase in phases:
        within = instants[(instants > phase.begin) & (instants <= phase.end)]
        numbers = np.concatenate([phase.numbers, derived])
        rate, signals = (BoundFunction(function, numbers) for function in (equations.rate, equations.signals))
        states = _solve(rate, phase, state, ends(within, phase.end), solver, absolute)
        found += [signals(t, z) for t, z in zip(within, states, strict=False)]
        state = states[-1]
    return np.array(found)


def _solve(rate: BoundFunction, phase: Phase, state: Array, wanted: Array, solver: Solver, absolute: Array) -> Array:
    """z at the wanted instants (N, 2 n)."""
    span = phase.begin, phase.end
    solution = solve_ivp(rate, span, state, solver.method, wanted, rtol=solver.tolerance, atol=absolute)
    if not solution.success:
        raise RunError(solution.message)
    return np.asarray(solution.y.T)
