"""Directional derivatives assembled to A, B, C, D against the model's own linearisation about an equilibrium."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.model.linear import linearize

TORQUE = {"cosimulation.drive": "torque"}


@pytest.mark.parametrize(
    "modes", [{}, {"effects.proximal_bending": 0, "effects.distal_axial": 0}], ids=["elastic", "rigid"]
)
@pytest.mark.parametrize("kind", ["exchange", "stepping"])
def test_agrees_with_the_models_own(instantiate: Any, make_scene: Any, modes: dict[str, object], kind: str) -> None:
    """At rest in the start pose the FMU is an equilibrium; there its derivatives are the state-space system."""
    plant, scene = instantiate(TORQUE | modes, kind), make_scene(TORQUE | modes)
    plant.initialize()
    plant.begin()
    derivatives = [unknown.variable.name for unknown in plant.description.derivatives]
    system = linearize(scene, scene.trajectory.start)
    scale = np.abs(system.A).max()
    pairs = [
        (plant.jacobian(derivatives, plant.states), system.A, scale),
        (plant.jacobian(derivatives, plant.inputs), system.B, np.abs(system.B).max()),
        (plant.jacobian(plant.outputs, plant.states), system.C, np.abs(system.C).max()),
        (plant.jacobian(plant.outputs, plant.inputs), system.D, np.abs(system.D).max()),
    ]
    for ours, theirs, size in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11 * size)
