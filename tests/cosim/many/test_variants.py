"""Variants through one FMU are the runs that they would be alone, in the order asked for, whatever happens to others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.many.variants import DURATION, VariantError, bands, run_variants
from flexfmu.cosim.metrics.metrics import measuring, metrics_of
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.errors import TrajectoryError

SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.02})
STEP = 1e-3
TORQUE = "joint1.torque"


def torque(run: Run) -> np.ndarray[Any, Any]:
    """(3, N) torque of the first joint with its derivatives."""
    column = run.recording[TORQUE]
    return np.stack([each for each in (column.values, column.first, column.second) if each is not None])


def alone(changes: dict[str, Any]) -> Run:
    """The variant as a run of its own."""
    motion = {key: value for key, value in changes.items() if key.startswith("trajectory.")}
    rest = {key: value for key, value in changes.items() if key not in motion}
    scene = SCENE.replace(motion) if motion else SCENE
    return run_scene(scene, communication_step=STEP, fmu_path=build_scene(SCENE).path, parameters=rest)


def test_variants_are_single_runs() -> None:
    """Payloads and motions mixed, so that variants that share a motion don't follow one another; to the last bit."""
    variants: list[dict[str, Any]] = [
        {"payload.mass": 3.0, "trajectory.duration": 0.25},
        {},
        {"payload.mass": 1.0},
        {"trajectory.duration": 0.25},
        {"trajectory.profile.kind": "bang-bang", "damping.ratio": 0.2},
    ]
    told: list[float] = []
    found = run_variants(
        SCENE, variants, torque, communication_step=STEP, record=Selection([TORQUE]), progress=told.append
    )
    assert [each.changes for each in found] == variants
    assert told == [0.2, 0.4, 0.6, 0.8, 1.0]
    for each in found:
        assert each.error is None
        assert np.array_equal(each.value, torque(alone(dict(each.changes))))


def test_some_metrics_are_those_of_the_run() -> None:
    """A sweep computes only what it is asked for, from only the signals that takes: light and heavy payloads of the paper."""
    variants = [{"payload.mass": 0.1}, {"payload.mass": 6.0}]
    signals = Selection(["joint2.torque"])
    some = run_variants(SCENE, variants, measuring(["peak_torque_2"]), communication_step=STEP, record=signals)
    light, heavy = (each.value for each in run_variants(SCENE, variants, metrics_of, communication_step=STEP))
    assert light is not None
    assert heavy is not None
    assert heavy == metrics_of(alone({"payload.mass": 6.0}))
    assert (light["peak_torque_1"] or 0.0) < (heavy["peak_torque_1"] or 0.0)
    assert [each.value for each in some] == [{"peak_torque_2": each["peak_torque_2"]} for each in (light, heavy)]


def test_a_failure_leaves_the_others_alone() -> None:
    """A parameter out of range or unknown, a motion out of reach, a run that fails on its way, a measurement that can't
    be taken: each keeps its own error."""

    def peak(run: Run) -> float:
        if run.parameters.get("payload.mass") == 2.0:
            raise ZeroDivisionError("no payload of 2 kg, please")
        return float(abs(torque(run)[0]).max())

    variants: list[dict[str, Any]] = [
        {"payload.mass": 1.0},
        {"payload.mass": -1.0},
        {"paylod.mass": 1.0},
        {"trajectory.height": 2.0},
        {"payload.mass": 2.0},
        {"material.youngs_modulus": 7e4},
        {"payload.mass": 1.0},
    ]
    found = run_variants(SCENE, variants, peak, communication_step=STEP)
    errors = [InputError, InputError, TrajectoryError, ZeroDivisionError, VariantError]
    assert [type(each.error) for each in found] == [type(None), *errors, type(None)]
    assert run_variants(SCENE, [], peak) == []
    assert found[0].value == found[6].value == peak(alone({"payload.mass": 1.0}))
    assert all(each.value is None for each in found[1:6])


@pytest.mark.parametrize("name", ["joint1.torqe", "end_effector"])
def test_what_cannot_be_recorded(name: str) -> None:
    """A misspelt signal is every variant's error, with its name."""
    (found,) = run_variants(SCENE, [{}], torque, record=Selection([name]))
    assert isinstance(found.error, InputError)
    assert name in str(found.error)


def test_bands() -> None:
    """Side by side is what has one motion; where durations may differ, those within a quarter, and one that is none alone."""
    motions = [{DURATION: time, "trajectory.height": height} for time in (0.4, 0.5, 0.51, "long") for height in (1, 2)]
    found = bands(range(8), motions.__getitem__, lambda i: motions[i][DURATION])
    assert [*found] == [[4, 2], [0], [6], [5, 3], [1], [7]]
    assert [*bands(range(8), motions.__getitem__)] == [[i] for i in range(8)]
    assert [*bands([3, 0, 1], lambda i: {})] == [[3, 0, 1]]
