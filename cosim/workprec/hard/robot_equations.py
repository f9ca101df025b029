"""The equations that an FMU is made from, for other people's solvers: neither our integrator nor our master."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi

from flexfmu.cosim.blocks.code import compile_function
from flexfmu.cosim.workprec.equations import NUMBERS, Symbol, joint_motion
from flexfmu.model.plants import build_model
from flexfmu.model.scene import Scene


@dataclass(frozen=True)
class Drive:
    """How the six references u = [q_a, v_a, a_a] of the joints come about.

    Attributes:
        count: how many numbers say it.
        references: (t, numbers) → u (6, 1).
    """

    count: int
    references: Callable[[Symbol, Symbol], Symbol]


def _held(t: Symbol, numbers: Symbol) -> Symbol:
    return numbers


ALONG_POLYNOMIALS = Drive(NUMBERS, joint_motion)
"""The numbers of a `flexfmu.cosim.workprec.motion_polynomials.Piece`."""

HELD = Drive(6, _held)
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
def robot_equations(robot: Scene, drive: Drive, signals: tuple[str, ...], compiled: bool) -> RobotEquations:
    """The equations of a motion-driven robot, with free parameters.

    Args:
        robot: the scene; its parameters don't matter.
        drive: what moves the joints.
        signals: outputs that are to be compared.
        compiled: whether to compile them, which takes a second.
    """
    model = build_model(robot)
    n, given = model.degrees_of_freedom, model.functions
    t, z = casadi.SX.sym("t"), casadi.SX.sym("z", 2 * n)
    numbers = casadi.SX.sym("numbers", drive.count + given["derive"].numel_out(0))
    u, d, q, v = drive.references(t, numbers[: drive.count]), numbers[drive.count :], z[:n], z[n:]
    bias = given["residual"](q, v, casadi.SX.zeros(n), u, d)
    rate = casadi.vertcat(v, casadi.solve(given["mass_matrix"](q, u, d), -bias))
    outputs = given["outputs"](q, v, casadi.SX.zeros(n), u, d)
    names = [output.name for output in model.outputs]
    chosen = casadi.vertcat(*(outputs[names.index(name)] for name in signals))
    made = [
        casadi.Function(name, [t, z, numbers], [casadi.densify(casadi.cse(expression))])
        for name, expression in (("rate", rate), ("signals", chosen))
    ]
    ready = [compile_function(each) if compiled else each for each in made]
    return RobotEquations(n, tuple(p.name for p in model.parameters), given["derive"], *ready)
