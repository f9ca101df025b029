"""The automatic choice of effects from the scene file to the FMU: estimates against runs, and what says what was chosen."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.design.effects import choice as verified
from flexfmu.cosim.design.effects.choice import EXACT, MEASURED, Observed, choose_verified, followed, resolved
from flexfmu.cosim.design.effects.estimator import Estimator, richest, with_set
from flexfmu.cosim.design.effects.search import choose_effects
from flexfmu.cosim.design.effects.study import comparisons, study_effects
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.many.journal import WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.cosim.reports.summary import _beyond_tolerance
from flexfmu.model.choice_text import choice_sentence
from flexfmu.model.plants import build_model
from flexfmu.model.scene.choice import MeasureName, integrator_tolerance
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

ROOT = Path(__file__).parents[3]
OPEN = load_scene(ROOT / "examples" / "effects_auto.toml")
STEEL = {"density": 7850.0, "youngs_modulus": 210e9}
TORQUE = {"effects.of": ["peak_torque_1"], "effects.tolerance": 0.5}
"""A wish that rigid links fulfil."""


@pytest.mark.slow
def test_observed_errors_are_within_the_tolerance_and_near_their_estimates() -> None:
    """A scene of `benchmarks/effect_choice.py`, heavy with jumps: the error beside the richest FMU is below 1 %, 1 to 10 times
    overestimated."""
    task = {"payload.mass": 3.0, "trajectory.duration": 0.30, "trajectory.profile": {"kind": "bang-bang"}}
    scene = load_scene("barnard2012-6kg").replace(task)
    everything = next(comparisons(study_effects(scene, 0.01)))
    assert max(everything.observed.values()) < 0.01
    assert everything.effectivity is not None
    assert 1.0 <= everything.effectivity <= 10.0
    assert everything.effectivity == max(everything.estimated.values()) / max(everything.observed.values())


@pytest.mark.slow
def test_open_scene_runs_as_rigid_where_that_will_do(tmp_path: Path) -> None:
    """`run` resolves the scene, says so, simulates a model without elastic states, and tells it all in summary.json."""
    command = ["run", str(ROOT / "examples" / "effects_auto.toml"), "--out", str(tmp_path)]
    wishes = ["--set", "effects.of=['peak_torque_1']", "--set", "effects.tolerance=0.4"]
    result = CliRunner().invoke(app, command + wishes)
    assert result.exit_code == 0, result.output
    told = " ".join(result.stdout.split())
    assert "effects chosen for 40 %: rigid links (errors beside the richest set: peak_torque_1" in told
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    choice = summary["effect_choice"]
    assert choice["estimated_error"]["peak_torque_1"] <= 0.2
    assert summary["health"]["tolerance"] == choice["integrator_tolerance"] == 0.001
    assert {each["effect"] for each in choice["effects"]} >= {"proximal_bending", "distal_axial", "beam"}
    assert '"link' not in (tmp_path / "results.csv").read_text().partition("\n")[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"mechanism.material": STEEL, "payload.mass": 2.0, "effects.damping": {"kind": "none"}},
        {
            "cosimulation.drive": "torque",
            "cosimulation.record": ["joint1.torque"],
            "effects.motor_inertia": 0.1,
            "effects.damping": {"kind": "modal", "ratio": 0.01},
            "controller": [{"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 5e-4}],
            "disturbance": [{"kind": "step", "signal": "force.x", "amplitude": 20.0, "start": 0.05}],
        },
    ],
    ids=["undamped steel", "disturbed loop"],
)
def test_the_stated_error_is_that_of_the_scene_as_it_runs(changes: dict[str, object]) -> None:
    """Of vibrations that are 1 % of the deflection and never die out, and of a loop under a disturbance: the error beside the
    richest set is the stated one, and below the tolerance, of the residual vibration relative to itself."""
    tolerance = 1e-2
    scene = load_scene("barnard2012-6kg").replace(
        {"cosimulation.tolerance": integrator_tolerance(tolerance), **changes}
    )
    chosen, estimator = choose_verified(scene, followed(scene), tolerance, MEASURED, MEASURED)
    own, exact = (
        metrics_of(PreparedScene(each, tolerance=limit, record=Selection()).run(), MEASURED)
        for each, limit in ((chosen, None), (estimator.richest, EXACT))
    )
    errors = [abs((own[name] or 0.0) / (exact[name] or 1.0) - 1.0) for name in MEASURED]
    assert chosen.effects.choice is not None
    assert chosen.effects.choice.verified_in == "scene"
    assert chosen.effects.choice.verified == pytest.approx(errors, rel=1e-6, abs=1e-9)
    assert max(errors) < tolerance


class Pretended:
    """Stands in for searching and running: sets are rigid links and everything; runs are by a factor further from the richest one's
    than estimated, that of the richest one is by a share larger than estimated, and all are off by 200 times their own tolerance."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, scene: Scene) -> None:
        names: tuple[MeasureName, ...] = ("peak_torque_1", "peak_position_error")
        self.estimator, self.factor, self.unforeseen = Estimator(scene, plan(scene).joints, names), 1.0, 0.0
        monkeypatch.setattr(verified, "rich_enough", lambda *_: self.estimator.richest)
        monkeypatch.setattr(verified, "Estimator", lambda *_: self.estimator)
        monkeypatch.setattr(verified, "choose_effects", self.choose)
        monkeypatch.setattr(verified, "observe", self.observe)

    def choose(self, scene: Scene, _: object, tolerance: float, of: Any, __: object, safety: dict[str, float]) -> Scene:
        """Rigid links where their estimate is small enough."""
        for each in (with_set(scene, {}), richest(scene)):
            error = safety["peak_torque_1"] * self.estimator.errors(each.effects)["peak_torque_1"]
            if error <= 0.5 * tolerance:
                break
        choice = {"tolerance": tolerance, "of": of, "error": (error,), "effects": ()}
        return each.replace({"effects.choice": choice})

    def observe(self, scene: Scene, of: Any, tolerance: float | None = None, **_: object) -> Observed:
        """What a run is pretended to show."""
        exact, own = self.estimator.reference, self.estimator.metrics(scene.effects)
        off = 1.0 - 200.0 * (tolerance or scene.cosimulation.tolerance)
        off += self.unforeseen if scene.effects.foreshortening else 0.0
        return Observed(
            {name: off * (exact[name] + self.factor * (own[name] - exact[name])) for name in of}, lambda: None
        )


def test_estimates_and_runs_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What an interrupted choice has found isn't made again."""
    joints, most, of, made = plan(OPEN).joints, with_set(OPEN, {}), ("peak_torque_1",), list[str]()

    def chosen(said: list[str]) -> list[Any]:
        journal = WorkJournal(tmp_path, "choice of effects", {}, note=said.append)
        estimator = Estimator(OPEN, joints, of, most=most, journal=journal)
        runs = verified._Runs(estimator, of, lambda *_: None, journal)
        return [estimator.metrics(most.effects), runs._richest, runs.errors(most, 1e-3), runs.errors(most, 1e-4)]

    def observed(scene: Scene, of: Any, tolerance: float, **_: object) -> Observed:
        made.append(f"{tolerance:g}")
        if tolerance == 1e-4:
            raise ResultsError("the loop is unstable")
        return Observed(dict.fromkeys(of, 2.0 + tolerance), lambda: None)

    monkeypatch.setattr(verified, "observe", observed)
    first, said = chosen([]), list[str]()
    monkeypatch.setattr(Estimator, "_solution", lambda *_: pytest.fail("estimated again"))
    assert chosen(said) == first
    assert said == ["continuing: 4 done"]
    assert made == ["1e-09", "0.001", "0.0001"]


@pytest.mark.slow
def test_choices_that_runs_contradict_are_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rigid links are estimated to do for 10 % of the torque. Runs confirm it; with four times the error, or a richest set whose
    estimate is as wrong as theirs, they make the choice more careful; and an integrator that is to blame gets a tighter tolerance, unless the scene gives it one."""
    scene = OPEN.replace(TORQUE | {"effects.tolerance": 0.1})
    runs, joints = Pretended(monkeypatch, scene), plan(scene).joints
    exact = scene.replace({"cosimulation.tolerance": 1e-7})
    for runs.factor, runs.unforeseen, elastic in ((1.0, 0.0, False), (4.0, 0.0, True), (1.0, 0.2, True)):
        chosen, _ = choose_verified(exact, joints, 0.1, ("peak_torque_1",))
        assert bool(chosen.effects.proximal_bending) is elastic
    runs.factor, runs.unforeseen = 1.0, 0.0
    chosen = resolved(scene)
    assert chosen.effects.proximal_bending == 0
    assert chosen.cosimulation.tolerance == pytest.approx(1e-4)
    given = scene.replace({"cosimulation.tolerance": 2e-3})
    kept = resolved(given)
    assert kept.cosimulation.tolerance == 2e-3
    assert "NOT within 10 %: peak_torque_1, with a tolerance of the FMU of 0.002" in choice_sentence(kept)
    assert "NOT" not in choice_sentence(chosen)


def test_numerical_errors_beyond_what_was_asked_are_warned_of() -> None:
    """A loop that is sampled coarsely has an error that no set of effects mends: it is measured against the tolerance of the choice."""
    of = ["peak_torque_1", "residual_vibration_amplitude"]
    choice = {"tolerance": 1e-3, "of": of, "error": [0, 0], "effects": []}
    scene = with_set(OPEN, {}).replace({"effects.choice": choice})
    run: Any = SimpleNamespace(scene=scene, communication_step=1e-3, tolerance=1e-6)
    found = {
        "peak_position_error": Metric(1e-3),
        "peak_torque_1": Metric(100.0, error=1.5, own=100.0, own_error=1.5),
        "residual_vibration_amplitude": Metric(1e-8, error=9e-11, own=1e-8, own_error=9e-11),
    }
    (sentence,) = _beyond_tolerance(run, found)
    assert sentence.startswith("Peak torque, joint 1: the run's own numerical error of 1.5 N·m is more than the 0.1 %")


def test_an_open_scene_is_refused_where_nothing_chooses() -> None:
    """The choice is made along the scene's motion; along another one it would be another."""
    with pytest.raises(InputError, match="leaves the choice of effects open"):
        PreparedScene(OPEN, motion=plan(OPEN))


def test_the_documentation_of_an_fmu_says_what_was_chosen() -> None:
    """That of a scene that chooses itself doesn't."""
    scene = OPEN.replace(TORQUE)
    chosen = choose_effects(scene, plan(scene).joints, 0.5, ("peak_torque_1",))
    note = build_model(chosen).effects[-1]
    assert note.title == "choice of effects"
    assert note.sentence.startswith("Effects chosen for 50 %: rigid links")
    assert "proximal_bending (1 mode" in note.sentence
    assert all(each.title != note.title for each in build_model(with_set(OPEN, {})).effects)
