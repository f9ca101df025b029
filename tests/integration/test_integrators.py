"""Every integration method, chosen as a parameter of the robot's FMU, does on the shipped scenes what its tolerance says; tolerance and
communication step decide how much a run costs, not what it says."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest

from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.fmu_build.choices import INTEGRATOR
from flexfmu.model.plants import build_model
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
METHODS = tuple(INTEGRATOR.items)
EXPLICIT = ("dopri5", "rk4")
"""They step along the edge of their stability, where modes of 2 kHz ring within the tolerance of the energy norm: invisible in
positions and torques, but not in accelerations, where their share is larger by the square of their frequency."""
STEP = 1e-3
SMALL = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "trajectory.dwell": 0.0}
"""A robot of two coordinates, both bending: steps of a millisecond resolve their vibration. With axial modes of 2 kHz, which
they don't, every implicit method falls back towards the order of its stages and an explicit one is unstable."""
FINE = {"gauss2": 4, "gauss3": 2, "gauss4": 2, "radau3": 4, "dopri5": 8, "rk4": 8, "radau3-dense": 4}
"""Steps in a communication step of 5 ms at which the asymptotic range has begun and rounding errors are still far."""
ORDERS = {"gauss2": 4, "gauss3": 6, "gauss4": 8, "radau3": 5, "dopri5": 5, "rk4": 4, "radau3-dense": 5}
"""Orders of the methods (Hairer, Norsett, Wanner: Solving ODEs I, tables II.1.2, II.5.2 and II.7; II, table IV.5.6)."""


def simulate(scene: Scene, method: str, tolerance: float, step: float = STEP, fixed: float = 0.0) -> Run:
    chosen = scene.replace({"cosimulation.integrator": method, "cosimulation.integrator_step": fixed})
    run = run_scene(chosen, tolerance=tolerance, communication_step=step)
    assert run.outcome is Outcome.COMPLETED, run.message
    return run


def elastic_state(run: Run) -> np.ndarray:
    """Elastic coordinates and rates at all communication points in the energy norm's scale, shape (N, 2 n)."""
    model = build_model(run.scene)
    derived = model.functions["derive"]([variable.start for variable in model.parameters])
    weights = np.asarray(model.functions["error_scale"](derived).full()).ravel()[:-1]
    columns = [run.recording.columns[name].values for name in (*model.unknowns, *(f"der({n})" for n in model.unknowns))]
    return np.stack(columns, axis=-1) * np.sqrt(weights)


@cache
def reference(name: str) -> Run:
    return simulate(load_scene(name), "gauss4", 1e-12)


@cache
def reference_metrics(name: str) -> Mapping[str, float | None]:
    return {metric: each.value for metric, each in measure_run(reference(name), companions=0).items()}


def metric_errors(run: Run, name: str) -> Mapping[str, float]:
    """Errors of the metrics, relative to the peak of the quantity that each is about; without the settling time, an instant
    that moves by any amount where the vibration just touches the band."""
    values = {name: each.value for name, each in measure_run(run, companions=0).items()}
    errors = {}
    for metric, exact in reference_metrics(name).items():
        value = values[metric]
        if metric != "settling_time" and value is not None and exact is not None:
            errors[metric] = abs(value - exact) / max(scale_of(metric, reference(name)), abs(exact))
    return errors


def scale_of(name: str, exact: Run) -> float:
    """Peak of the quantity that a metric is about; what is left of energies that cancel is about the larger of both."""
    quantity, joint = name[:-1], name[-1]
    whole = {"net_energy_": "positive_energy_", "regenerated_energy_": "positive_energy_", "mean_power_": "peak_power_"}
    if quantity in whole:
        return abs(exact.metrics[whole[quantity] + joint])
    return peaks(exact).get(deviation_of(name), 0.0)


def deviation_of(name: str) -> str:
    """Which deviation of the end effector a metric is about."""
    return next((kind for kind in ("velocity", "acceleration") if kind in name), "position")


def peaks(run: Run) -> Mapping[str, float]:
    """Largest deviation of the end effector from its rigid motion: position [m], velocity [m/s], acceleration [m/s²]."""
    found = {}
    for kind in ("position", "velocity", "acceleration"):
        parts = [
            run.recording[f"end_effector.{kind}.{axis}"].values
            - run.recording[f"end_effector.reference.{kind}.{axis}"].values
            for axis in "xy"
        ]
        found[kind] = float(np.max(np.hypot(*parts)))
    return found


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_achieves_the_tolerance(name: str, method: str) -> None:
    """Whoever asks for 1e-5 gets 1e-5, on the whole way, at the end and in the metrics, whatever integrates."""
    exact = reference(name)
    states = elastic_state(exact)
    scale = np.linalg.norm(states, axis=1).max()
    for tolerance in (1e-3, 1e-5, 1e-9):
        run = simulate(load_scene(name), method, tolerance)
        errors = np.linalg.norm(elastic_state(run) - states, axis=1) / scale
        assert errors.max() <= 10.0 * tolerance
        assert errors[-1] <= 10.0 * tolerance
        metrics = metric_errors(run, name)
        if method in EXPLICIT:
            # at the limit of stability the fast modes' accelerations ripple, and with them torque and power
            ripples = ("acceleration", "peak_power", "peak_regenerated_power")
            metrics = {name: error for name, error in metrics.items() if not any(each in name for each in ripples)}
        assert max(metrics.values()) <= 10.0 * tolerance, metrics


@pytest.mark.parametrize(
    ("damping", "tolerance", "method"),
    [
        ("modal", 1e-3, "radau3"),
        ("modal", 1e-6, "radau3"),
        ("modal", 1e-7, "gauss4"),
        ("none", 1e-3, "gauss3"),
        ("none", 1e-6, "gauss3"),
        ("none", 1e-7, "gauss4"),
    ],
)
def test_automatic_is_the_method_that_the_documentation_names(damping: str, tolerance: float, method: str) -> None:
    """Radau would damp what the scene leaves undamped, Gauss takes longer at loose tolerances: the same run, bit for bit."""
    changes = SMALL if damping == "modal" else SMALL | {"effects.damping": {"kind": damping}}
    scene = load_scene("barnard2012-6kg").replace(changes)
    chosen, named = (elastic_state(simulate(scene, each, tolerance, 5e-3)) for each in ("automatic", method))
    assert np.array_equal(chosen, named)


def test_every_admitted_tolerance_is_another_one() -> None:
    """The smallest tolerance that a scene may ask for still makes the steps shorter, so that no file promises more than it gets."""
    scene = load_scene("barnard2012-6kg").replace(SMALL)
    tolerances = (100.0 * LEAST_TOLERANCE, 10.0 * LEAST_TOLERANCE, LEAST_TOLERANCE)
    loose, middle, tight = (
        simulate(scene, "automatic", each, 5e-3).health.statistics["evaluations"] for each in tolerances
    )
    assert 1.1 * loose < middle < tight / 1.1


@cache
def small_reference() -> np.ndarray:
    return elastic_state(
        simulate(load_scene("barnard2012-6kg").replace(SMALL), "gauss4", LEAST_TOLERANCE, 5e-3, 5e-3 / 16)
    )


@pytest.mark.parametrize("method", METHODS[1:])
def test_every_method_has_its_order_on_the_robot(method: str) -> None:
    """Halving fixed steps divides the error by two to the order; inputs are the same polynomials on every communication step."""
    scene, exact = load_scene("barnard2012-6kg").replace(SMALL), small_reference()
    counts = FINE[method], 2 * FINE[method]
    runs = [simulate(scene, method, LEAST_TOLERANCE, 5e-3, 5e-3 / count) for count in counts]
    coarse, fine = (np.linalg.norm(elastic_state(run) - exact, axis=1).max() for run in runs)
    assert abs(np.log2(coarse / fine) - ORDERS[method]) <= 0.3


def test_fixed_steps_are_made_as_they_are_asked_for() -> None:
    """The paper's integration had fixed steps: every communication step is divided into as many as it takes."""
    scene = load_scene("barnard2012-6kg").replace(SMALL | {"trajectory.dwell": 0.01})
    for method, fixed in (("rk4", 1e-5), ("gauss3", 5e-4), ("gauss3", 1.0)):
        run = simulate(scene, method, 1e-6, 5e-3, fixed)
        spans = np.diff(np.unique(run.recording.time))
        assert run.health.statistics["steps"] == np.ceil(spans / fixed * (1.0 - 1e-9)).sum()
        assert run.health.statistics["rejections"] == 0


ABRUPT = {
    "bang-bang": {"trajectory.profile": {"kind": "bang-bang"}},
    "trapezoidal on clothoids": {
        "trajectory.profile": {"kind": "trapezoidal", "ramp": 0.125},
        "trajectory.blend.kind": "clothoid",
    },
}


def measurements(scene: Scene, tolerance: float, step: float) -> Mapping[str, Metric]:
    """Metrics with their errors."""
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
@pytest.mark.parametrize(
    ("one", "other", "bound"),
    [((1e-10, 2e-4), (1e-11, 2e-4), 1e-7), ((1e-10, 5e-4), (1e-10, 5e-5), 1e-5)],
    ids=["tolerance", "communication step"],
)
def test_metrics_belong_to_the_continuous_solution(
    name: str, one: tuple[float, float], other: tuple[float, float], bound: float
) -> None:
    """A tenth of the tolerance changes no metric, and no communication step between 0.05 ms and 0.5 ms does."""
    changes = relative_changes(load_scene(name), one, other)
    assert max(changes.values()) <= bound, changes


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


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize("changes", [{}, *ABRUPT.values()], ids=["seventh degree", *ABRUPT.keys()])
@pytest.mark.parametrize("step", [1e-3, 5e-3])
def test_the_end_state_doesnt_depend_on_the_communication_step(
    name: str, changes: dict[str, object], step: float
) -> None:
    """Up to 5 ms the input derivatives carry the trajectory: the end state stays within the tolerance of 1e-6."""
    scene = load_scene(name).replace(changes)
    exact = elastic_state(run_scene(scene, tolerance=1e-11, communication_step=1e-4))
    coarse = elastic_state(run_scene(scene, communication_step=step))
    scale = np.linalg.norm(exact, axis=1).max()
    assert np.linalg.norm(coarse[-1] - exact[-1]) <= scene.cosimulation.tolerance * scale
