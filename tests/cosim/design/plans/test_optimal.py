"""Optimal control as a method of the planner, and plans that go on from their journal."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.control.blocks.code import CompiledAtPoints
from flexfmu.cosim.design.plans import assessment
from flexfmu.cosim.design.plans import optimal as method
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import LEAST_DWELL, Goals, goals_of
from flexfmu.cosim.design.plans.optimal import Improver, flexible, optimal
from flexfmu.cosim.design.plans.plan_result import PlanResult, planned_scenes, summary, write_plan
from flexfmu.cosim.design.plans.planner import plan_scene
from flexfmu.cosim.design.plans.sampled_loop import loop_run, with_learned_torques
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.many.journal import FILE, WorkJournal, about_scene
from flexfmu.model.reference_design.elastic_response import ElasticResponse, RobotVariant
from flexfmu.model.reference_design.joint_spline import JointSpline, fitted
from flexfmu.model.reference_design.optimal_control import GROUPS, Improvement, MotionProblem, ResidualVibration, bounds
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium
from flexfmu.trajectories.trajectory import Trajectory

SCENE = load_scene("barnard2012-6kg").replace(
    {
        "effects.proximal_bending": 1,
        "effects.distal_axial": 0,
        "plan.payload_band": 0.0,
        "plan.minimise": "rms_torque",
        "plan.duration": 0.33,
        "plan.limits.power": "free",
        "plan.limits.rms_torque": "free",
    }
)


def _silent(text: str, fraction: float | None) -> None:
    """Shows nothing."""


@pytest.fixture(scope="module")
def goals() -> Goals:
    return goals_of(SCENE)


@pytest.fixture(scope="module")
def judge(goals: Goals) -> Judge:
    return Judge(goals)


def test_a_motion_that_returns_is_an_error(goals: Goals, judge: Judge) -> None:
    """Its fastest way would be not to move."""
    returning = replace(goals)
    returning.__dict__["trace"] = np.concatenate([goals.trace, goals.trace[::-1]])
    with pytest.raises(InputError, match="ends where it starts"):
        next(optimal(Judge(returning), [judge.given], 1, _silent))


LIMITED = SCENE.replace(
    {
        "effects.damping.ratio": 0.01,
        "plan": {"limits": {"torque": {"ratio": 0.9}, "jerk": {"ratio": 0.8}, "off_path": 1e-4}},
    }
)


def on_the_path(scene: Scene, monkeypatch: pytest.MonkeyPatch, *, corrected: bool) -> Assessment:
    """The references on the given path, as the FMU finds them for other payloads than those of their correction."""
    if not corrected:
        monkeypatch.setattr(method.Improver, "best", lambda *_: None)
    judge = Judge(goals_of(scene), 9)
    (found,) = flexible(judge, [judge.given], 1, _silent)
    monkeypatch.undo()
    return judge.assess(found)


@pytest.mark.slow
def test_references_on_the_given_path_hold_for_the_band(monkeypatch: pytest.MonkeyPatch) -> None:
    """Payloads between those of the correction vibrate as little and stay as near to the path, with less torque, power and jerk than the given
    motion; references for one payload don't. They are at rest at both ends."""
    before, after = (on_the_path(LIMITED, monkeypatch, corrected=each) for each in (False, True))
    assert {use.figure for use in before.uses if not use.met} == {"residual", "torque", "jerk"}
    assert before.candidate.label.endswith("for the nominal payload")
    assert after.feasible, [use for use in after.uses if not use.met]
    assert after.time == pytest.approx(SCENE.trajectory.duration)
    assert after.residual < 4e-7
    assert after.worst("off_path") < 9.5e-5
    rates = after.candidate.joints.evaluate(np.linspace(0.0, after.time, 101), 3, "left")[1:]
    assert (np.abs(rates[:, [0, -1]]) < 1e-9 * np.abs(rates).max(axis=1, keepdims=True)).all()


@pytest.mark.slow
def test_robots_that_sag_off_the_path_stay_as_near_as_they_can(monkeypatch: pytest.MonkeyPatch) -> None:
    """Payloads that sag further than the margin: hardly further from the path than before, with a tenth of the vibration."""
    scene = LIMITED.replace({"plan": {"payload_band": 0.99}})
    before, after = (on_the_path(scene, monkeypatch, corrected=each) for each in (False, True))
    assert before.worst("off_path") > 1e-4
    assert after.worst("off_path") < 1.25 * before.worst("off_path")
    assert after.residual < 0.1 * before.residual


@pytest.fixture(scope="module")
def assessed(goals: Goals, judge: Judge) -> Assessment:
    """The motion of least torque in less time than the given one has."""
    *_, last = optimal(judge, [judge.given], 1, _silent)
    assert isinstance(last, Candidate)
    return judge.assess(last)


@pytest.mark.slow
def test_the_least_residual_vibration_is_far_below_its_limit() -> None:
    """A run with other steps confirms it."""
    found = plan_scene(SCENE.replace({"plan.minimise": "residual"}), methods=("optimal",), robust=False)
    assert found.chosen.feasible, found.verdict
    assert found.chosen.residual < 3e-8
    run = flexfmu.run(SCENE, trajectory=found.chosen.candidate.trajectory, communication_step=1e-3, tolerance=1e-9)
    assert float(run.metrics.residual_vibration_amplitude) == pytest.approx(found.chosen.residual, rel=1e-3)


@pytest.mark.slow
def test_the_least_torque_in_a_shorter_time_leaves_no_vibration(assessed: Assessment, judge: Judge) -> None:
    """Judged by the FMU: a fifth faster, less vibration by an order, peaks within those of the given motion."""
    assert assessed.time == pytest.approx(0.33)
    assert assessed.residual < 1e-6 < judge.given.residual
    assert assessed.torque_ratio < 1.0
    assert assessed.feasible, [use for use in assessed.uses if not use.met]


@pytest.mark.slow
@pytest.mark.parametrize("limits", [{"torque": {"ratio": 0.7}}, {"reaction": {"ratio": 0.8}}])
def test_what_the_fmu_finds_beyond_a_limit_is_taken_off_it(
    limits: dict[str, dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Optimal control whose model finds torques or forces a fifth too small still ends within the limits."""
    wishes = {
        "plan.minimise": "time",
        "plan.duration": None,
        "plan.payload_band": 0.3,
        "plan.residual": 1e-3,
        # the motion on the given path, with few intervals, cuts a corner by 0.04 mm
        "plan.margin": 3e-4,
        "plan.limits": limits,
    }
    goals = goals_of(SCENE.replace(wishes))
    robots = [RobotVariant(goals.scene, each.changes(goals.scene)) for each in goals.variations(3)]

    def optimistic(problem: MotionProblem, *_: object, **__: object) -> Iterator[Improvement]:
        start, limits = problem.ways[0].start, problem.limits
        forces = {name: each[:3] for name, each in limits.items() if name == "reaction"}
        response = ElasticResponse(robots, start.coefficients[0], 60, loads=(*forces,))
        for duration in np.arange(0.3, 1.2, 0.03):
            found = response.of_motion(motion := start.with_duration(float(duration)), derivatives=False)
            is_met = (np.abs(found.torque).max(axis=1) < 1.2 * limits["torque"][:3]).all()
            if is_met and all((found.loads.max(axis=(1, 2)) < 1.2 * each).all() for each in forces.values()):
                yield (motion,), dict.fromkeys(GROUPS, 0.0)
                return

    monkeypatch.setattr(method.optimal_control, "optimal_motion", optimistic)
    monkeypatch.setattr(method, "PAYLOADS", (3, 1))
    judge = Judge(goals, 3)
    found = [judge.assess(each) for each in optimal(judge, [judge.given], 1, _silent)]
    assert not found[0].feasible
    assert found[-1].feasible
    assert found[0].time < found[-1].time


@pytest.mark.slow
@settings(max_examples=6)
@drawn(st.floats(0.02, 0.3), st.floats(0.0, 8.0), st.floats(0.13, 0.35), st.booleans())
def test_what_settles_is_bounded_as_the_fmu_settles(ratio: float, mass: float, time: float, is_modal: bool) -> None:
    """From no, little and much time after drawn motions on, the bound by modal decay is at most half above what the FMU swings."""
    damping = {"kind": "modal", "ratio": ratio} if is_modal else {"kind": "stiffness", "time": 1e-3 * ratio}
    keys = {"effects.damping": damping, "payload.mass": mass, "trajectory.duration": time, "trajectory.dwell": 0.6}
    scene = load_scene("barnard2012-6kg").replace({**keys, "effects.proximal_bending": 2, "effects.distal_axial": 1})
    spline = fitted(flexfmu.reference_motion(scene).joints, 20)
    response = ElasticResponse([RobotVariant(scene, {}, CompiledAtPoints)], spline.coefficients[0], 400)
    state, last = response.of_motion(spline, derivatives=False).end, spline.coefficients[-1]
    run = flexfmu.run(scene, trajectory=spline.trajectory(), tolerance=1e-9)
    points = np.column_stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"])
    away = np.hypot(*(points - static_equilibrium(scene, last).position).T)
    for wait in (0.0, 0.03, 0.1, 0.2):
        swing = float(away[run.recording.time >= time + wait].max())
        vibration = ResidualVibration(response.models, last, wait)
        bound = float(bounds(vibration.matrices, vibration.away(state))[0])
        assert 0.99 * swing - 1e-8 < bound < 2.0 * swing + 1e-8


@pytest.mark.parametrize("dwell", [0.0, 0.1, 0.4])
def test_rms_torques_are_those_over_the_dwell_of_the_scene(dwell: float) -> None:
    """Motions are judged over a longer dwell, in which the vibration is seen, and the motors rest."""
    scene = SCENE.replace({"trajectory.dwell": dwell, "plan.payload_band": 0.0, "plan.limits.rms_torque": None})
    goals = goals_of(scene)
    assert goals.scene.trajectory.dwell == max(dwell, LEAST_DWELL)
    metrics = flexfmu.run(scene.replace({"plan": None, "cosimulation.initial": "static"})).metrics
    expected = [float(metrics[f"rms_torque_{joint}"]) for joint in (1, 2)]
    assert Judge(goals).given.values["rms_torque"][0] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("dwell", [0.25, 1.5])
def test_rms_torques_of_the_given_motion_have_its_swing_as_in_the_fmu(dwell: float) -> None:
    """Without damping the torques of the pause are up to a tenth of them; after a long pause the robot is taken to rest."""
    damping = {"kind": "modal", "ratio": 0.1} if dwell > 1.0 else {"kind": "none"}
    goals = goals_of(
        SCENE.replace(
            {"effects.damping": damping, "trajectory.dwell": dwell, "payload.mass": 4.2, "plan.limits.rms_torque": None}
        )
    )
    (usual,) = Judge(goals).given.values["rms_torque"]
    robots = [RobotVariant(goals.scene, each.changes(goals.scene), CompiledAtPoints) for each in goals.variations(1)]
    squares = method._given_needs(goals, robots, ["rms_torque"])["rms_torque"][0]
    found = np.sqrt(squares / (goals.given.once.duration + dwell))
    assert found == pytest.approx(usual, rel=3e-3)


@pytest.mark.parametrize(
    ("shares", "count"),
    [
        ((10.86, 10.5, 10.51, 10.49), 2),  # what a loop leaves by itself
        ((9.0, 6.0, 5.0, 4.8, 4.0), 4),
        ((1.3, 1.09, 1.085, 0.99), 4),
        ((1.3, 1.09, 1.085, 1.08, 1.07), 5),
    ],
)
def test_limits_are_tightened_as_long_as_that_helps(goals: Goals, shares: tuple[float, ...], count: int) -> None:
    """Each correction lowers what is missed by a tenth, or it is nearly kept; motions of the same start have names of their own."""
    candidates, problem = iter(shares), MagicMock()
    problem.tightened.return_value.begun.return_value = problem
    limit = replace(goals.limits["residual"], figure="loop_residual")

    def assess(candidate: Candidate) -> Assessment:
        kept = goals.limits["residual"].used(0.95 * limit.limit)
        used = limit.used(next(candidates) * limit.limit)
        return Assessment(candidate, (), {}, {}, (kept, used))

    judge: Any = SimpleNamespace(goals=goals, assess=assess)
    improver = Improver[JointSpline](judge, lambda _: Candidate("made", "csv", goals.scene), (), "time", _silent)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Improver, "best", lambda *_: ([], True))
        tried = [each for each in improver.refined(("drawn",), problem) if isinstance(each, Candidate)]
    assert [each.label for each in tried] == ["made", *(f"made, try {k}" for k in range(2, count + 1))]


@pytest.mark.slow
def test_attempts_that_miss_by_far_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """One from each start, judged with what it misses, the least of which is the result; where nothing can be planned it is said."""

    def far_off(problem: MotionProblem, *_: object, **__: object) -> Iterator[Improvement]:
        start = problem.ways[0].start
        assert isinstance(start, JointSpline)
        if start.duration < 0.25:
            raise EquilibriumError("too fast")
        yield (start,), dict.fromkeys(GROUPS, 1.0)

    monkeypatch.setattr(method.optimal_control, "optimal_motion", far_off)
    monkeypatch.setattr(method, "STARTS", (0.65, 0.5, 0.8))
    result = plan_scene(
        SCENE.replace({"plan.minimise": "time", "plan.duration": None}), methods=["optimal"], robust=False
    )
    assert len(result.assessed) == 2
    assert all(each.excess > 1.0 for each in result.assessed)
    assert result.chosen.excess == min(each.excess for each in (result.given, *result.assessed))
    assert result.failures == ("optimal from 0.5, few payloads: no motion can be planned",)


CYCLE = SCENE.replace(
    {"plan.minimise": "time", "plan.duration": None, "plan.limits": {}, "plan.cycle": {"pause": 0.05}}
)


@pytest.mark.slow
def test_what_a_way_leaves_swings_on_in_the_next_as_in_the_fmu() -> None:
    """The bound holds for the last of three cycles, which the FMU runs in one go, and isn't that of ways from rest."""
    little = {"effects.damping": {"kind": "modal", "ratio": 0.02}, "trajectory.dwell": 0.3}
    scene = CYCLE.replace(little | {"plan.cycle": {"return_payload": 6.0, "pause": 0.05}})
    judge = Judge(goals_of(scene), 1)
    found, alone = judge.given, judge.of_ways(judge.given.candidate)
    cycles = {"trajectory.way_back": "same-path", "trajectory.cycles": 3, "trajectory.pause": 0.05}
    run = flexfmu.run(scene.replace(cycles | {"plan.cycle": None}), tolerance=1e-8)
    time, recording = run.recording.time, run.recording
    points = np.column_stack([recording[f"end_effector.position.{axis}"].values for axis in "xy"])
    end = judge.goals.given.once.joints.evaluate([0.43], 0, "left")[0, 0]
    swings = []
    for k, rest in ((4, static_equilibrium(scene, end).position), (5, points[0])):
        resting = (time >= 0.48 * k + 0.43) & (time <= 0.48 * (k + 1))
        swings.append(np.hypot(*(points[resting] - rest).T).max())
    assert max(each.residual for each in alone) < max(swings) < found.residual < 1.5 * max(swings)


@pytest.mark.slow
def test_both_ways_of_a_cycle_keep_its_limits_in_the_fmu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty return: RMS torques over the cycle and its pauses are those of the given one, both ways run from their files, and a drive reads both."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    result = plan_scene(CYCLE)
    assert not result.missed
    assert result.chosen.time < 0.85 * result.given.time
    write_plan(result, tmp_path)
    # what is limited for the cycle alone isn't limited for its ways
    for pair in summary(result)["ways"]:
        assert {each["name"] for each in pair[1]["limits"]} == {"residual", "clearance"}
    squares, time = np.zeros((2, 2)), np.zeros(2)
    for way, pair in enumerate(result.ways):
        for k, each in enumerate(pair):
            scene = load_scene(tmp_path / f"planned-{way + 1}.toml") if k else each.candidate.scene
            run = flexfmu.run(scene, **({} if k else {"trajectory": each.candidate.trajectory}), tolerance=1e-8)
            assert scene.payload.mass == 6.0 * (1 - way)
            assert float(run.metrics["residual_vibration_amplitude"]) == pytest.approx(
                each.residual, rel=1e-3, abs=1e-10
            )
            holding = np.array([run.recording[f"joint{joint}.torque"].values[-1] for joint in (1, 2)])
            rms = np.array([float(run.metrics[f"rms_torque_{joint}"]) for joint in (1, 2)])
            length, dwell = each.time, scene.trajectory.dwell
            squares[k] += rms**2 * (length + dwell) + holding**2 * (0.05 - dwell)
            time[k] += length + 0.05
    found = np.sqrt(squares / time[:, np.newaxis])
    # less what swings on after the pause
    assert found[1] == pytest.approx(result.chosen.values["rms_torque"][0], rel=5e-4)
    assert (found[1] < 1.0005 * found[0]).all()
    assert time == pytest.approx([result.given.time, result.chosen.time])
    table = result.drive_table(4000.0)
    assert 4000.0 * result.chosen.time - 1.0 < len(table.torque) < 4000.0 * result.chosen.time + 2.0
    assert np.abs(np.diff(table.values[0], axis=0)).max() < 1e-3 * np.ptp(table.values[0]) + 0.01
    assert table.values[0, -1] == pytest.approx(table.values[0, 0], abs=1e-9)
    # counts hardly matter, and what a way leaves in the next is calculated from all of their jumps
    assert result.drive_table(4000.0, counts=2**23).use.value < 1.2 * table.use.value


@pytest.mark.slow
def test_a_plan_goes_on_from_an_earlier_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Start, end and payload have moved: with half of the programmes, a motion within limits that takes as long as one planned anew."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    counts, usual = list[int](), method.optimal_control.optimal_motion

    def counted(*arguments: Any, **options: Any) -> Iterator[Improvement]:
        for each in usual(*arguments, **options):
            counts[-1] += 1
            yield each

    monkeypatch.setattr(method.optimal_control, "optimal_motion", counted)
    scene = CYCLE.replace({"plan.cycle": None, "plan.payload_band": 0.1})
    moved = scene.replace({"trajectory.start": [-0.185, 0.325], "payload.mass": 5.5})
    found = list[PlanResult]()
    for robot, before in ((scene, False), (moved, False), (moved, True)):
        counts.append(0)
        earlier = planned_scenes(tmp_path) if before else ()
        found.append(plan_scene(robot, methods=["optimal"], robust=False, before=earlier))
        if len(found) == 1:
            write_plan(found[0], tmp_path)
    assert not found[2].missed
    assert found[2].chosen.time == pytest.approx(found[1].chosen.time, rel=0.02)
    assert counts[2] < 0.5 * counts[1]
    with pytest.raises(InputError, match=r"has no planned.toml of an earlier plan"):
        planned_scenes(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="goes 1 way, this one 2 ways"):
        plan_scene(CYCLE, before=planned_scenes(tmp_path))


@pytest.mark.slow
def test_a_plan_keeps_links_clear_of_a_box(monkeypatch: pytest.MonkeyPatch) -> None:
    """The given motion's link dips into it by 4 mm; the planned one passes, at each joint angle of its run, by a scan along the link."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    box = {"kind": "box", "corners": [[-0.36, -0.2], [-0.30, -0.05]], "links": True}
    wishes = {
        "plan.cycle": None,
        "plan.keep_out": [box, {"kind": "above", "height": 0.305, "half_width": 0.1}],
        "plan.limits": {"rms_torque": "free", "power": "free"},
    }
    result = plan_scene(CYCLE.replace(wishes), methods=["optimal"], robust=False)
    assert not result.missed
    depths = list[float]()
    for each in (result.given, result.chosen):
        joints = each.candidate.joints
        angle = joints.evaluate(np.linspace(0.0, joints.duration, 4001), 0, "left")[0, :, 0]
        share = np.linspace(0.0, 0.24, 2001)[:, np.newaxis]
        x, y = -0.1 + share * np.cos(angle), share * np.sin(angle)
        distance = np.hypot(np.maximum(np.maximum(-0.36 - x, x + 0.30), 0.0), np.maximum(y + 0.05, 0.0)).min()
        depths.append(0.0175 - float(distance))
    assert depths[0] > 3e-3
    # links bend by little
    assert depths[1] < result.goals.wishes.margin + 2e-4


def needs_of_cycle(ways: Sequence[tuple[Scene, Trajectory]], share: float) -> dict[str, Any]:
    """What a cycle with this share of its payloads needs, by sums over the samples of fine runs, ways from rest: each joint's or of all."""
    squares, energy, time, residual = np.zeros(2), 0.0, 0.0, 0.0
    power, torque = np.zeros(2), np.zeros(2)
    for (scene, motion), pause in zip(ways, (0.1, 0.2, 0.1), strict=True):
        payload = {"payload.mass": share * scene.payload.mass}
        run = flexfmu.run(scene.replace(payload), trajectory=motion, communication_step=5e-5, tolerance=1e-8)
        moving = run.recording.time <= motion.duration + 1e-12
        instants = run.recording.time[moving]
        torques, points = (
            np.column_stack([run.recording[name].values for name in names])
            for names in (("joint1.torque", "joint2.torque"), ("end_effector.position.x", "end_effector.position.y"))
        )
        flow = torques[moving] * motion.evaluate(np.minimum(instants, motion.duration), 1, "left")[1]
        counted = run.recording.time <= motion.duration + pause + 1e-12
        squares += np.trapezoid(torques[counted] ** 2, run.recording.time[counted], axis=0)
        energy += float(np.trapezoid(np.maximum(flow, 0.0), instants, axis=0).sum())
        power, torque = np.maximum(power, abs(flow).max(axis=0)), np.maximum(torque, abs(torques[moving]).max(axis=0))
        time += motion.duration + pause
        rest = static_equilibrium(scene.replace(payload), motion.evaluate([motion.duration], 0, "left")[0, 0])
        residual = max(residual, float(np.hypot(*(points[~moving] - rest.position).T).max()))
    return {
        "rms_torque": np.sqrt(squares / time),
        "power": power,
        "torque": torque,
        "energy": energy,
        "time": time,
        "residual": residual,
    }


@pytest.mark.slow
def test_a_cycle_of_three_ways_needs_what_independent_runs_need(monkeypatch: pytest.MonkeyPatch) -> None:
    """Other payloads on each way: for all payloads of the band, loads by sums over the samples of fine runs are those that are stated, within the limits."""
    monkeypatch.setattr(method, "INTERVALS", 28)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    monkeypatch.setattr(method, "PAYLOADS", (3, 1))
    monkeypatch.setattr(assessment, "JUDGED", 3)
    targets = [{"position": [0.05, 0.36], "payload": 3.0, "pause": 0.2}]
    cycle = {
        "plan.cycle": {"pause": 0.1, "targets": targets},
        "plan.payload_band": 0.1,
        "plan.limits.energy": {"ratio": 1.05},
    }
    result = plan_scene(CYCLE.replace(cycle))
    assert not result.missed
    assert result.chosen.time < 0.9 * result.given.time
    found = list[list[dict[str, Any]]]()
    for assessed in (result.given, result.chosen):
        ways = [(each.scene, each.joints) for each in assessed.candidate.ways]
        assert [scene.payload.mass for scene, _ in ways] == [6.0, 3.0, 0.0]
        found.append([needs_of_cycle(ways, share) for share in (0.9, 1.0, 1.1)])
        for k, needs in enumerate(found[-1]):
            for name in ("rms_torque", "power", "torque", "energy"):
                assert assessed.values[name][k] == pytest.approx(np.atleast_1d(needs[name]), rel=1e-3), name
            # what the way before leaves may add to it
            assert needs["residual"] < assessed.values["residual"][k, 0] + 1e-9
            assert needs["time"] == pytest.approx(assessed.time)
    for name, most in (("rms_torque", 1.0), ("power", 1.0), ("torque", 1.0), ("energy", 1.05)):
        ratio = max(np.max(each[name] / usual[name]) for usual, each in zip(*found, strict=True))
        assert ratio < most + 1e-3
        (use,) = (use for use in result.chosen.uses if use.figure == name)
        assert use.value == pytest.approx(ratio, rel=2e-3)
    assert max(each["residual"] for each in found[1]) < 1e-6


@pytest.mark.slow
def test_a_cycle_keeps_the_motors_and_the_joints_to_what_they_can(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torque at its speed, RMS torque over the cycle and forces in the joints, of the FMU's runs; one of them binds."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    motor = {
        "continuous_torque": 1.3, "peak_torque": 3.5, "maximum_speed": 600.0, "gear_ratio": 25.0, "rotor_inertia": 4e-5,
        "torque_speed_curve": [[0.0, 3.5], [100.0, 3.5], [600.0, 1.5]], "thermal_time_constant": 5.0,
    }  # fmt: skip
    result = plan_scene(CYCLE.replace({"motor": motor, "plan.limits.reaction": 500.0}))
    assert not result.missed
    squares, used = np.zeros(2), list[float]()
    for _, each in result.ways:
        assert each.candidate.trajectory is not None
        run = flexfmu.run(each.candidate.scene, trajectory=each.candidate.trajectory, tolerance=1e-8)
        forces = [
            np.hypot(*(run.recording[f"{name}.reaction.{axis}"].values for axis in "xy"))
            for name in ("elbow1", "elbow2", "leg1", "leg2")
        ]
        used.append(max(float(force.max()) for force in forces) / 500.0)
        for k, load in enumerate(flexfmu.motor_loads(run)):
            use = {margin.name: margin.use for margin in load.margins}
            used += [use["peak torque"], use["torque at speed"], use["speed"]]
            # torques of the shaft over motion and pause
            time = run.recording.time[run.recording.time <= each.time + 0.05]
            turning = each.candidate.joints.evaluate(np.minimum(time, each.time), 2, "left")[2, :, k] * (
                time <= each.time
            )
            torque = run.recording[f"joint{k + 1}.torque"].values[: len(time)]
            squares[k] += np.trapezoid(np.square((torque / 25.0 + 25.0 * 4e-5 * turning) / 1.3), time)
    period = result.chosen.time
    used += np.sqrt(squares / period * (period / 5.0) / -np.expm1(-period / 5.0)).tolist()
    assert 0.98 < max(used) < 1.0001
    limits = {use.figure: use.value for use in result.chosen.uses}
    assert max(limits["motor_torque"], limits["motor_rms_torque"], limits["reaction"] / 500.0) == pytest.approx(
        max(used), rel=1e-4
    )


@pytest.mark.slow
def test_the_loop_is_in_the_plan_and_in_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop at 1 kHz with encoders leaves no more than promised; the written scene has it and its torques, which are learned where velocities lag."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    loop = {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "controller": [{"kind": "pid", "proportional": 1e4, "integral": 0.0, "derivative": 100.0, "sample_time": 1e-3}],
        "imperfection": [{"kind": "encoder", "counts_per_turn": 1e6}],
    }
    result = plan_scene(
        CYCLE.replace({**loop, "plan.cycle": None, "plan.residual": 2e-6}), methods=["optimal"], robust=False
    )
    assert not result.missed
    assert result.chosen.time < result.given.time
    (use,) = (use for use in result.chosen.uses if use.figure == "loop_residual")
    write_plan(result, tmp_path)
    run = flexfmu.run(tmp_path / "planned.toml")
    assert [each.kind for each in run.scene.controller] == ["pid", "feedforward"]
    assert float(run.metrics["residual_vibration_amplitude"]) == pytest.approx(use.value, rel=0.02)
    lagging = {**result.scene.model_dump(exclude_none=True)["controller"][0], "kind": "pd"}
    lagging = {key: lagging[key] for key in ("kind", "proportional", "derivative", "sample_time")}
    scene = result.goals.scene.replace(
        {**loop, "controller": [lagging, {"kind": "feedforward", "robot": "flexible", "sample_time": 1e-3}]}
    )
    joints = result.chosen.candidate.joints
    pair = (loop_run(each, joints) for each in (scene, with_learned_torques(scene, joints)))
    before, after = (float(each.metrics["residual_vibration_amplitude"]) for each in pair)
    assert after < 0.2 * before
    with pytest.raises(InputError, match="follow exactly"):
        goals_of(CYCLE.replace(loop))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_torques_that_loops_learn_leave_less_vibration(seed: int) -> None:
    """For drawn gains of PD controllers, whose velocities lag, and of PID ones, which follow: runs with encoders leave nearly what motors that follow exactly do."""
    random, sample_time = np.random.default_rng(seed), (5e-4, 1e-3)[seed // 2]
    stiffness = 10.0 ** random.uniform(3.8, 4.3)
    gains: dict[str, Any] = {
        "kind": "pd",
        "proportional": stiffness,
        "derivative": stiffness * random.uniform(0.008, 0.01),
    }
    gains |= {"kind": "pid", "integral": stiffness * random.uniform(0.0, 3.0)} if seed % 2 else {}
    feedforward = {"kind": "feedforward", "robot": "flexible", "sample_time": sample_time}
    exact = SCENE.replace({"plan": None, "effects.motor_inertia": 0.1, "trajectory.dwell": 0.25})
    scene = exact.replace(
        {
            "cosimulation.drive": "torque",
            "controller": [{**gains, "sample_time": sample_time}, feedforward],
            "imperfection": [{"kind": "encoder", "counts_per_turn": 1e6}],
        }
    )
    joints = fitted(flexfmu.reference_motion(SCENE).joints, 24).with_duration(0.33).trajectory()
    promised, before, after = (
        float(flexfmu.run(each, trajectory=joints).metrics["residual_vibration_amplitude"])
        for each in (exact, scene, with_learned_torques(scene, joints))
    )
    assert abs(before - promised) > 1e-6 or gains["kind"] == "pid"
    assert abs(after - promised) < 0.25 * abs(before - promised) + 4e-7


@pytest.mark.slow
def test_a_front_beats_the_fastest_motion_slowed_down(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """For each level of power, judged by the FMU, a motion that keeps to it is faster than the fastest one, slowed down until it does."""
    monkeypatch.setattr(method, "INTERVALS", 20)
    monkeypatch.setattr(method, "fuller_scene", lambda scene: None)
    monkeypatch.setattr(method, "LEVELS", (3, 2))
    monkeypatch.setattr(method, "STARTS", (0.5,))
    wishes = {
        "plan.cycle": None,
        "plan.keep_out": [],
        "plan.limits.rms_torque": "free",
        "plan.front": ["power", "time"],
    }
    result = plan_scene(CYCLE.replace(wishes), methods=["optimal"], robust=False)
    assert result.axes == ("time", "power")
    write_plan(result, tmp_path)
    for number, row in enumerate(result.rows(), 1):
        planned = load_scene(tmp_path / f"front-{number}.toml")
        assert flexfmu.reference_motion(planned).duration == pytest.approx(row["time"], rel=1e-6)
    points = [
        each
        for each in result.assessed
        if each.candidate.label.startswith("front") and all(use.met for use in each.uses if use.figure != "power")
    ]
    assert len(points) >= 2
    assert points[0].candidate.trajectory is not None
    first, judge = fitted(points[0].candidate.trajectory, 20), Judge(result.goals, 7)
    for each in points[1:]:
        slower = first.with_duration(each.time).trajectory()
        assert each.power < 0.97 * judge.assess(Candidate("slowed", "csv", result.goals.scene, slower)).power
    with pytest.raises(SceneError, match="needs what is minimised"):
        CYCLE.replace({"plan.front": ["power", "jerk"]})


@pytest.mark.slow
def test_a_wall_on_the_path_is_passed_by() -> None:
    """Over its top, faster than the given motion, which goes through it."""
    wall = {"kind": "box", "corners": [[-0.015, 0.20], [0.015, 0.33]]}
    scene = load_scene("barnard2012-6kg").replace({"plan.keep_out": [wall], "plan.payload_band": 0.0})
    found = plan_scene(scene, methods=["optimal"], robust=False)
    assert not found.given.feasible
    assert found.chosen.feasible
    assert found.chosen.time < found.given.time


def test_a_cycle_goes_to_its_targets_and_back() -> None:
    """Paths to the left are those to the right, reversed; a cycle that stays somewhere is refused."""
    targets = [{"position": [0.05, 0.35], "payload": 3.0, "pause": 0.2}]
    goals = goals_of(CYCLE.replace({"plan.cycle.targets": targets}))
    ends = [(way.trace[0], way.trace[-1]) for way in goals.ways]
    assert np.allclose(
        ends,
        [((-0.175, 0.32), (0.175, 0.32)), ((0.175, 0.32), (0.05, 0.35)), ((0.05, 0.35), (-0.175, 0.32))],
        atol=1e-6,
    )
    assert [(way.scene.payload.mass, way.pause) for way in goals.ways] == [(6.0, 0.05), (3.0, 0.2), (0.0, 0.05)]
    with pytest.raises(InputError, match="stays at"):
        goals_of(CYCLE.replace({"plan.cycle.targets": [{"position": [-0.175, 0.32], "payload": 0.0}]}))


def test_planned_scenes_carry_what_the_ways_do() -> None:
    """Nothing too, where the models have the heaviest payload of the band."""
    loads = {"payload.mass": 0.0, "plan.payload_band": [0.0, 1.0], "plan.cycle.return_payload": 2.0}
    goals = goals_of(CYCLE.replace(loads))
    candidate = Candidate.of(goals, "given", "given", [way.own for way in goals.ways])
    found = Assessment(candidate, goals.variations(1), {}, {})
    result = PlanResult(goals, found, found, (), (), False, 0.0)
    assert [way.scene.payload.mass for way in goals.ways] == [1.0, 2.0]
    assert [scene.payload.mass for scene in result.scenes] == [0.0, 2.0]


SHORT = load_scene("barnard2012-6kg").replace(
    {"trajectory.dwell": 0.01, "plan.payload_band": 0.0, "cosimulation.tolerance": 1e-4}
)
SLOWER = [
    Candidate(f"{share:g} of the time", "search", SHORT.replace({"trajectory.duration": share * 0.43}))
    for share in (1.1, 1.2, 1.3)
]


def planned(journal: WorkJournal) -> PlanResult:
    """The plan of a few given motions."""
    return plan_scene(SHORT, methods=(), candidates=SLOWER, robust=False, journal=journal)


def figures(found: PlanResult) -> list[Any]:
    """All that was assessed, and what was chosen."""
    return [
        (each.candidate.label, {name: rows.tolist() for name, rows in each.values.items()}, each.uses)
        for each in (*found.assessed, found.chosen)
    ]


@pytest.mark.parametrize("after", [2])
def test_finished_units_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """What an error interrupts after some units has these in its folder; the next call makes the others alone."""
    made, left, usual = list[str](), [after], Judge._judged

    def counted(judge: Judge, candidate: Candidate, **options: Any) -> Any:
        if not left[0]:
            raise MemoryError
        left[0] -= 1
        made.append(f"{candidate.label}, {len(judge.robots)}")
        return usual(judge, candidate, **options)

    monkeypatch.setattr(Judge, "_judged", counted)
    with pytest.raises(MemoryError):
        planned(WorkJournal(tmp_path, "plan", about_scene(SHORT)))
    said, left[0] = list[str](), 100
    found = planned(WorkJournal(tmp_path, "plan", about_scene(SHORT), note=said.append))
    assert said == [f"continuing: {after} done"]
    assert not {*made[:after]} & {*made[after:]}
    assert figures(found) == figures(planned(WorkJournal()))
    with pytest.raises(InputError, match=r"has another plan: scene.payload.mass was 6.*--restart"):
        WorkJournal(tmp_path, "plan", about_scene(SHORT.replace({"payload.mass": 3.0})))


def test_a_full_disk_ends_a_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is no candidate's fault; the same call goes on once there is room."""
    left, usual = [2], os.fsync
    motions = {"slower": flexfmu.reference_motion(SLOWER[0].scene).joints}

    def full(file: int) -> None:
        left[0] -= 1
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        usual(file)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(ResultsError, match=r"^can't write \S*journal.jsonl: No space left"):
        flexfmu.plan_motion(SHORT, methods=(), candidates=motions, robust=False, out=tmp_path)
    assert (tmp_path / FILE).exists()
    flexfmu.plan_motion(SHORT, methods=(), candidates=motions, robust=False, out=tmp_path)
    assert not (tmp_path / FILE).exists()
    assert (tmp_path / "front.csv").exists()


@pytest.mark.slow
def test_killed_plans_end_with_the_same_files(tmp_path: Path) -> None:
    """`kill -9` after units, then the same command: the files of the command that nothing has killed."""
    command = [
        *(sys.executable, "-m", "flexfmu", "plan", "barnard2012-6kg", "--method", "flexible", "--no-robust"),
        *("-j", "1", "--set", "plan.payload_band=0.0", "--out"),
    ]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    subprocess.run([*command, whole], check=False, capture_output=True)
    with subprocess.Popen([*command, cut], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 600.0
        while process.poll() is None and time.monotonic() < deadline:
            if (cut / FILE).exists() and (cut / FILE).read_bytes().count(b"\n") >= 3:
                break
            time.sleep(0.005)
        process.kill()
    again = subprocess.run([*command, cut], check=False, capture_output=True, text=True)
    assert "continuing: " in again.stderr
    assert not (cut / FILE).exists()
    for name in ("front.csv", "planned.csv", "planned.toml"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes()
