"""Small motions of the torque-driven plant about an equilibrium, as a state-space system for python-control.

The residual M a + b(y, v, u) = 0 is linearised with exact derivatives; the accelerations are eliminated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.model.contract import Linearisation, LinearPlant
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.plants import motion_driven_plant, torque_driven_plant
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import MAXIMUM_ITERATIONS, static_equilibrium
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    import control


SETTLED = 1e-12
"""Newton step relative to the elastic coordinates that ends the search for an equilibrium."""


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
    plant = _plant(scene).model
    names = [variable.name for variable in plant.outputs]
    for name in outputs or ():
        if name not in names:
            near = sorted(get_close_matches(name, names, cutoff=0.0), key=names.index)
            listed = f"{', '.join(near)} and {len(names) - len(near)} others"
            raise ValueError(f"the plant has no output `{name}`; its outputs: {listed}")
    linear = linear_plant(scene, position, names if outputs is None else outputs)
    return state_space(plant, linear)


def state_space(plant: SymbolicModel, linear: LinearPlant) -> control.StateSpace:
    """A linear plant for python-control; its states are the coordinates, their rates, and what is of first order.
    Without inputs it has one, ``none``, that moves nothing."""
    import control

    second = plant.degrees_of_freedom - plant.has_clock - plant.first_order
    names = [*plant.unknowns, *(name if k >= second else f"der({name})" for k, name in enumerate(plant.unknowns))]
    states = [names[k] for k in plant.states]
    # python-control has no systems without inputs
    inputs, b, d = linear.inputs or ("none",), linear.b, linear.d
    if not linear.inputs:
        b, d = np.zeros((len(states), 1)), np.zeros((len(linear.outputs), 1))
    labels = {
        key: [signal_label(name) for name in each]
        for key, each in (("states", states), ("inputs", inputs), ("outputs", linear.outputs))
    }
    return control.ss(linear.a, b, linear.c, d, name=signal_label(plant.name), **labels)


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
    point = operating_point(scene, position)
    still = np.zeros(len(point.coordinates))
    return _plant(scene).about((point.coordinates, still, still, point.inputs), outputs)


@one_blas_thread()
def varied_plant(scene: Scene, joints: RealArray, values: Mapping[str, float]) -> LinearPlant:
    """The plant of the scene's own drive about its equilibrium, with all outputs, for many values of its parameters.

    Equations are derived once for all of them. Inputs of a motion-driven plant are the joints' positions, velocities and accelerations.

    Args:
        scene: the scene.
        joints: motor angles (2,) [rad].
        values: name of a parameter → value, where it differs from the scene's.

    Raises:
        EquilibriumError: there is no equilibrium.
    """
    linear = _own_plant(scene).with_values(values)
    model, locked = linear.model, linear.model.locked
    y, still, inputs = (
        np.zeros(model.degrees_of_freedom),
        np.zeros(model.degrees_of_freedom),
        np.zeros(len(model.inputs)),
    )
    (y if locked else inputs)[:2] = joints

    def force() -> RealArray:
        return np.asarray(model.functions["residual"](y, still, still, inputs, linear.derived).full())[:, 0]

    for _ in range(MAXIMUM_ITERATIONS):
        stiffness = linear.residual(y, still, still, inputs, linear.derived)[0].full()[locked:, locked:]
        step = np.linalg.solve(stiffness, force()[locked:])
        y[locked:] -= step
        if np.linalg.norm(step) <= SETTLED * np.linalg.norm(y[locked:]):
            break
    else:
        angles = " and ".join(f"{each:.6g}" for each in joints)
        raise EquilibriumError(f"no static equilibrium was found at the motor angles {angles} rad")
    inputs[:locked] = force()[:locked]
    return linear.about((y, still, still, inputs), [each.name for each in model.outputs])


def plant_of(scene: Scene) -> SymbolicModel:
    """The plant of the scene's own drive, cached."""
    return _own_plant(scene).model


@lru_cache(maxsize=8)
def _own_plant(scene: Scene) -> Linearisation:
    """The plant of the scene's own drive with its Jacobians."""
    if scene.cosimulation.drive == "torque":
        return Linearisation.of(torque_driven_plant(scene), is_varied=True)
    return Linearisation.of(motion_driven_plant(scene), is_varied=True)


def signal_label(name: str) -> str:
    """A name that python-control accepts, with underscores for dots: ``joint1.torque`` → ``joint1_torque``."""
    return name.replace(".", "_")


@lru_cache(maxsize=8)
def _plant(scene: Scene) -> Linearisation:
    """The plant with its Jacobians."""
    return Linearisation.of(torque_driven_plant(scene))
