"""Reference solutions of the suite: the equations that an FMU is built from, solved by SciPy, without our integrator and our master."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.code import compile_function
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.parameters import parameters_for
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.studies.workprec.solver_trials import (
    NUMBERS,
    BoundFunction,
    ScipyMethod,
    Symbol,
    joint_motion,
    motion_polynomials,
    solve_piece,
    start_state,
)
from flexfmu.model.plants import build_model
from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class JointReferences:
    """How the six references u = [q_a, v_a, a_a] of the joints are calculated.

    Attributes:
        count: how many numbers they depend on.
        references: (t, numbers) → u (6, 1).
    """

    count: int
    references: Callable[[Symbol, Symbol], Symbol]


ALONG_POLYNOMIALS = JointReferences(NUMBERS, joint_motion)
"""The numbers of a `flexfmu.cosim.studies.workprec.solver_trials.MotionPolynomial`."""

CONSTANT_REFERENCES = JointReferences(6, lambda t, numbers: numbers)
"""u itself, constant."""


@dataclass(frozen=True)
class RobotEquations:
    """dz/dt and what is compared as functions of (t, z, [numbers of the drive, d]), with z = [q_e, dq_e/dt].

    Attributes:
        n: number of elastic coordinates.
        parameters: names of the parameters p, in the order that `derive` takes them.
        derive: p → derived parameters d.
        rate: → dz/dt (2 n,).
        signals: → the outputs that were asked for.
    """

    n: int
    parameters: tuple[str, ...]
    derive: casadi.Function
    rate: casadi.Function
    signals: casadi.Function


@lru_cache(maxsize=8)
def robot_equations(robot: Scene, drive: JointReferences, signals: tuple[str, ...], compiled: bool) -> RobotEquations:
    """The equations of a motion-driven robot, with free parameters.

    Args:
        robot: the scene; its parameters don't matter.
        drive: what moves the joints.
        signals: outputs that are to be compared.
        compiled: whether to compile them, which takes a second.
    """
    model = build_model(robot)
    n, functions = model.degrees_of_freedom, model.functions
    # rate of the elastic coordinates from M a + b = 0
    t, z = casadi.SX.sym("t"), casadi.SX.sym("z", 2 * n)
    numbers = casadi.SX.sym("numbers", drive.count + functions["derive"].numel_out(0))
    u, d, q, v = drive.references(t, numbers[: drive.count]), numbers[drive.count :], z[:n], z[n:]
    bias = functions["residual"](q, v, casadi.SX.zeros(n), u, d)
    rate = casadi.vertcat(v, casadi.solve(functions["mass_matrix"](q, u, d), -bias))
    # the outputs that are compared, at zero acceleration of the elastic coordinates
    outputs = functions["outputs"](q, v, casadi.SX.zeros(n), u, d)
    names = [output.name for output in model.outputs]
    chosen = casadi.vertcat(*(outputs[names.index(name)] for name in signals))
    # compiled only where that pays
    made = [
        casadi.Function(name, [t, z, numbers], [casadi.densify(casadi.cse(expression))])
        for name, expression in (("rate", rate), ("signals", chosen))
    ]
    ready = [compile_function(each) if compiled else each for each in made]
    return RobotEquations(n, tuple(p.name for p in model.parameters), functions["derive"], *ready)


FREQUENCY = 1e3
"""Angular frequency [rad/s] by which absolute tolerances of rates exceed those of coordinates: about what these links swing at.
Without it, solvers would chase the rounding errors of accelerations where a heavy payload meets light links."""

POSITION = ("end_effector.position.x", "end_effector.position.y")


@dataclass(frozen=True)
class Solver:
    """A method of SciPy with its tolerance.

    Attributes:
        method: ``DOP853`` where nothing is stiff, else ``Radau``.
        tolerance: relative; the absolute one follows from it.
        compiled: whether the equations are compiled, which takes a second.
    """

    method: ScipyMethod = "DOP853"
    tolerance: float = 1e-10
    compiled: bool = True


@dataclass(frozen=True)
class Phase:
    """A time interval in which the equations have no jump.

    Attributes:
        begin, end: [s].
        numbers: of the drive.
    """

    begin: float
    end: float
    numbers: RealArray


def positions_along(
    robot: Scene, scene: Scene, motion: MotionPlan, instants: RealArray, solver: Solver, size: float
) -> RealArray:
    """End-effector positions [m] of a planned motion, shape (N, 2).

    Args:
        robot: a scene of the same effects, whose equations are taken: scenes that differ in parameters share them.
        scene: whose parameters and start are taken.
        motion: joint motion.
        instants: (N,) ascending times [s] within the motion and its standstill.
        solver: which solver.
        size: approximate deflection of the links [m], which scales the absolute tolerances.

    Raises:
        RunError: the solver fails.
    """
    equations = robot_equations(robot, ALONG_POLYNOMIALS, POSITION, solver.compiled)
    phases = [Phase(p.begin, p.end, p.numbers) for p in motion_polynomials(motion.joints, float(instants[-1]))]
    start = start_state(scene, motion.joints.evaluate(0.0, 0)[0, 0], equations.n)
    return _follow(equations, scene, phases, start, instants, solver, size)


def signals_of_constant_references(
    robot: Scene,
    scene: Scene,
    phases: Sequence[Phase],
    signals: tuple[str, ...],
    instants: RealArray,
    solver: Solver,
    size: float,
) -> RealArray:
    """Outputs of a robot that starts undeformed and at rest, with references that stay over every phase, shape (N, signals).

    Args and errors: as for `positions_along`.
    """
    equations = robot_equations(robot, CONSTANT_REFERENCES, signals, solver.compiled)
    return _follow(equations, scene, phases, np.zeros(2 * equations.n), instants, solver, size)


def _follow(
    equations: RobotEquations,
    scene: Scene,
    phases: Iterable[Phase],
    state: RealArray,
    instants: RealArray,
    solver: Solver,
    size: float,
) -> RealArray:
    """The signals at the instants, restarted in every phase; an instant between two phases belongs to the first."""
    # parameters of the scene, and the absolute tolerance of coordinates and rates
    values = parameters_for(scene, equations.parameters)
    derived = equations.derive([values[name] for name in equations.parameters]).full().ravel()
    absolute = solver.tolerance * size * np.repeat([1.0, FREQUENCY], equations.n)
    found = []
    for phase in phases:
        within = instants[(instants > phase.begin) & (instants <= phase.end)]
        numbers = np.concatenate([phase.numbers, derived])
        rate, signals = (BoundFunction(function, numbers) for function in (equations.rate, equations.signals))
        span = phase.begin, phase.end
        states, state = solve_piece(rate, span, state, within, solver.method, solver.tolerance, absolute)
        found += [signals(t, z) for t, z in zip(within, states, strict=True)]
    return np.array(found)
