"""Settings chosen for an accuracy: the total error against an independent, richer and finer run, wrong requests, and what is written."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.effects.accuracy import Chooser, accuracy_answer, chosen_over, with_answer
from flexfmu.cosim.design.effects.estimator import with_set
from flexfmu.cosim.design.effects.runs import SceneRuns
from flexfmu.cosim.experiment.accuracy import asked_of, rounded_up
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.cosim.studies.sweep.sweep import ready_to_sweep
from flexfmu.model.scene.schema import Scene

RICH = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 4,
    "effects.proximal_axial": 2,
    "effects.distal_bending": 3,
    "effects.distal_axial": 2,
    "effects.beam": "timoshenko",
    "effects.foreshortening": True,
}


def true_errors(scene: Scene, changes: dict[str, object], names: list[str]) -> dict[str, float]:
    """Errors of settings beside a rich model with another integrator, relative to its values."""
    rich = scene.replace(
        RICH | {"cosimulation.integrator": "gauss3", "cosimulation.step": 1e-4, "cosimulation.tolerance": 1e-11}
    )
    own = measure_run(PreparedScene(scene.replace(changes)).run(), 0, names)
    true = measure_run(PreparedScene(rich).run(), 0, names)
    return {name: abs(own[name] - true[name]) / abs(true[name]) for name in names}


@pytest.fixture(scope="module")
def scene_6kg() -> Scene:
    """The paper's scene."""
    return flexfmu.load_scene("barnard2012-6kg")


@pytest.mark.slow
def test_the_total_error_is_within_what_was_asked(scene_6kg: Scene) -> None:
    """Beside an independent run of the richest model; the cheapest settings are much cheaper than the scene's own."""
    asked = {"peak_torque_1": 1e-3, "residual_vibration_amplitude": 2e-2}
    run = flexfmu.run(scene_6kg, accuracy=asked)
    answer = run.accuracy
    assert answer is not None
    errors = true_errors(scene_6kg, dict(answer.changes), [*asked])
    assert all(errors[name] <= bound for name, bound in asked.items())
    for figure in answer.figures:
        assert errors[figure.name] * abs(figure.value) <= figure.total <= figure.allowed
        assert run.metrics[figure.name].error == figure.total
    assert answer.default is not None
    assert answer.following is not None
    assert answer.chosen.time < 0.5 * answer.default.time < answer.dearest.time
    # cached: the same answer at once
    assert accuracy_answer(scene_6kg.replace({"accuracy": asked})) == answer


@pytest.mark.slow
def test_settings_of_a_sweep_hold_at_its_corners(scene_6kg: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """What suits rigid, light work is tightened for a heavy payload; settings for ten times more are taken where they are cheaper."""
    scene = scene_6kg.replace(
        {"payload.mass": 0.5, "accuracy": {"peak_position_error": 5e-2}, "trajectory.dwell": 0.02}
    )
    heavy, notes = scene.replace({"payload.mass": 20.0, "trajectory.duration": 0.3}), list[str]()
    chosen = chosen_over(scene, {"payload.mass = 20.0": heavy}, note=notes.append)
    judge = Chooser(heavy, scene.accuracy or {})
    assert judge.missed_by(chosen) <= 1.0
    assert all(note.startswith("at payload.mass = 20.0 the chosen settings") for note in notes)
    (cheap,) = judge.trials.values()
    monkeypatch.setattr(judge, "_why", lambda chosen: "")
    monkeypatch.setattr(judge, "trial", lambda scene: cheap)
    dear = replace(cheap, time=2.0 * cheap.time)
    for first, second, best in ((dear, cheap, cheap), (cheap, dear, cheap), (cheap, None, cheap)):
        monkeypatch.setattr(
            judge, "cheapest", lambda target=1.0, own=first, tenth=second: own if target == 1.0 else tenth
        )
        assert judge.answer().chosen.time == best.time


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"peak_torq_1": 1e-3}, "did you mean 'peak_torque_1'"),
        ({"peak_torque_1": "1 um"}, "it is in N.m"),
        ({"peak_torque_1": "1"}, "no unit"),
        ({"end_position_error": "-1 um"}, "must be above 0"),
        ({"gain_margin": 1e-2}, "has no controller"),
        ({"peak_torque_1": 1e-14}, "the smallest relative error is 1e-10"),
    ],
)
def test_wrong_requests_are_one_sentence(scene_6kg: Scene, asked: dict[str, float | str], message: str) -> None:
    """Unknown figures, units that don't fit, and values that are no errors."""
    with pytest.raises(flexfmu.InputError, match=message):
        flexfmu.run(scene_6kg, accuracy=asked)


@pytest.mark.parametrize("value", [0.0, 1.0, -1e-3, True])
def test_relative_errors_are_between_zero_and_one(scene_6kg: Scene, value: float) -> None:
    """And the message names the key."""
    with pytest.raises(flexfmu.SceneError, match=r"accuracy\.peak_torque_1"):
        scene_6kg.replace({"accuracy": {"peak_torque_1": value}})


def test_relative_errors_may_be_percentages() -> None:
    """On the command line; the scene has numbers."""
    assert asked_of(["peak_torque_1=0.1%", "peak_torque_2 = 1e-3", "end_position_error=1 um"]) == {
        "peak_torque_1": 1e-3,
        "peak_torque_2": 1e-3,
        "end_position_error": "1 um",
    }
    with pytest.raises(flexfmu.Error, match="peak_torque_1 twice"):
        asked_of(["peak_torque_1=1e-3", "peak_torque_1=1e-4"])


@given(st.floats(1e-30, 1e30))
def test_printed_bounds_are_bounds(error: float) -> None:
    """Two digits never state less than is known, and at most a tenth more."""
    printed = float(f"{rounded_up(error):.2g}")
    assert error * (1.0 - 1e-9) <= printed <= 1.1 * error * (1.0 + 1e-9)


def test_an_empty_table_asks_for_nothing(scene_6kg: Scene) -> None:
    """And the scene stays one that can be kept."""
    scene = scene_6kg.replace({"accuracy": {}})
    assert (scene.accuracy, hash(scene)) == (None, hash(scene_6kg))


@pytest.mark.slow
def test_the_command_writes_the_chosen_settings(tmp_path: Path) -> None:
    """A scene that runs with them, and the answer in summary.json."""
    target, out = tmp_path / "chosen.toml", tmp_path / "out"
    command = ["run", "barnard2012-6kg", "--accuracy", "peak_torque_1=1e-2", "-o", str(target), "--out", str(out)]
    result = CliRunner().invoke(app, [*command, "--no-report", "--no-verify"])
    assert result.exit_code == 0
    assert "ten times more accurate" in result.stdout
    answer = json.loads((out / "summary.json").read_text())["accuracy"]
    scene = flexfmu.load_scene(target)
    assert target.read_text(encoding="utf-8").startswith("# settings chosen for peak_torque_1 = 0.01\n")
    assert not scene.accuracy
    assert scene.cosimulation.tolerance == answer["changes"]["cosimulation.tolerance"]
    asked = flexfmu.load_scene("barnard2012-6kg").replace({"accuracy": {"peak_torque_1": 1e-2}})
    assert with_answer(asked, accuracy_answer(asked)).effects == scene.effects


PAGE = (Path(__file__).parents[3] / "docs" / "accuracy.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_example_of_the_page_runs() -> None:
    """It holds what it asserts."""
    exec(re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)[0], {})


def test_the_section_of_the_page_is_one(scene_6kg: Scene) -> None:
    """As a scene file has it."""
    block = tomllib.loads(re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0])
    assert scene_6kg.replace(block).accuracy == block["accuracy"]


def test_a_payload_of_zero_has_neighbours(scene_6kg: Scene) -> None:
    """Those of the links' density."""
    scene = with_set(scene_6kg.replace({"payload.mass": 0.0}), {"proximal_bending": 1})
    values = SceneRuns(["peak_torque_1"]).observe(scene).values
    assert len({value for (value,) in values}) == 3


def test_accuracy_chooses_what_a_sweep_may_not_vary(scene_6kg: Scene) -> None:
    """Before anything is run."""
    scene = scene_6kg.replace({"accuracy": {"peak_torque_1": 1e-2}})
    with pytest.raises(flexfmu.SceneError, match="varied too"):
        ready_to_sweep(scene, Cases(("cosimulation.tolerance",), ((1e-3,), (1e-5,))))
