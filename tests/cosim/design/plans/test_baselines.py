"""Motions to compare with: within the limits that their planner knows, from and to the scene's places, and told when they don't fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.design.plans import baselines
from flexfmu.cosim.design.plans.assessment import Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals, goals_of
from flexfmu.cosim.design.plans.planned_files import write_scene
from flexfmu.cosim.design.plans.planner import PlanResult, plan_scene
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.kinematics import RigidForwardKinematics
from flexfmu.trajectories.piecewise import PiecewisePolynomial
from flexfmu.trajectories.shapers.shaped_joints import EndEffectorTrajectory
from flexfmu.trajectories.table import write_table

pytestmark = pytest.mark.slow

FEW = {"effects.proximal_bending": 1, "effects.distal_axial": 1}
SCENE = flexfmu.load_scene("barnard2012-6kg").replace(FEW)


@pytest.fixture(scope="module")
def goals() -> Goals:
    return goals_of(SCENE)


@pytest.fixture(scope="module", params=baselines.BASELINES)
def found(request: pytest.FixtureRequest, goals: Goals) -> list[Candidate]:
    """The motions of a planner."""
    pytest.importorskip(request.param)
    method = getattr(baselines, request.param)
    return list(method(goals, [], 1, lambda text, fraction: None))


def test_ends(found: list[Candidate], goals: Goals) -> None:
    """They move from rest to rest, from the scene's start to its end."""
    for candidate in found:
        motion = candidate.trajectory
        assert motion is not None
        ends = EndEffectorTrajectory(motion, RigidForwardKinematics(SCENE.mechanism))
        values = ends.evaluate([0.0, motion.duration], 1, "left")
        np.testing.assert_allclose(values[0], goals.trace[[0, -1]], atol=1e-9)
        np.testing.assert_allclose(values[1], 0.0, atol=1e-6)


def test_limits(found: list[Candidate], goals: Goals) -> None:
    """The first keeps to the limits that its planner knows, one of them nearly used up; the last keeps to all but the residual
    and the clearance."""
    judge = Judge(goals, baselines.PAYLOADS)
    first, last = (
        {use.name.removesuffix(" ratio"): use.share for use in judge.assess(candidate).uses}
        for candidate in (found[0], found[-1])
    )
    known = [first[name] for name in baselines.KNOWN[found[0].method]]
    assert 0.95 < max(known) < 1.01
    assert max(last[name] for name in baselines.ORDERS) < 1.01


def test_toppra_stays_on_the_path(goals: Goals) -> None:
    """Its spline through the path's places cuts no corner."""
    pytest.importorskip("toppra")
    motion = next(iter(baselines.toppra(goals, [], 1, lambda text, fraction: None))).trajectory
    assert motion is not None
    ends = EndEffectorTrajectory(motion, RigidForwardKinematics(SCENE.mechanism))
    points = ends.evaluate(np.linspace(0.0, motion.duration, 400), 0)[0]
    distance = np.hypot(*(points[:, None] - goals.trace[None]).transpose(2, 0, 1)).min(axis=1)
    assert distance.max() < 6e-4  # the trace's own points are 0.6 mm apart


def test_missing_package(goals: Goals, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message says what to install."""
    monkeypatch.setattr(baselines, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r'pip install "flexfmu\[ruckig\]"'):
        next(iter(baselines.ruckig(goals, [], 1, lambda text, fraction: None)))
    assert baselines.installed() == ()


@pytest.fixture(scope="module")
def planned(goals: Goals, tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    """A plan with a motion of the end effector from a file, longer than the given one."""
    file = tmp_path_factory.mktemp("motion") / "mine.csv"
    write_table(file, flexfmu.reference_motion(SCENE.replace({"trajectory.duration": 0.5})).task)
    candidate = baselines.file_candidate(SCENE.replace({"shaper": [{"kind": "zv"}]}), file)
    slow = Candidate("slower", "csv", SCENE.replace({"trajectory.duration": 0.6}))
    return plan_scene(SCENE.replace({"plan.residual": 1.0}), methods=(), candidates=[candidate, slow], robust=False)


def test_file(planned: PlanResult, goals: Goals) -> None:
    """A motion from a file is judged as the same motion of a scene, without the scene's shapers, and stands in the table."""
    found = next(each for each in planned.assessed if each.candidate.label == "mine.csv")
    same = Judge(goals, 7).assess(Candidate("same", "search", SCENE.replace({"trajectory.duration": 0.5})))
    assert found.time == pytest.approx(0.5)
    assert found.residual == pytest.approx(same.residual, rel=1e-3)
    assert found.torque == pytest.approx(same.torque, rel=1e-4)
    assert [each.candidate.label for each in planned.table] == ["given", "mine.csv", "slower"]


def test_end_effector_motion_is_written_as_such(planned: PlanResult, tmp_path: Path) -> None:
    """A chosen motion of the end effector is the same motion in the planned scene."""
    found = next(each for each in planned.assessed if each.candidate.label == "mine.csv")
    chosen = PlanResult(planned.goals, planned.given, found, planned.assessed, (), False, 0.0)
    write_scene(chosen, tmp_path / "planned.toml")
    again = flexfmu.reference_motion(flexfmu.load_scene(tmp_path / "planned.toml")).task
    wanted = flexfmu.reference_motion(SCENE.replace({"trajectory.duration": 0.5})).task
    instants = np.linspace(0.0, 0.5, 50)
    np.testing.assert_allclose(again.evaluate(instants, 0), wanted.evaluate(instants, 0), atol=1e-7)


def test_wrong_place() -> None:
    """A motion that ends elsewhere is told, with both places."""
    knots = np.array([0.0, 0.2])
    start, end = np.array([-0.175, 0.320]), np.array([0.1, 0.32])
    shape = np.array([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    taylor = shape[:, None, None] * (end - start) / 0.2 ** np.arange(6)[:, None, None]
    taylor[0, 0] = start
    motion = PiecewisePolynomial(knots, taylor)
    with pytest.raises(InputError, match=r"mine ends at \(0.1, 0.32\) m, .* at \(0.175, 0.32\) m"):
        baselines.own_candidate(SCENE, "mine", motion)
