"""Friction that sticks: a state that the FMU's own events and those of an importer's integrator begin and end alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.fmu_build.validation.validate import validate_fmu

TORQUES = ["joint1.torque", "joint2.torque"]
POSITIONS = ["joint1.position", "joint2.position"]
RATES = ["joint1.velocity", "joint2.velocity"]
FRICTION = ["joint1.friction", "joint2.friction"]

INTERVAL, COUNT = 5e-3, 200
COULOMB, BREAKAWAY = 2.0, 3.0
STIFF = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "effects.motor_inertia": 0.1}
DRIVEN = {"cosimulation.drive": "torque"}
STICKING = {"kind": "stiction", "viscous": 0.5, "coulomb": COULOMB, "breakaway": BREAKAWAY}
RIGID = DRIVEN | STIFF | {"effects.joint_friction": STICKING}
ELASTIC = DRIVEN | {"effects.joint_friction": STICKING | {"stribeck_velocity": 0.05}}


@pytest.mark.slow
def test_importers_find_the_same_events(instantiate: Any, plant_path: Any, integrate: Any) -> None:
    """CVODE, which looks for roots of the event indicators, converges to the co-simulation and sticks when it does."""
    # torques stop and turn both motors again and again
    plant, time = instantiate(RIGID, "stepping"), np.arange(COUNT) * INTERVAL
    plant.initialize(1e-10)
    turns = np.sin(2 * np.pi * time[:, None] * np.array([2.0, 3.0]))
    torques = plant.get(TORQUES) + np.array([5.0, 4.0]) * turns
    plant.begin()
    rows = []
    for k in range(COUNT):
        plant.set(TORQUES, torques[k])
        plant.fmu.doStep(k * INTERVAL, INTERVAL)
        rows.append(plant.get(POSITIONS + RATES))
    reference = np.array(rows)
    stuck = reference[:, 2:] == 0.0
    assert 10 < stuck.sum() < stuck.size / 2
    # inputs jump at each sample
    held = [(k * INTERVAL, *torques[k - shift]) for k in range(COUNT + 1) for shift in (1, 0) if 0 <= k - shift < COUNT]
    loose, tight = (
        integrate(plant_path(RIGID)[0], TORQUES, held, POSITIONS + RATES, INTERVAL, tolerance)[1:]
        for tolerance in (1e-6, 1e-9)
    )
    assert np.abs(tight - reference).max() < 2e-6
    assert np.abs(tight - reference).max() < 0.1 * np.abs(loose - reference).max()
    assert np.array_equal(tight[:, 2:] == 0.0, stuck)


@pytest.mark.slow
@pytest.mark.parametrize("rates", [(0.0, 0.0), (0.3, 0.0), (0.3, -0.2)], ids=["both stick", "one slips", "both slip"])
def test_derivatives_belong_to_the_mode(instantiate: Any, rates: tuple[float, float]) -> None:
    """Directional derivatives are the slopes of accelerations and friction within a mode."""
    plant = instantiate(ELASTIC)
    plant.initialize()
    plant.begin()
    x = plant.x
    n = x.size // 2
    x[n : n + 2] = rates
    plant.x = x
    plant.fmu.enterEventMode()
    plant.fmu.newDiscreteStates()
    plant.fmu.enterContinuousTimeMode()
    unknowns = [*POSITIONS, "joint1.acceleration", "joint2.acceleration", *FRICTION]
    knowns = [*TORQUES, "force.x"]
    assert np.array_equal(np.sign(plant.get(FRICTION))[np.array(rates) != 0.0], [-np.sign(r) for r in rates if r])
    exact, u = plant.jacobian(unknowns, knowns), plant.get(knowns)
    for k, name in enumerate(knowns):
        plant.set([name], [u[k] + 50.0])
        above = plant.get(unknowns)
        plant.set([name], [u[k] - 50.0])
        below = plant.get(unknowns)
        plant.set([name], [u[k]])
        assert (above - below) / 100.0 == pytest.approx(exact[:, k], rel=1e-6, abs=1e-6)
    stuck = np.array(rates) == 0.0
    assert not exact[2:4][stuck].any()
    assert exact[4:6, :2][stuck][:, stuck] == pytest.approx(-np.eye(stuck.sum()), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("effects", [RIGID, ELASTIC], ids=["rigid", "elastic"])
def test_any_importer_gets_along_with_it(plant_path: Any, effects: dict[str, Any]) -> None:
    """Event indicators, event mode and changed states stand every check of claimed capabilities; where motors stick, forces balance
    and derivatives are rounding errors about zero."""
    assert validate_fmu(plant_path(effects)[0]) == []
