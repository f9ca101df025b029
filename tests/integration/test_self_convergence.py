"""Tolerance and communication step decide how much a run costs, not what it says."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
ABRUPT = {
    "bang-bang": {"trajectory.profile": {"kind": "bang-bang"}},
    "trapezoidal on clothoids": {
        "trajectory.profile": {"kind": "trapezoidal", "ramp": 0.125},
        "trajectory.blend.kind": "clothoid",
    },
}


def measurements(scene: Scene, tolerance: float, step: float) -> Mapping[str, Metric]:
    return measure_run(run_scene(scene, tolerance=tolerance, communication_step=step))


def relative_changes(scene: Scene, one: tuple[float, float], other: tuple[float, float]) -> dict[str, float]:
    """Relative change of each metric between two settings (tolerance, communication step); absolute where it is zero."""
    first, second = measurements(scene, *one), measurements(scene, *other)
    changes = {}
    for name, measurement in second.items():
        values = first[name].value, measurement.value
        if values[0] is not None and values[1] is not None:
            changes[name] = abs(values[0] - values[1]) / (abs(values[1]) or 1.0)
    assert len(changes) >= 12
    return changes


@pytest.mark.parametrize("name", SHIPPED)
def test_metrics_are_converged_to_1e_7_at_a_tolerance_of_1e_10(name: str) -> None:
    """The tolerance means what it says: a tenth of it changes no metric."""
    changes = relative_changes(load_scene(name), (1e-10, 2e-4), (1e-11, 2e-4))
    assert max(changes.values()) <= 1e-7, changes


@pytest.mark.parametrize("name", SHIPPED)
def test_no_metric_depends_on_the_communication_step(name: str) -> None:
    """Between 0.05 ms and 0.5 ms no metric changes by more than 1e-5: metrics belong to the continuous solution."""
    changes = relative_changes(load_scene(name), (1e-10, 5e-4), (1e-10, 5e-5))
    assert max(changes.values()) <= 1e-5, changes


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("changes", ABRUPT.values(), ids=ABRUPT.keys())
def test_where_the_communication_step_is_too_coarse_the_metric_says_so(name: str, changes: dict[str, object]) -> None:
    """A jump excites modes that 0.5 ms can't resolve: the stated interpolation error covers the change that it makes."""
    scene = load_scene(name).replace(changes)
    coarse, fine = measurements(scene, 1e-10, 5e-4), measurements(scene, 1e-10, 5e-5)
    for metric, measurement in coarse.items():
        reference = fine[metric].value
        if measurement.value is None or reference is None:
            continue
        change = abs(measurement.value - reference)
        assert change <= 1e-5 * abs(reference) + 2.0 * measurement.interpolation_error, metric


@cache
def error_weights(scene: Scene) -> np.ndarray:
    """[kappa, mu] of the plant's error norm."""
    model = build_model(scene)
    derived = model.functions["derive"]([variable.start for variable in model.parameters])
    return np.asarray(model.functions["error_scale"](derived).full()).ravel()[:-1]


def elastic_state(run: Run) -> np.ndarray:
    """Elastic coordinates and rates of the whole run in the energy norm's scale, shape (N, 2 n)."""
    names = build_model(run.scene).unknowns
    columns = [run.recording.columns[name].values for name in (*names, *(f"der({name})" for name in names))]
    return np.stack(columns, axis=-1) * np.sqrt(error_weights(run.scene))


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("changes", [{}, *ABRUPT.values()], ids=["seventh degree", *ABRUPT.keys()])
@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_the_end_state_doesnt_depend_on_the_communication_step(
    name: str, changes: dict[str, object], step: float
) -> None:
    """Up to 5 ms the input derivatives carry the trajectory: the end state stays within the tolerance of 1e-6."""
    scene = load_scene(name).replace(changes)
    reference = elastic_state(run_scene(scene, tolerance=1e-11, communication_step=1e-4))
    coarse = elastic_state(run_scene(scene, communication_step=step))
    scale = np.linalg.norm(reference, axis=1).max()
    assert np.linalg.norm(coarse[-1] - reference[-1]) <= scene.cosimulation.tolerance * scale


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7])
def test_achieved_errors_follow_the_tolerance(tolerance: float) -> None:
    """Over the whole run the error of the state stays below the tolerance, and isn't wastefully small at 5 ms."""
    scene = load_scene("barnard2012-6kg")
    reference = elastic_state(run_scene(scene, tolerance=1e-11, communication_step=5e-3))
    state = elastic_state(run_scene(scene, tolerance=tolerance, communication_step=5e-3))
    scale = np.linalg.norm(reference, axis=1).max()
    error = np.linalg.norm(state - reference, axis=1).max() / scale
    assert 1e-2 * tolerance <= error <= tolerance
