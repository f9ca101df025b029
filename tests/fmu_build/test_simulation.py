"""Built FMUs under fmpy, against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from numpy.typing import NDArray

from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.symbolic import SymbolicModel

MakeModel = Callable[..., SymbolicModel]

MASS, STIFFNESS, COUPLING, FORCE = 2.0, 800.0, 150.0, 3.0
STATES = ("first.position", "second.position", "der(first.position)", "der(second.position)")


def _matrices(mass: float = MASS) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """M, K and B of the two oscillators."""
    total = STIFFNESS + COUPLING
    return mass * np.eye(2), np.array([[total, -COUPLING], [-COUPLING, total]]), np.array([1.0, 0.0])


def _released(time: NDArray[np.float64], mass: float = MASS) -> NDArray[np.float64]:
    """Positions and velocities after a constant force acts from rest: y = (I - V cos(w t) V') y_static, shape (N, 4)."""
    M, K, B = _matrices(mass)
    rest = np.linalg.solve(K, B * FORCE)
    squares, V = np.linalg.eigh(np.linalg.solve(M, K))
    w = np.sqrt(squares)
    amplitudes = V.T @ rest
    angle = np.outer(time, w)
    return np.hstack([rest - (np.cos(angle) * amplitudes) @ V.T, (np.sin(angle) * w * amplitudes) @ V.T])


def _simulate(path: Path, **settings: Any) -> Any:
    return fmpy.simulate_fmu(str(path), output=[*STATES, "first.spring_force"], **settings)


def test_free_oscillation_agrees_with_its_closed_form(make_oscillators: MakeModel) -> None:
    """The whole way from symbols to a running binary gives the right motion, to the tolerance of the build or of the importer."""
    path = build_fmu(make_oscillators(static_start=False), tolerance=1e-10).path
    errors = []
    for tolerance in (1e-4, 1e-6, 1e-8, None):
        result = _simulate(path, stop_time=10.0, output_interval=1.0, relative_tolerance=tolerance)
        computed, expected = np.column_stack([result[name] for name in STATES]), _released(result["time"])
        errors.append((np.abs(computed - expected) / np.abs(expected).max(axis=0)).max())
        assert errors[-1] < 10.0 * (tolerance or 1e-9)
    assert errors == sorted(errors, reverse=True)
    np.testing.assert_allclose(result["first.spring_force"], -STIFFNESS * result["first.position"], rtol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize(("static", "enumerations"), [(False, False), (True, True)])
def test_variants_side_by_side_start_as_their_fmu_does(
    make_oscillators: MakeModel, static: bool, enumerations: bool
) -> None:
    """Without settings, the start value of `initial` is that of the FMU: undeformed masses swing, those at rest stay there."""
    path = build_fmu(make_oscillators(static_start=static), enumerations=enumerations).path
    time = np.linspace(0.0, 0.5, 51)
    force = np.full((time.size - 1, 1, 1), FORCE)
    course = SampledInputs(
        time, np.zeros(time.size, dtype=bool), ["force"], np.array([FORCE]), force, [0], time.size - 1
    )
    solver = Lockstep(path, {}, course, ["mass"], STATES[:2], order=0, tolerance=1e-9)
    masses = np.array([1.0, 2.0, 5.0])
    found, failed = solver.record(masses[:, None])
    assert not failed.any()
    _, K, B = _matrices()
    for mass, (first, second) in zip(masses, found[:, :, 0], strict=True):
        rest = np.tile(np.linalg.solve(K, B * FORCE), (time.size, 1))
        expected = rest if static else _released(time, mass)[:, :2]
        np.testing.assert_allclose(np.column_stack([first, second]), expected, atol=1e-6 * abs(rest).max())


def test_static_start_stays_where_it_is(make_oscillators: MakeModel) -> None:
    """The FMU finds the equilibrium under its start inputs, and equilibrium is no motion; without arguments an importer runs the
    experiment that the build was given. One binary serves every mass, and the choice of the start is a parameter too."""
    _, K, B = _matrices()
    path = build_fmu(make_oscillators(), stop_time=0.5, step=0.05).path
    result, rest = _simulate(path), np.linalg.solve(K, B * FORCE)
    assert result["time"][-1] == pytest.approx(0.5)
    np.testing.assert_allclose(np.column_stack([result[name] for name in STATES[:2]]), [rest] * len(result), rtol=1e-9)
    np.testing.assert_allclose(result["der(first.position)"], 0.0, atol=1e-9 * rest[0])

    result = _simulate(path, start_values={"mass": 5.0, "initial": 2}, relative_tolerance=1e-9)
    expected = _released(result["time"], mass=5.0)[:, 0]
    np.testing.assert_allclose(result["first.position"], expected, atol=1e-7 * np.abs(expected).max())
