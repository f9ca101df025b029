"""fmi2GetDirectionalDerivative: against central differences, for every pair that the model structure names and all others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from flexfmu.model.linear import linearize
from flexfmu.model.scene.file import load_scene

Array = NDArray[np.float64]

MOTION: dict[str, object] = {}
TORQUE: dict[str, object] = {"cosimulation.drive": "torque"}
RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}
SIXTH_ORDER = dict(zip((-3, -2, -1, 1, 2, 3), (-1 / 60, 3 / 20, -3 / 4, 3 / 4, -3 / 20, 1 / 60), strict=True))
SCENES = {
    "motion": MOTION,
    "torque": TORQUE,
    "undeformed": TORQUE | {"cosimulation.initial": "undeformed"},
    "rigid motion": MOTION | RIGID,
    "rigid torque": TORQUE | RIGID,
}


def differences(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
    """Central differences of sixth order, times the steps: changes of the results along each coordinate."""
    columns = []
    for k, step in enumerate(steps):
        unit = np.eye(len(at))[k] * step
        columns.append(sum(weight * function(at + i * unit) for i, weight in SIXTH_ORDER.items()))
    return np.array(columns).reshape(len(at), -1).T


def agree(plant: Any, exact: Array, approximate: Array, tolerance: float = 1e-6) -> None:
    """Changes of each output agree relative to the largest of them; what is smaller than the output's digits is nothing."""
    moves = np.array([any(word in name for word in ("velocity", "acceleration", "der(")) for name in plant.outputs])
    noise = np.maximum(1e-3 * np.abs(plant.get(plant.outputs)), np.where(moves, 1e-3, 0.0))
    size = np.maximum(np.abs(approximate).max(axis=1, initial=0.0), noise)[:, None] + 1e-300
    np.testing.assert_allclose(exact / size, approximate / size, rtol=0.0, atol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_differences_in_motion(instantiate: Any, name: str) -> None:
    """States and inputs of a drawn motion: exact derivatives, and none where the model structure names no dependency."""
    plant, random = instantiate(SCENES[name]), np.random.default_rng(len(name))
    plant.initialize()
    plant.begin()
    n, nominals = len(plant.states), plant.nominals
    usual = np.where(nominals == 1.0, 0.02, 3.0 * nominals)
    for _ in range(2):
        u = plant.get(plant.inputs) + random.normal(size=len(plant.inputs)) * 0.05
        at = np.concatenate([plant.x + usual * random.normal(size=n), u])

        def outputs(z: Array) -> Array:
            plant.x = z[:n]
            plant.set(plant.inputs, z[n:])
            return plant.get(plant.outputs)

        steps = np.concatenate([np.where(nominals == 1.0, 1e-3, 0.1 * nominals), np.full(len(plant.inputs), 1e-3)])
        outputs(at)
        knowns = [*plant.states, *plant.inputs]
        exact = plant.jacobian(plant.outputs, knowns) * steps
        agree(plant, exact, differences(outputs, at, steps))
        for unknown, row in zip(plant.description.outputs, exact, strict=True):
            named = {variable.name for variable in unknown.dependencies}
            assert all(value == 0.0 for known, value in zip(knowns, row, strict=True) if known not in named)
        outputs(at)


@pytest.mark.parametrize(
    "name",
    [pytest.param(each, marks=[] if each in ("torque", "rigid motion") else pytest.mark.slow) for each in SCENES],
)
def test_agrees_with_differences_at_the_start(instantiate: Any, name: str) -> None:
    """Before the motion states follow from inputs, which deflect the static start, and from parameters, while the inputs are held;
    rates among the inputs don't deflect, but move the accelerations."""
    plant = instantiate(SCENES[name])
    plant.initialize()
    plant.set(plant.inputs, plant.get(plant.inputs))
    parameters = [name for name in plant.parameters if name != "integrator.step"]
    for knowns in (plant.inputs, parameters):
        start = plant.get(knowns)
        steps = np.full(len(start), 1e-3) if knowns is plant.inputs else 1e-3 * np.maximum(np.abs(start), 1e-2)
        at = start if knowns is plant.inputs else np.where(start < 0.0, start, np.maximum(start, 4.0 * steps))

        def outputs(values: Array, knowns: list[str] = knowns) -> Array:
            plant.set(knowns, values)
            return plant.get(plant.outputs)

        outputs(at)
        agree(plant, plant.jacobian(plant.outputs, knowns) * steps, differences(outputs, at, steps))
        outputs(start)


@pytest.mark.parametrize("modes", [{}, RIGID], ids=["elastic", "rigid"])
@pytest.mark.parametrize("kind", ["exchange", "stepping"])
def test_agrees_with_the_models_own_linearisation(instantiate: Any, modes: dict[str, object], kind: str) -> None:
    """At rest in the start pose the FMU is an equilibrium; there its derivatives are the state-space system."""
    plant, scene = instantiate(TORQUE | modes, kind), load_scene("barnard2012-6kg").replace(TORQUE | modes)
    plant.initialize()
    plant.begin()
    derivatives = [unknown.variable.name for unknown in plant.description.derivatives]
    system = linearize(scene, scene.trajectory.start)
    for unknowns, pair in ((derivatives, (system.A, system.B)), (plant.outputs, (system.C, system.D))):
        for knowns, expected in zip((plant.states, plant.inputs), pair, strict=True):
            tolerance = 1e-11 * np.abs(expected).max(initial=0.0)
            np.testing.assert_allclose(plant.jacobian(unknowns, knowns), expected, rtol=1e-9, atol=tolerance)
