"""Optimal control as a method of the planner: motions that the FMU judges, and corrections by what it finds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from flexfmu.cosim.design.plans import optimal as method
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals, goals_of
from flexfmu.cosim.design.plans.optimal import optimal
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.reference_design.elastic_response import ElasticResponse
from flexfmu.model.reference_design.joint_spline import JointSpline
from flexfmu.model.reference_design.optimal_control import GROUPS, Improvement, MotionLimits
from flexfmu.model.scene.file import load_scene

SCENE = load_scene("barnard2012-6kg").replace(
    {
        "effects.proximal_bending": 1,
        "effects.distal_axial": 0,
        "plan.payload_band": 0.0,
        "plan.minimise": "rms_torque",
        "plan.duration": 0.33,
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
        next(optimal(returning, [judge.given], 1, _silent))


@pytest.fixture(scope="module")
def assessed(goals: Goals, judge: Judge) -> Assessment:
    """The motion of least torque in less time than the given one has."""
    *_, last = optimal(goals, [judge.given], 1, _silent)
    assert isinstance(last, Candidate)
    return judge.assess(last)


@pytest.mark.slow
def test_the_least_torque_in_a_shorter_time_leaves_no_vibration(assessed: Assessment, judge: Judge) -> None:
    """Judged by the FMU: a fifth faster, less vibration by an order, peaks within those of the given motion."""
    assert assessed.time == pytest.approx(0.33)
    assert assessed.residual < 1e-6 < judge.given.residual
    assert assessed.torque_ratio < 1.0
    assert assessed.feasible, [use for use in assessed.uses if not use.met]


@pytest.mark.slow
@pytest.mark.parametrize("limits", [{"torque": {"ratio": 0.7}}, {"power": {"ratio": 0.5}}])
def test_what_the_fmu_finds_beyond_a_limit_is_taken_off_it(
    limits: dict[str, dict[str, float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Optimal control whose model finds torques a fifth too small, or that doesn't know a limit, still ends within it."""
    wishes = {
        "plan.minimise": "time",
        "plan.duration": None,
        "plan.payload_band": 0.3,
        "plan.residual": 1e-3,
        "plan.limits": limits,
    }
    goals = goals_of(SCENE.replace(wishes))
    variants = [each.changes(goals.scene) for each in goals.variations(3)]

    def optimistic(
        robots: object, limits: MotionLimits, start: JointSpline, *_: object, **__: object
    ) -> Iterator[Improvement]:
        response = ElasticResponse(goals.scene, variants, start.coefficients[0], 60)
        for duration in np.arange(0.3, 1.2, 0.03):
            torque = response.of_spline(motion := start.with_duration(float(duration)), derivatives=False).torque
            if (np.abs(torque).max(axis=1) < 1.2 * limits.torque[[0, 1, 2]]).all():
                yield Improvement(motion, dict.fromkeys(GROUPS, 0.0), 0.0, checked=True)
                return

    monkeypatch.setattr(method, "optimal_motion", optimistic)
    monkeypatch.setattr(method, "PAYLOADS", (3, 1))
    judge = Judge(goals, 3)
    found = [judge.assess(each) for each in optimal(goals, [judge.given], 1, _silent)]
    assert not found[0].feasible
    assert found[-1].feasible
    assert found[0].time < found[-1].time
