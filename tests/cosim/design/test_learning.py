"""Learning judged before the run: contractions and responses of the linear loop against runs, chosen filters, norm-optimal laws."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import flexfmu
from flexfmu.cosim.design.effects.choice import resolved
from flexfmu.cosim.design.learning import LearningLoop, contraction_of
from flexfmu.cosim.engine.errors import InputError, LearningWarning
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

H = 1e-3
PD = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": H}
LEARNING = {"kind": "learning", "gain": 4e3, "lead": 4, "cycles": 8, "sample_time": H}
NORM_OPTIMAL = {"kind": "learning", "law": "norm-optimal", "cycles": 3, "sample_time": H}


def documented(*controllers: dict[str, Any]) -> Scene:
    """The robot of the documentation's example."""
    changes = {"effects.motor_inertia": 0.1, "trajectory.duration": 0.6, "trajectory.dwell": 0.15}
    scene = load_scene("barnard2012-6kg")
    return scene.replace({"cosimulation.drive": "torque", "controller": list(controllers), **changes})


def quick(*controllers: dict[str, Any], **changes: Any) -> Scene:
    """A robot with one bending mode in a short motion, which runs many cycles in a second."""
    others = dict.fromkeys(("proximal_axial", "distal_bending", "distal_axial"), 0)
    effects = {f"effects.{key}": value for key, value in {"proximal_bending": 1, **others}.items()}
    motion = {"trajectory.duration": 0.2, "trajectory.dwell": 0.06, "cosimulation.step": H}
    return documented(*controllers).replace(effects | motion | changes)


def errors_of(scene: Scene) -> NDArray[np.float64]:
    """Tracking error of each cycle [rad]; infinite where a run ended before all of them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = run_scene(scene)
    found = [max(each.rms) for each in cycle_errors(run.plan, run.recording)]
    return np.array(found + [np.inf] * (not run.completed))


def test_contraction_of_gains_that_grow_late() -> None:
    """Errors shrink for fifty cycles and then grow at 198 Hz: known before the run, in the middle of the path."""
    found = contraction_of(documented(PD, LEARNING))
    assert found is not None
    assert (found.factor, found.frequency) == (pytest.approx(1.0332, abs=2e-4), pytest.approx(198.5, abs=0.5))
    assert found.place == 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "late"), [(H, 0.0), (H, 7e-4), (5e-4, 0.0), (2e-3, 0.0)], ids=["alone", "delay", "faster", "slower"]
)
def test_response_is_that_of_the_robot(rate: float, late: float) -> None:
    """Angles after a pulse of torque at rest are those of a run minus those of a run without it."""
    gains = {"proportional": 2e3, "derivative": 25.0}
    scene = quick(
        {**PD, **gains, "sample_time": rate}, LEARNING, **{"trajectory.dwell": 0.3, "cosimulation.step": 5e-4}
    )
    if late:
        scene = scene.replace({"imperfection": [{"kind": "delay", "time": late, "signal": "torque"}]})
    response = LearningLoop(scene).response(1.0)
    count, begin, runs = 60, 400, []
    starts = range(begin, begin + round(max(rate / H, 1.0)))
    for pulse in (None, *starts):

        @flexfmu.controller(sample_time=H, inputs=[], outputs=["joint1.feedforward", "joint2.feedforward"])
        def pushing(t: Any, at: float = -1.0 if pulse is None else float(pulse)) -> Any:
            return 1.0 * (abs(t / H - at) < 0.5), 0.0

        controllers = [flexfmu.control.pd(**gains, sample_time=rate), pushing]
        imperfections = [flexfmu.imperfections.delay(time=late, sample_time=rate)] if late else []
        recording = flexfmu.run(scene, controllers=controllers, imperfections=imperfections, tolerance=1e-10).recording
        angles = np.array([recording[f"joint{i}.position"].values for i in (1, 2)])
        instants = np.searchsorted(recording.time, H * ((pulse or begin) + np.arange(count)) - 1e-9)
        runs.append((recording.time, angles, instants))
    differences = [(angles - runs[0][1])[:, instants] for _, angles, instants in runs[1:]]
    found, wanted = np.mean(differences, axis=0).T, response[:count, :, 0]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=5e-3 * abs(wanted).max())


@pytest.mark.slow
def test_contraction_predicts_runs() -> None:
    """Of drawn loops those with a contraction below 1 end with their smallest error; above 1.1 errors grow."""
    rng, seen = np.random.default_rng(3), []
    for _ in range(12):
        gain, lead = 10.0 ** rng.uniform(2.9, 4.0), int(rng.integers(0, 8))
        feedback = {**PD, "proportional": rng.uniform(4e3, 1.2e4), "derivative": rng.uniform(60.0, 120.0)}
        if rng.random() < 0.5:
            feedback |= {"kind": "pid", "integral": 5.0 * feedback["proportional"], "filter_time": 5e-4}
        learning = {**LEARNING, "gain": gain, "lead": lead, "cycles": 50, "forgetting": rng.choice([0.0, 0.03])}
        if rng.random() < 0.5:
            learning["q_filter"] = rng.uniform(25.0, 100.0)
        scene = quick(feedback, learning)
        found = contraction_of(scene)
        if found is None or 1.0 < found.factor < 1.1:
            continue
        errors = errors_of(scene)
        seen.append(found.factor < 1.0)
        assert (errors[-1] <= 1.02 * errors.min()) == seen[-1], (found, errors)
    assert {True, False} == set(seen)


@pytest.mark.slow
def test_a_chosen_filter_makes_learning_converge() -> None:
    """What a run warns of grows in a hundred cycles; with a chosen cut-off the last error is the smallest, as predicted."""
    scene = quick(PD, {**LEARNING, "gain": 8e3, "cycles": 60, "lead": 3})
    with pytest.warns(
        LearningWarning, match=r"errors at [0-9.]+ Hz grow [0-9.]+-fold in each cycle about 50 % of the path"
    ):
        resolved(scene)
    chosen = resolved(scene.replace({"controller.1.q_filter": "auto"}))
    found = contraction_of(chosen)
    assert found is not None
    assert found.converges
    before, after = errors_of(scene), errors_of(chosen)
    assert before[-1] > 3.0 * before.min()
    assert after[-1] <= 1.05 * after.min()
    assert after[-1] == pytest.approx(after[-10], rel=1e-3)
    assert after[-1] < 0.3 * after[0]


@pytest.mark.slow
@pytest.mark.parametrize("payload", [4.8, 7.2])
def test_norm_optimal_learning_with_a_wrong_payload(payload: float) -> None:
    """Two cycles of learning leave a fiftieth of the error, with a payload assumed that is a fifth too small or too large."""
    gravity = {"kind": "gravity-feedforward", "sample_time": H}
    scene = quick({**PD, "proportional": 5e3, "derivative": 50.0}, {**NORM_OPTIMAL, "payload": payload}, gravity)
    errors = errors_of(resolved(scene))
    assert errors[1] < 0.15 * errors[0]
    assert errors[2] < 0.02 * errors[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain": None}, "the key `gain` in N.m/rad is missing"),
        ({"law": "norm-optimal"}, '`gain` goes with `law = "proportional"`, not with "norm-optimal"'),
        ({"regularisation": 0.1}, '`regularisation` goes with `law = "norm-optimal"`'),
        ({"q_filter": 0.0}, r"`controller\[1\].q_filter`: give a cut-off above 0 Hz, .auto. or .none., got 0.0"),
    ],
)
def test_keys_that_do_not_fit(change: dict[str, Any], message: str) -> None:
    """What is wrong and what would be right, in one line."""
    learning = {key: value for key, value in (LEARNING | change).items() if value is not None}
    with pytest.raises(SceneError, match=message):
        documented(PD, learning)


def test_what_is_open_must_be_chosen_first() -> None:
    """A prepared scene says where the choice is made; no filter helps a gain that is too large for errors at rest."""
    for learning in (LEARNING | {"q_filter": "auto"}, NORM_OPTIMAL):
        with pytest.raises(InputError, match=r"learning leaves .* open: run the scene with `flexfmu.run`"):
            run_scene(quick(PD, learning))
    with pytest.raises(InputError, match="no Q-filter makes learning converge: errors change by factors up to 2"):
        flexfmu.run(quick(PD, {**LEARNING, "gain": 3e4, "lead": 0, "q_filter": "auto"}))
