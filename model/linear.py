"""Small motions of the torque-driven plant about an equilibrium, as a state-space system for python-control.

The residual M a + b(y, v, u) = 0 is linearised with exact derivatives; the accelerations are eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from typing import TYPE_CHECKING

import casadi
import numpy as np

from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.plants import torque_driven_plant
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class OperatingPoint:
    """An equilibrium of the torque-driven plant.

    Attributes:
        coordinates: y = [q_a, q_e] (2 + n,).
        inputs: u = [torques, forces] (4,), with no force at the end effector.
    """

    coordinates: RealArray
    inputs: RealArray


def operating_point(scene: Scene, position: tuple[float, float]) -> OperatingPoint:
    """The equilibrium with the motor angles of the rigid robot for `position` [m].

    Raises:
        ValueError: the position is out of reach.
        EquilibriumError: there is no equilibrium.
    """
    joints = motor_angles(scene.mechanism, position)
    state = static_equilibrium(scene, joints)
    return OperatingPoint(np.concatenate([joints, state.elastic]), np.concatenate([state.torque, np.zeros(2)]))


def linearize(scene: Scene, position: tuple[float, float], outputs: Sequence[str] | None = None) -> control.StateSpace:
    """The torque-driven plant about its equilibrium at `position` [m], in deviations from it.

    States are the coordinates and their rates; inputs are `joint1_torque`, `joint2_torque`, `force_x` and `force_y`.
    Labels and units are those of the FMU's variables, with underscores for dots.

    Args:
        scene: the scene; `cosimulation.drive` has no influence.
        position: end effector of the rigid robot [m].
        outputs: names of the outputs; all outputs of the FMU by default.

    Raises:
        ValueError: an output is unknown, or the position is out of reach.
        EquilibriumError: there is no equilibrium.
    """
    import control

    plant = _plant(scene)[0]
    names = [variable.name for variable in plant.outputs]
    for name in outputs or ():
        if name not in names:
            near = sorted(get_close_matches(name, names, cutoff=0.0), key=names.index)
            listed = f"{', '.join(near)} and {len(names) - len(near)} others"
            raise ValueError(f"the plant has no output `{name}`; its outputs: {listed}")
    linear = linear_plant(scene, position, names if outputs is None else outputs)
    # states are the unknowns and their rates
    states = [*plant.unknowns, *(f"der({name})" for name in plant.unknowns)]
    labels = {
        key: [signal_label(name) for name in each]
        for key, each in (("states", states), ("inputs", linear.inputs), ("outputs", linear.outputs))
    }
    return control.ss(linear.a, linear.b, linear.c, linear.d, name=signal_label(plant.name), **labels)


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """dx/dt = A x + B u, y = C x + D u: the torque-driven plant about an equilibrium.

    Attributes:
        a, b, c, d: the matrices.
        inputs, outputs: names of the FMU's variables, in the order of u and y.
        rest: values of the inputs and of the outputs at the equilibrium.
    """

    a: RealArray
    b: RealArray
    c: RealArray
    d: RealArray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rest: tuple[RealArray, RealArray]


def without_coulomb_friction(scene: Scene) -> Scene:
    """Return the scene without Coulomb friction, for designs about standstill: there its smoothed form is a strong damper, which the
    moving robot doesn't have."""
    return scene.replace({"effects.joint_friction.coulomb": 0.0}) if scene.effects.joint_friction.coulomb else scene


@one_blas_thread()
def linear_plant(scene: Scene, position: tuple[float, float], outputs: Sequence[str]) -> LinearPlant:
    """The torque-driven plant about its equilibrium at `position` [m], with some of its outputs.

    Raises:
        ValueError: the position is out of reach.
        EquilibriumError: there is no equilibrium.
    """
    (plant, derived, residual, output_jacobians), point = _plant(scene), operating_point(scene, position)
    names = [variable.name for variable in plant.outputs]
    rows = [names.index(name) for name in outputs]
    n, m = len(plant.unknowns), len(plant.inputs)
    rest = (point.coordinates, np.zeros(n), np.zeros(n), point.inputs)
    # accelerations as functions of states and inputs: M a + C v + K y + B u = 0
    stiffness, damping, mass, load = (np.asarray(each.full()) for each in residual(*rest))
    response = -np.linalg.solve(mass, np.hstack([stiffness, damping, load]))
    by_state, by_input = response[:, : 2 * n], response[:, 2 * n :]
    # outputs, which depend on the accelerations too
    c_y, c_v, c_a, c_u = (np.asarray(each.full()) for each in output_jacobians(*rest))
    return LinearPlant(
        a=np.vstack([np.hstack([np.zeros((n, n)), np.eye(n)]), by_state]),
        b=np.vstack([np.zeros((n, m)), by_input]),
        c=(np.hstack([c_y, c_v]) + c_a @ by_state)[rows],
        d=(c_u + c_a @ by_input)[rows],
        inputs=tuple(variable.name for variable in plant.inputs),
        outputs=tuple(outputs),
        rest=(point.inputs, np.asarray(plant.functions["outputs"](*rest, derived).full())[rows, 0]),
    )


def signal_label(name: str) -> str:
    """A name that python-control accepts, with underscores for dots: ``joint1.torque`` → ``joint1_torque``."""
    return name.replace(".", "_")


@lru_cache(maxsize=8)
def _plant(scene: Scene) -> tuple[SymbolicModel, casadi.DM, casadi.Function, casadi.Function]:
    """The plant, its derived values, and the Jacobians of residual and outputs by coordinates, rates, accelerations and inputs."""
    plant = torque_driven_plant(scene)
    n, m = len(plant.unknowns), len(plant.inputs)
    arguments = [casadi.SX.sym(name, size) for name, size in (("y", n), ("v", n), ("a", n), ("u", m))]
    derived = plant.functions["derive"]([variable.start or 0.0 for variable in plant.parameters])

    def jacobians(name: str) -> casadi.Function:
        expression = plant.functions[name](*arguments, derived)
        return casadi.Function(name, arguments, [casadi.jacobian(expression, x) for x in arguments])

    return plant, derived, jacobians("residual"), jacobians("outputs")
