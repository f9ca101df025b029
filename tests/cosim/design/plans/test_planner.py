"""A plan chooses the best motion within limits, says what it can't reach, and leaves a scene that runs to the same figures."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from hypothesis import assume, settings
from hypothesis import given as drawn
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans import assessment, planner
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge, own_candidate
from flexfmu.cosim.design.plans.goals import Variation, check_holding_torque, goals_of
from flexfmu.cosim.design.plans.plan_result import FRONT, PlanResult, plan_page, write_plan, write_scene
from flexfmu.cosim.design.plans.planner import about_plan, best, plan_scene, robustness
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.reference_design.joint_spline import fitted
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.piecewise import spline
from flexfmu.trajectories.table import read_table, write_table

pytestmark = pytest.mark.slow

FEW = {"effects.proximal_bending": 1, "effects.distal_axial": 1}
FREE = {"plan.limits.power": "free", "plan.limits.rms_torque": "free"}
SCENE = load_scene("barnard2012-6kg").replace(FEW | FREE)
GOALS = goals_of(SCENE)
STEEL = Path(__file__).parents[4] / "examples" / "steel.toml"
SPLINE = fitted(GOALS.given.joints, 28)


@pytest.mark.slow
def test_no_robot_within_the_bands_leaves_more_than_is_said() -> None:
    """Of 60 drawn ones, with a shaper whose residual vibration changes fast with payload, stiffness and damping."""
    bands = {"plan.stiffness_band": 0.05, "plan.damping_band": 0.3, "trajectory.duration": 0.25}
    goals, random = goals_of(load_scene(STEEL).replace(bands)), np.random.default_rng(1)
    judge, zv = Judge(goals, 25), {"kind": "zv", "apply": "joints"}
    said = judge.assess(candidate := Candidate("ZV", "csv", goals.scene.replace({"shaper": [zv]}))).residual
    low, high = zip(goals.band, (0.95, 1.05), (0.7, 1.3), strict=True)
    prepared = candidate.prepared()
    for each in random.uniform(low, high, (60, 3)).tolist():
        run = prepared.run(Variation(*each).changes(goals.scene))
        assert float(run.metrics["residual_vibration_amplitude"]) < 1.005 * said


def stretched(factor: float) -> Candidate:
    """The given motion as a spline of the joints, slower."""
    motion = SPLINE.with_duration(factor * SPLINE.duration).trajectory()
    return Candidate(f"stretched {factor:g}", "optimal control", GOALS.scene, motion)


def shaped(duration: float) -> Candidate:
    """A motion with wide corners and a shaper, which needs room."""
    keys = {
        "trajectory.blend.width": 0.1,
        "trajectory.duration": duration,
        "shaper": [{"kind": "zvd", "mode_count": 2}],
    }
    return Candidate("wide corners", "search", GOALS.scene.replace(keys))


@pytest.fixture(scope="module", autouse=True)
def _few_payloads() -> Iterator[None]:
    """The methods are the same with any number of payloads."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assessment, "JUDGED", 3)
        yield


@pytest.fixture(scope="module")
def result() -> PlanResult:
    """A plan that has three motions to choose from."""
    return plan_scene(SCENE, methods=(), candidates=[stretched(1.2), stretched(1.05), shaped(0.27)], robust=False)


def test_the_fastest_motion_within_all_limits_is_chosen(result: PlanResult) -> None:
    feasible = [each for each in result.assessed if each.feasible]
    assert len(feasible) >= 1
    assert result.chosen.feasible
    assert result.chosen.time == min(each.time for each in feasible)
    assert (result.metrics.torque, result.metrics.torque.unit) == (result.chosen.torque, "N.m")
    # a faster one is there, but comes into what is kept clear
    wide = next(each for each in result.assessed if each.candidate.label == "wide corners")
    assert wide.time < result.chosen.time
    assert [use.name for use in wide.uses if not use.met] == ["clearance"]


def test_no_motion_of_the_front_is_worse_in_everything_than_another(result: PlanResult) -> None:
    figures = [(*(getattr(each, name) for name in FRONT), not each.feasible) for each in result.front]
    for one in figures:
        assert not any(all(a <= b for a, b in zip(other, one, strict=True)) and other != one for other in figures)
    assert [each.time for each in result.front] == sorted(each.time for each in result.front)


def test_a_front_to_choose_from_keeps_all_limits(result: PlanResult) -> None:
    """Motions that miss some are there only where no motion keeps all."""
    wishes = result.goals.wishes.model_copy(update={"front": ("time", "power")})
    asked = replace(result, goals=replace(result.goals, wishes=wishes))
    wide = next(each for each in result.assessed if each.candidate.label == "wide corners")
    assert wide in result.front
    assert asked.chosen in asked.front
    assert all(each.feasible for each in asked.front if each is not asked.given)
    assert wide in replace(asked, chosen=wide, assessed=(wide,)).front


def test_an_assessment_has_the_metrics_of_the_run(result: PlanResult) -> None:
    for each in (result.given, result.chosen):
        changes = {"payload.mass": each.robots[-1].payload}
        precise = {"communication_step": assessment.STEP, "tolerance": assessment.TOLERANCE}
        run = flexfmu.run(GOALS.scene, trajectory=each.candidate.trajectory, parameters=changes, **precise)
        assert each.values["residual"][-1, 0] == pytest.approx(
            float(run.metrics["residual_vibration_amplitude"]), abs=1e-12
        )
        assert each.values["torque"][-1] == pytest.approx(
            [float(run.metrics[f"peak_torque_{joint}"]) for joint in (1, 2)], rel=1e-12
        )


def test_settling_leaves_time_for_the_vibration_to_fade() -> None:
    candidate = Candidate("given", "given", GOALS.scene)
    at_once, later = (
        Judge(goals_of(SCENE.replace({"plan.settled_within": wait})), 1).assess(candidate).residual
        for wait in (0.0, 0.1)
    )
    assert later < 0.5 * at_once


def test_files_say_the_same_and_the_planned_scene_runs_to_the_stated_figures(
    result: PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [path.name for path in write_plan(result, tmp_path / "there")]
    assert names == ["planned.toml", "planned.csv", "front.csv", "plan.json", "plan.html"]
    # from another folder
    monkeypatch.chdir(tmp_path)
    data = json.loads(Path("there/plan.json").read_text())
    assert data["chosen"]["time"] == result.chosen.time
    assert len(data["front"]) == len(Path("there/front.csv").read_text().splitlines()) - 1 == len(result.front)
    page = Path("there/plan.html").read_text()
    for heading in ("Planned motion", "Limits", "Pareto front", "Path of the end effector"):
        assert heading in page
    scene = flexfmu.load_scene("there/planned.toml")
    assert scene.trajectory.dwell == GOALS.scene.trajectory.dwell
    run = flexfmu.run(scene, communication_step=assessment.STEP, tolerance=assessment.TOLERANCE)
    nominal = next(k for k, each in enumerate(result.chosen.robots) if math.isclose(each.payload, 6.0))
    assert run.plan.duration == pytest.approx(result.chosen.time, abs=1e-15)
    assert float(run.metrics["residual_vibration_amplitude"]) == pytest.approx(
        result.chosen.values["residual"][nominal, 0], abs=1e-11
    )
    assert float(run.metrics["peak_torque_1"]) == pytest.approx(result.chosen.values["torque"][nominal, 0], rel=1e-9)


def test_a_shaped_motion_is_written_as_keys_of_the_scene(tmp_path: Path) -> None:
    wishes = SCENE.replace({"plan.keep_out": []})
    found = plan_scene(wishes, methods=(), candidates=[shaped(0.27)], robust=False)
    assert found.chosen.candidate.label == "wide corners"
    write_scene(found, tmp_path / "planned.toml")
    scene = load_scene(tmp_path / "planned.toml")
    assert flexfmu.reference_motion(scene).duration == 0.27
    assert flexfmu.run(scene).plan.duration == pytest.approx(found.chosen.time, rel=1e-12)


@settings(max_examples=200)
@drawn(
    st.lists(
        st.tuples(
            st.floats(0.1, 2.0),
            st.lists(st.floats(0.5, 3.0) | st.just(math.nan), min_size=3, max_size=3),
            st.booleans(),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_the_chosen_motion_misses_least_or_is_the_fastest_that_keeps_all(
    tried: list[tuple[float, list[float], bool]],
) -> None:
    """Whatever was found, in any order: no other one has a smaller worst share of a limit that it misses; one that was planned for few
    payloads is chosen only where no other keeps all."""
    limits = [Limit(name, most, "1") for name, most in (("torque", 2.0), ("power", 50.0), ("residual", 1e-6))]
    candidate = Candidate("drawn", "search", GOALS.scene)
    found = [
        Assessment(replace(candidate, is_rough=is_rough), (Variation(1.0),), {"time": np.array([[time]])}, {}, tuple(each.used(s * each.limit) for each, s in zip(limits, shares, strict=True)))
        for time, shares, is_rough in tried
    ]  # fmt: skip
    worst = [max(math.inf if math.isnan(each) else each for each in shares) for _, shares, _ in tried]
    chosen = found.index(best(found, "time"))
    kept = [k for k, share in enumerate(worst) if share <= 1.0]
    if kept:
        assert chosen in kept
        whole = [k for k in kept if not tried[k][2]]
        assert tried[chosen][0] == min(tried[k][0] for k in whole or kept)
    else:
        assert worst[chosen] == min(worst)


def test_what_no_motion_reaches_is_said() -> None:
    found = plan_scene(SCENE.replace({"plan.residual": 1e-12}), methods=(), candidates=[stretched(1.2)], robust=False)
    assert [use.name for use in found.missed] == ["residual"]
    left, misses = found.chosen.shown("residual"), "no motion found keeps all limits; the nearest misses residual"
    assert found.verdict.startswith(f"{misses} {left} µm instead of 1e-06 µm (")
    assert found.chosen.candidate.label == "stretched 1.2"
    # the page begins with it, then the time and what is limited, the worst over the band; in red what is missed
    page = plan_page(found)
    assert re.search(r'verdict">.*class="over">No motion found keeps all limits', page)
    tiles = re.findall(r'<div class="tile"><b>(.*)</b><span>(.*?)</span></div>', page)
    texts = [re.sub("<.*?>", "", values) for values, _ in tiles]
    assert (texts[0], tiles[0][1]) == (f"{found.given.time:.4g} s → {found.chosen.time:.4g} s", "Total time")
    assert texts[1] == f"{found.given.shown('residual')} µm → {left} µm"
    assert tiles[1][1] == "Residual vibration, limit 1e-06 µm"
    assert [label.partition(",")[0] for values, label in tiles if 'class="over"' in values] == ["Residual vibration"]
    assert page.count(' class="over">no</span>') == 1


def test_too_short_a_duration_is_said_with_what_tells_the_shortest() -> None:
    """Whether no motion was found, one that misses the time, or one that misses other limits within it."""
    scene = SCENE.replace({"plan.minimise": "energy", "plan.duration": 0.2})
    remedy = ': 0.2 s may be too short, `minimise = "time"` without `duration` tells the shortest'
    nothing, slow, fast = (
        plan_scene(scene, methods=(), candidates=each, robust=False)
        for each in ([], [stretched(0.9)], [stretched(0.2 / SPLINE.duration)])
    )
    assert nothing.verdict == f"no motion could be planned; this is the given one{remedy}"
    for each in (slow, fast):
        assert each.verdict.startswith("no motion found keeps all limits; the nearest misses ")
        assert each.verdict.endswith(remedy)


def test_what_the_loop_alone_leaves_too_much_is_said_with_what_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = Judge.assess

    def assess(self: Judge, candidate: Candidate) -> Assessment:
        found = usual(self, candidate)
        return replace(found, uses=(*found.uses, Limit("loop_residual", 1e-6, "m").used(1e-5, "loop")))

    monkeypatch.setattr(Judge, "assess", assess)
    monkeypatch.setattr(planner, "METHODS", {"optimal": lambda *_: iter([stretched(1.2)])})
    found = plan_scene(SCENE.replace({"plan.residual": 1e-3, "plan.keep_out": []}), robust=False)
    assert [use.figure for use in found.missed] == ["loop_residual"]
    assert found.verdict.endswith(": finer encoders, shorter sample times or other gains leave less in the loop")


def test_finer_runs_change_no_figure_of_a_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half the steps and less tolerance leave four digits, of the planned model and of all others."""
    candidate = stretched(0.9)
    plain = {line.model: [line.residual, line.torque_ratio] for line in robustness(candidate, goals_of(SCENE))}
    monkeypatch.setattr(Candidate.prepared, "__defaults__", (2e-4, 1e-9))
    monkeypatch.setattr(planner, "ACCURACY", (4e-4, 1e-8))
    monkeypatch.setattr(planner, "ELEMENT_STEP", 4e-4)
    for line in robustness(candidate, goals_of(SCENE)):
        if line.model not in planner.LOOPS:
            figures = [line.residual, line.torque_ratio]
            assert plain[line.model] == pytest.approx(figures, rel=5e-5, nan_ok=True), line.model


@pytest.mark.parametrize("seed", range(4))
def test_judged_figures_are_those_of_much_finer_runs(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of drawn robots, stiff and soft, slow and fast, with peaks of forces and stresses between recorded instants."""
    draw = np.random.default_rng(seed).uniform
    changes = {
        "mechanism.material.youngs_modulus": 10.0 ** draw(10.5, 11.6),
        "payload.mass": 10.0 ** draw(-1.3, 0.8),
        "trajectory.duration": draw(0.2, 0.5),
        "plan.limits": {"reaction": 1e5, "stress": 1e10},
    }
    goals = goals_of(flexfmu.load_scene("barnard2012-0.1kg").replace(changes))
    found = Judge(goals, 3).given
    monkeypatch.setattr(Candidate.prepared, "__defaults__", (5e-5, 1e-10))
    goals.judged.clear()
    fine = Judge(goals, 3).given
    for name, values in fine.values.items():
        rounding = {"reaction": 3e-4, "stress": 3e-4, "off_path": 1e-2, "clearance": 1e-2}.get(name, 2e-5)
        assert found.values[name] == pytest.approx(values, rel=rounding, abs=1e-9), name


def test_other_models_are_judged_over_the_dwell_of_the_scene_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model without changes misses the RMS torque as the planned one does; over the dwell of the judging runs it would be kept."""
    candidate, goals = (
        stretched(0.95),
        goals_of(SCENE.replace({"trajectory.dwell": 0.0, "plan.limits.rms_torque": {"ratio": 1.0}})),
    )
    candidate = replace(candidate, scene=goals.scene)

    def ratio(pause: float) -> float:
        uses = Judge(replace(goals, pause=pause), planner.PAYLOADS).assess(candidate).uses
        return next(use.value for use in uses if use.figure == "rms_torque")

    own, longer = ratio(0.0), ratio(goals.scene.trajectory.dwell)
    assert longer < 0.999 * own
    limit = {"rms_torque": replace(goals.limits["rms_torque"], limit=0.5 * (own + longer))}
    goals = replace(goals, limits={**goals.limits, **limit})
    monkeypatch.setattr(planner, "RICHER", {"the same": {}})
    monkeypatch.setattr(planner, "BANDS", {})
    monkeypatch.setattr(planner, "LOOPS", {})
    lines = {line.model: line.missed or () for line in robustness(candidate, goals)}
    assert "rms_torque ratio" in lines["planned model"]
    assert "rms_torque ratio" in lines["the same"]


def test_an_interrupted_plan_leaves_a_better_one_and_no_file_is_of_another(result: PlanResult, tmp_path: Path) -> None:
    """With the same scene and wishes; otherwise, or if it is better, it takes its place, and what isn't its own goes."""
    poor = replace(result, chosen=result.given, interrupted=True)
    names = ["front.csv", "plan.html", "plan.json", "planned.toml"]
    (tmp_path / "notes.toml").touch()
    for found, written in ((poor, names), (result, ["planned.csv", *names]), (poor, [])):
        before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert sorted(path.name for path in write_plan(found, tmp_path)) == sorted(written)
        there = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
        assert there == before if not written else sorted(there) == sorted(["notes.toml", *written])
    other = replace(GOALS, scene=GOALS.scene.replace({"plan.margin": 2e-3}))
    # of other wishes only one that keeps its limits takes the place of one that does
    assert not write_plan(replace(poor, goals=other), tmp_path)
    assert write_plan(replace(result, goals=other, interrupted=True), tmp_path)
    assert write_plan(replace(poor, interrupted=False), tmp_path)
    assert not (tmp_path / "planned.csv").exists()


def test_ctrl_c_gives_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    def search(*_: object) -> Iterator[Candidate]:
        yield stretched(1.3)
        raise KeyboardInterrupt

    monkeypatch.setattr(planner, "METHODS", {"search": search})
    found = plan_scene(SCENE, methods=("search",))
    assert found.interrupted
    assert found.chosen.candidate.label == "stretched 1.3"


def test_ctrl_c_within_a_run_ends_the_plan_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run ends early then, and isn't a motion that fails."""
    usual, runs = PreparedScene.run, list[int]()

    def run(self: PreparedScene, *arguments: Any) -> Run:
        runs.append(0)
        found = usual(self, *arguments)
        return replace(found, outcome=Outcome.INTERRUPTED) if len(runs) == 4 else found

    monkeypatch.setattr(PreparedScene, "run", run)
    found = plan_scene(SCENE, methods=(), candidates=[stretched(1.2), stretched(1.3)], robust=False)
    assert found.interrupted
    assert found.failures == found.assessed == ()
    assert found.verdict == "no motion was judged before the interruption; this is the given one"


def test_ctrl_c_within_optimal_control_judges_what_it_has() -> None:
    """The third improvement is where it ends, and it is judged beside the given motion."""
    told = list[str]()

    def show(text: str, _: float | None) -> None:
        told.append(text)
        if sum("over the bands" in each for each in told) == 3:
            raise KeyboardInterrupt

    found = plan_scene(SCENE, methods=("optimal",), robust=False, show=show)
    assert found.interrupted
    (label,) = (each.candidate.label for each in found.assessed)
    assert label.startswith("optimal control, ")
    assert label.endswith(", interrupted")
    assert found.assessed[0].time == pytest.approx(float(told[-1].split()[-2]), rel=1e-3)


def test_wishes_that_are_the_defaults_make_no_other_plan() -> None:
    """A plan goes on from one in which they weren't said."""
    assert about_plan(SCENE, ()) == about_plan(SCENE.replace({"plan.settled_within": 0.0}), ())
    scene = load_scene("barnard2012-6kg")
    assert about_plan(scene, ()) == about_plan(scene.replace({"plan.residual": 1e-6}), ())


def test_a_budget_ends_optimal_control_too() -> None:
    """It ends with the first improvement after that time, long before a motion is found."""
    told = list[str]()
    found = plan_scene(SCENE, methods=("optimal",), robust=False, budget=1e-3, show=lambda text, _: told.append(text))
    assert found.interrupted
    assert sum("over the bands" in each for each in told) == len(found.assessed) == 1


def test_a_motion_that_fails_does_not_end_the_plan() -> None:
    singular = Candidate("too low", "search", GOALS.scene.replace({"trajectory.height": 0.29}))
    found = plan_scene(SCENE, methods=(), candidates=[singular, stretched(1.2)], robust=False)
    assert [each.partition(": ")[0] for each in found.failures] == ["too low"]
    assert len(found.assessed) == 1


def test_the_front_door_takes_wishes_and_motions() -> None:
    motion = SPLINE.with_duration(0.5).trajectory()
    with pytest.raises(InputError, match="unknown method genetic; choose from search, flexible, optimal"):
        flexfmu.plan_motion(SCENE, methods=("genetic",))
    found = flexfmu.plan_motion(SCENE, methods=(), candidates={"mine": motion}, payload_band=[5.0, 7.0], robust=False)
    assert found.goals.band == (5.0, 7.0)
    assert found.chosen.candidate.label == "mine"
    assert np.isclose(found.chosen.time, 0.5)
    assert found.to_pandas()["motion"].tolist() == [row["motion"] for row in found.rows()]


def test_an_undeformed_start_is_planned_from_rest() -> None:
    """What the robot swings from there is no motion's: figures are those of a static start, and a note says so."""
    undeformed = SCENE.replace({"cosimulation.initial": "undeformed"})
    given, chosen = (
        plan_scene(each, methods=(), candidates=[Candidate("slower", "csv", each, stretched(1.2).trajectory)], robust=False)
        for each in (SCENE, undeformed)
    )  # fmt: skip
    assert chosen.chosen.candidate.label == given.chosen.candidate.label == "slower"
    assert [use.value for use in chosen.chosen.uses] == [use.value for use in given.chosen.uses]
    assert given.failures == ()
    (note,) = chosen.failures
    assert "planned from rest" in note
    # the planned scene runs to these figures
    run = flexfmu.run(chosen.scene, trajectory=stretched(1.2).trajectory, tolerance=1e-8)
    assert float(run.metrics["residual_vibration_amplitude"]) < 2.0 * chosen.chosen.residual
    # without gravity there is nothing to swing from
    weightless = undeformed.replace({"effects.gravity": [0.0, 0.0]})
    assert plan_scene(weightless, methods=(), robust=False).failures == ()


def test_a_band_without_the_own_payload_is_said() -> None:
    """The planned scene has that payload all the same."""
    (note,) = plan_scene(SCENE.replace({"plan.payload_band": [3.0, 5.0]}), methods=(), robust=False).failures
    assert note.startswith(
        "`plan.payload_band` = [3.0, 5.0] is without `payload.mass` = 6 kg, which the planned scene has"
    )
    assert plan_scene(SCENE.replace({"plan.payload_band": [5.0, 6.0]}), methods=(), robust=False).failures == ()


@pytest.mark.parametrize(("band", "heaviest"), [(0.3, 0.0), ([0.0, 1.0], 1.0)])
def test_an_empty_gripper_is_planned(band: float | list[float], heaviest: float) -> None:
    """Without a payload the FMU has no parameter for it; the planned scene carries none either."""
    scene = SCENE.replace({"payload.mass": 0.0, "plan.payload_band": band})
    found = plan_scene(scene, methods=(), candidates=[stretched(1.2)], robust=False)
    assert found.failures == ()
    assert max(each.payload for each in found.chosen.robots) == heaviest
    assert found.scene.payload.mass == 0.0
    run = flexfmu.run(scene, communication_step=assessment.STEP, tolerance=assessment.TOLERANCE)
    assert float(run.metrics["peak_torque_1"]) == pytest.approx(found.given.values["torque"][0, 0], rel=1e-6)


@cache
def _at_rest() -> tuple[Judge, float]:
    """The judge of the given motion, and the largest ratio of a torque at rest, before the motion or long after it, to its largest, by the FMU."""
    judge, shares = Judge(GOALS, 2), list[float]()
    scene = SCENE.replace({"trajectory.dwell": 1.5, "effects.damping": {"kind": "modal", "ratio": 0.3}})
    for variation, torques in zip(judge.robots, judge.given.values["torque"], strict=True):
        recording = flexfmu.run(scene.replace({"payload.mass": variation.payload}), tolerance=1e-8).recording
        for joint, largest in enumerate(torques, 1):
            torque = np.abs(recording[f"joint{joint}.torque"].values)
            shares += [float(torque[k]) / largest for k in (0, -1)]
    return judge, max(shares)


@settings(max_examples=12)
@drawn(st.floats(-0.2, 0.2))
def test_a_ratio_below_the_holding_torque_is_refused_at_once(shift: float) -> None:
    """Exactly those below what the FMU needs at rest, relative to the given motion's peak, for any payload and joint."""
    assume(abs(shift) >= 1e-4)
    judge, share = _at_rest()
    goals = goals_of(SCENE.replace({"plan.limits.torque": {"ratio": (1.0 + shift) * share}}))
    refused = pytest.raises(InputError, match="against gravity: allow more, or carry less")
    with refused if shift < 0.0 else nullcontext():
        check_holding_torque(goals, judge.robots, judge.given.values["torque"])


@settings(max_examples=8)
@drawn(st.floats(-0.15, 0.15), st.floats(-5.5, -3.0), st.booleans())
def test_a_thin_wall_across_the_path_is_not_kept(place: float, thickness: float, crossed: bool) -> None:
    """Whatever lies between two instants of a run: the end effector, 25 mm above its start, passes it or goes by."""
    low, high = (0.28, 0.31) if crossed else (0.20, 0.29)
    wall = {"kind": "box", "corners": [[place, low], [place + 10.0**thickness, high]]}
    found = Judge(goals_of(SCENE.replace({"plan.keep_out": [wall], "plan.payload_band": 0.0})), 1).given
    (use,) = (each for each in found.uses if each.name == "clearance")
    assert use.met is not crossed
    assert found.clearance < 0.0 if crossed else found.clearance == pytest.approx(0.005, rel=0.1)


def test_a_motion_from_a_file(tmp_path: Path) -> None:
    """It is judged as the same motion of a scene, without the scene's shapers, and stands in the table."""
    file = tmp_path / "mine.csv"
    write_table(file, flexfmu.reference_motion(SCENE.replace({"trajectory.duration": 0.5})).task)
    candidate = own_candidate(SCENE.replace({"shaper": [{"kind": "zv"}]}), file.name, read_table(file).trajectory())
    slow = Candidate("slower", "csv", GOALS.scene.replace({"trajectory.duration": 0.6}))
    wishes = SCENE.replace({"plan.residual": 1.0})
    planned = plan_scene(wishes, methods=(), candidates=[candidate, slow], robust=False)
    found = next(each for each in planned.assessed if each.candidate.label == "mine.csv")
    same = Judge(GOALS, 2).assess(Candidate("same", "search", SCENE.replace({"trajectory.duration": 0.5})))
    assert found.time == pytest.approx(0.5)
    assert found.residual == pytest.approx(same.residual, rel=1e-3)
    assert found.torque == pytest.approx(same.torque, rel=1e-4)
    assert [each.candidate.label for each in planned.table] == ["given", "mine.csv", "slower"]
    # in the planned scene it is a motion of the end effector
    chosen = PlanResult(planned.goals, planned.given, found, planned.assessed, (), False, 0.0)
    write_scene(chosen, tmp_path / "planned.toml")
    again = flexfmu.reference_motion(flexfmu.load_scene(tmp_path / "planned.toml")).task
    wanted = flexfmu.reference_motion(SCENE.replace({"trajectory.duration": 0.5})).task
    instants = np.linspace(0.0, 0.5, 50)
    np.testing.assert_allclose(again.evaluate(instants, 0), wanted.evaluate(instants, 0), atol=1e-7)


def test_wrong_place() -> None:
    """A motion that ends elsewhere is told, with both places."""
    positions = np.array([[-0.175, 0.320], [0.1, 0.32]])
    motion = spline([0.0, 0.2], np.stack([positions, 0.0 * positions, 0.0 * positions]))
    with pytest.raises(InputError, match=r"mine ends at \(0.1, 0.32\) m, .* at \(0.175, 0.32\) m"):
        own_candidate(SCENE, "mine", motion)


LOADS = ("torque", "power", "rms_torque", "energy", "supply_power", "regenerated_power")


def loads(candidate: Candidate) -> dict[str, np.ndarray]:
    """Loads of the motors from samples of a finer run, each motor's or of both."""
    run = flexfmu.run(GOALS.scene, trajectory=candidate.trajectory, communication_step=5e-5, tolerance=1e-9)
    time = run.recording.time
    torque = np.column_stack([run.recording[f"joint{joint}.torque"].values for joint in (1, 2)])
    power = torque * run.plan.joints.evaluate(np.clip(time, 0.0, run.plan.duration), 1, "left")[1]
    power[time > run.plan.duration] = 0.0
    figures = [abs(torque).max(axis=0), abs(power).max(axis=0)]
    figures += [
        np.sqrt(np.trapezoid(torque**2, time, axis=0) / time[-1]),
        np.trapezoid(np.maximum(power, 0.0), time, axis=0).sum(),
    ]
    figures += [power.sum(axis=1).max(), -power.sum(axis=1).min()]
    return dict(zip(LOADS, figures, strict=True))


@cache
def _finer() -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    return loads(Candidate("given", "given", GOALS.scene)), loads(stretched(0.95))


@settings(max_examples=4)
@drawn(st.lists(st.floats(0.9, 1.5), min_size=6, max_size=6), st.booleans())
def test_what_is_said_to_be_kept_is_kept(ratios: list[float], is_relative: bool) -> None:
    """For drawn limits of all loads, relative or in SI units, by sums and maxima over samples of a finer run, between the judge's instants."""
    usual, needed = _finer()
    limits = {
        name: {"ratio": ratio} if is_relative else ratio * float(usual[name].max())
        for name, ratio in zip(LOADS, ratios, strict=True)
    }
    judge = Judge(goals_of(SCENE.replace({"plan.payload_band": 0.0, "plan.limits": limits})), 1)
    found = {use.figure: use for use in judge.assess(stretched(0.95)).uses}
    for name, ratio in zip(LOADS, ratios, strict=True):
        most = ratio * (usual[name] if is_relative else usual[name].max())
        share = float((needed[name] / most).max())
        assert found[name].share == pytest.approx(share, rel=2e-4)
        assert found[name].met is (share <= 1.0) or abs(share - 1.0) < 2e-4


def test_a_table_for_a_drive_is_the_motion_to_an_independent_master(result: PlanResult, tmp_path: Path) -> None:
    """FMPy holds each line of the file for a sample: torques are the feedforward, and no more vibration remains than is stated."""
    file, rate, counts = tmp_path / "drive.csv", 4000.0, 2**20
    table = result.drive_table(rate, counts=counts)
    file.write_text(table.to_csv())
    assert file.read_text().splitlines()[0].split(",")[1:3] == ["joint1.position [count]", "joint2.position [count]"]
    rows = np.loadtxt(file, delimiter=",", skiprows=1)
    length = len(rows)
    assert length == math.ceil(result.chosen.time * rate - 1e-9) + 1
    assert (rows[:, 1:7] == np.rint(rows[:, 1:7])).all()
    degrees = result.drive_table(rate, "deg").values
    np.testing.assert_allclose(rows[:, 1:3] * 360.0 / counts, degrees[0], atol=0.501 * 360.0 / counts)
    still = np.repeat(rows[-1:], 400, axis=0)
    still[:, 0] += np.arange(1, 401) / rate
    rows = np.concatenate([rows, still])
    names = [f"joint{j}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for j in (1, 2)]
    inputs = np.array(
        [(row[0], *(row[1:7] * 2.0 * np.pi / counts)) for row in rows],
        dtype=[("time", float), *((name, float) for name in names)],
    )
    outputs = ["joint1.torque", "joint2.torque", "end_effector.position.x", "end_effector.position.y"]
    found = fmpy.simulate_fmu(
        str(build_scene(result.goals.scene).path), stop_time=float(rows[-1, 0]), output_interval=1.0 / rate, input=inputs,
        output=outputs, relative_tolerance=1e-8,
    )  # fmt: skip
    # outputs are those with the line before, which is held
    torques, places = (np.column_stack([found[name] for name in pair]) for pair in (outputs[:2], outputs[2:]))
    np.testing.assert_allclose(torques[1:length], table.torque[:-1], atol=2e-2 * abs(table.torque).max())
    vibration = float(np.hypot(*(places[length + 1 :] - places[-1]).T).max())
    assert vibration < table.use.value + 2e-7
