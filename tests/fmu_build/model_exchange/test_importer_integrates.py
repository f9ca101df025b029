"""Model exchange: somebody else's integrator, on the plant's own equations, against the plant's own integrator."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

Array = NDArray[np.float64]

INTERVAL, COUNT = 5e-4, 30
TIME = np.arange(COUNT + 1) * INTERVAL
TORQUE = {"cosimulation.drive": "torque"}
FEW_MODES = {"effects.proximal_bending": 2, "effects.distal_axial": 1}
RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}


def jumps(names: list[str], start: Array) -> dict[str, Array]:
    """Values of each input from each sample on: forces and accelerations that jump every ten samples, start values else."""
    size = {"force": 40.0, "torque": 5.0, "position": 0.0, "velocity": 0.0, "acceleration": 40.0}
    return {
        name: start[k]
        + next(s for word, s in size.items() if word in name) * np.sin(k + 1.0 + np.arange(COUNT + 1) // 10)
        for k, name in enumerate(names)
    }


def step_through(plant: Any, signals: Mapping[str, Array], outputs: list[str]) -> Array:
    """Outputs of a co-simulation, (outputs, times)."""
    names, values = list(signals), np.array(list(signals.values()))
    plant.initialize(tolerance=1e-11)
    plant.set(names, values[:, 0])
    plant.begin()
    rows = [plant.get(outputs)]
    for k in range(COUNT):
        plant.fmu.doStep(k * INTERVAL, INTERVAL)
        plant.set(names, values[:, k + 1])
        rows.append(plant.get(outputs))
    return np.array(rows).T


def table(signals: Mapping[str, Array]) -> list[tuple[float, ...]]:
    """The same inputs, held between samples: each sample has the value before and after it."""
    after = np.array(list(signals.values()))
    before = np.roll(after, 1, axis=1)
    pairs = [(TIME[k], *values[:, k]) for k in range(1, COUNT + 1) for values in (before, after)]
    return [(TIME[0], *after[:, 0]), *pairs]


def errors(result: Array, reference: Array) -> Array:
    """Largest deviation of each output, relative to how far it moves."""
    return np.asarray(np.abs(result - reference).max(axis=1) / np.ptp(reference, axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("changes", [FEW_MODES, FEW_MODES | TORQUE], ids=["motion", "torque"])
def test_cvode_converges_to_the_co_simulation(
    instantiate: Any, plant_path: Any, integrate: Any, changes: dict[str, object]
) -> None:
    """Two integrators that share nothing but the equations agree the better the smaller the tolerance is."""
    plant = instantiate(changes, "stepping")
    plant.initialize()
    signals = jumps(plant.inputs, plant.get(plant.inputs))
    plant.fmu.reset()
    reference = step_through(plant, signals, plant.outputs)
    path = plant_path(changes)[0]
    loose, usual, tight = (
        errors(integrate(path, [*signals], table(signals), plant.outputs, INTERVAL, tolerance).T, reference)
        for tolerance in (1e-6, 1e-8, 1e-10)
    )
    assert usual.max() < 0.3 * loose.max()
    assert tight.max() < 0.05 * usual.max()
    assert (
        tight[[plant.outputs.index(name) for name in ("end_effector.position.x", "link11.tip_deflection")]].max() < 5e-6
    )


def test_rigid_plant_has_no_states(instantiate: Any) -> None:
    """Nothing to integrate: outputs follow the inputs at once, with events and steps like everybody's."""
    plant, other = instantiate(RIGID), instantiate(RIGID, "stepping")
    for each in (plant, other):
        each.initialize()
        each.begin()
    assert plant.states == []
    assert plant.x.size == plant.rates.size == 0
    for k in range(3):
        u = plant.get(plant.inputs) + 0.01
        plant.fmu.setTime(0.1 * (k + 1))
        other.fmu.doStep(0.1 * k, 0.1)
        for each in (plant, other):
            each.set(each.inputs, u)
        plant.fmu.completedIntegratorStep()
        assert np.array_equal(plant.get(plant.outputs), other.get(other.outputs))


@pytest.mark.parametrize("changes", [{}, TORQUE], ids=["motion", "torque"])
def test_states_are_the_outputs_that_show_them(instantiate: Any, changes: dict[str, object]) -> None:
    """States, derivatives and nominals come in the order in which the model structure names them."""
    plant, random = instantiate(changes), np.random.default_rng(3)
    plant.initialize()
    assert np.array_equal(plant.x, plant.get(plant.states))
    plant.begin()
    plant.x = plant.x + 0.01 * plant.nominals * random.normal(size=len(plant.states))
    derivatives = [unknown.variable.name for unknown in plant.description.derivatives]
    assert np.array_equal(plant.x, plant.get(plant.states))
    assert np.array_equal(plant.rates, plant.get(derivatives))
    nominal = {variable.name: variable.nominal for variable in plant.description.modelVariables}
    assert [float(nominal[name]) for name in plant.states] == list(plant.nominals)


def test_derivatives_forget_where_the_integrator_was(instantiate: Any) -> None:
    """The right-hand side is a function: trial points far away, even impossible ones, leave no trace in a single bit."""
    plant = instantiate(TORQUE)
    plant.initialize()
    plant.begin()
    plant.x = here = plant.x
    rates = plant.rates
    for size in (1.0, 1e3):
        plant.x = here + size * plant.nominals
        with suppress(FMICallException):
            _ = plant.rates
        plant.x = here
        assert np.array_equal(plant.rates, rates)
