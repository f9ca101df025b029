"""Wishes that can't be fulfilled are told in one sentence before anything is simulated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.goals import LEAST_DWELL, checked_goals, goals_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

SCENE = load_scene("barnard2012-6kg")
"""From (-0.175, 0.320) by -25 mm to (0.175, 0.320) m."""


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"keep_out": [{"kind": "box", "corners": [[-0.2, 0.3], [-0.1, 0.4]]}]}, "contains the start"),
        ({"keep_out": [{"kind": "above", "height": 0.31, "half_width": 0.02, "center": 0.175}]}, "contains the end"),
        ({"keep_out": [{"kind": "box", "corners": [[-0.01, -1.0], [0.01, 1.0]]}]}, "leaves no way"),
        ({"limits": {"torque": 2.0}}, "against gravity"),
        ({"minimise": "torque"}, "needs `duration`"),
        ({"duration": 0.3}, "contradict each other"),
        ({"minimise": "energy", "duration": 0.05}, "which a joint needs"),
        ({"payload_band": [8.0, 4.0]}, "lightest and the heaviest"),
        ({"payload_band": 1.0}, "must be"),
        ({"residual": -1e-6}, "must be above 0"),
        ({"limits": {"torque": {"ratio": 0.0}}}, "must be above 0"),
        ({"limits": {"torqe": 1.0}}, "did you mean `torque`"),
        ({"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [1.0, 0.0]]}]}, "keep_out"),
        ({"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]}]}, "on one line"),
        ({"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]}]}, "cross"),
        ({"keep_out": [{"kind": "box", "corners": [[0.0, 0.3], [0.1, 0.3]]}]}, "opposite corners"),
        ({"payload_band": 30.0}, "`plan.payload_band`: must be a fraction to both sides"),
        ({"payload_band": [-1.0, 3.0]}, "[lightest, heaviest] in kg"),
        ({"limits": {"jerk": "high"}}, "`plan.limits.jerk`: a limit must be above 0"),
        ({"damping_band": 0.2, "effects.damping": {"kind": "none"}}, "no damping that could vary"),
        ({"damping_band": 0.2, "effects.damping": {"kind": "modal", "ratio": 0.0}}, "no damping that could vary"),
        ({"cosimulation.drive": "torque"}, "torque drive or controllers"),
    ],
)
def test_wishes_that_contradict(wishes: dict[str, Any], message: str) -> None:
    """One sentence."""
    with pytest.raises((InputError, SceneError)) as error:
        checked_goals(SCENE.replace({key if "." in key else f"plan.{key}": value for key, value in wishes.items()}))
    text = str(error.value)
    assert message in text
    assert "\n" not in text


def test_regions_with_a_gap_are_no_contradiction() -> None:
    wall = {"kind": "box", "corners": [[-0.01, 0.30], [0.01, 1.0]]}
    checked_goals(SCENE.replace({"plan.keep_out": [wall]}))


@settings(max_examples=8)
@given(st.floats(0.0, 0.9), st.floats(0.0, 0.5), st.floats(0.0, 0.9))
def test_bands_hold_their_ends(payload: float, stiffness: float, damping: float) -> None:
    wishes = {"payload_band": payload, "stiffness_band": stiffness, "damping_band": damping}
    scene = SCENE.replace({f"plan.{key}": value for key, value in wishes.items()})
    # a payload of zero has a band of one payload
    assert {each.payload for each in checked_goals(scene.replace({"payload.mass": 0.0})).variations(7)} == {0.0}
    goals = checked_goals(scene)
    robots = goals.variations(5)
    low, high = goals.band
    assert (min(each.payload for each in robots), max(each.payload for each in robots)) == (low, high)
    assert {each.stiffness for each in robots} == ({1.0, 1 - stiffness, 1 + stiffness} if stiffness else {1.0})
    assert {each.damping for each in robots} == ({1.0, 1 - damping, 1 + damping} if damping else {1.0})


@pytest.mark.parametrize(
    "damping",
    [
        {"kind": "modal", "ratio": 0.1},
        {"kind": "stiffness", "time": 1e-4},
        {"kind": "rayleigh", "rate": 2.0, "time": 1e-4},
    ],
    ids=lambda each: each["kind"],
)
def test_a_band_of_damping_varies_every_strength(damping: dict[str, Any]) -> None:
    """In parameters of the FMU, and in scenes."""
    goals = goals_of(SCENE.replace({"effects.damping": damping, "plan.damping_band": 0.5}))
    strengths = {key: value for key, value in damping.items() if key != "kind"}
    factors = set()
    for each in goals.variations(2):
        factors.add(each.damping)
        changes = each.changes(goals.scene)
        varied = each.of(goals.scene).effects.damping
        for key, value in strengths.items():
            assert changes.get(f"damping.{key}", value) == getattr(varied, key) == pytest.approx(each.damping * value)
    assert factors == {0.5, 1.0, 1.5}


def test_vibration_is_judged_after_the_time_to_settle() -> None:
    assert goals_of(SCENE.replace({"plan.settled_within": 0.5})).scene.trajectory.dwell == 0.5 + LEAST_DWELL


def test_a_closed_outline_is_the_same_region() -> None:
    points = [[-0.02, 0.3], [0.02, 0.3], [0.0, 0.32]]
    here = np.array([[0.0, 0.31], [0.0, 0.2], [-0.02, 0.3]])
    opened, closed = (
        goals_of(SCENE.replace({"plan.keep_out": [{"kind": "polygon", "points": each}]})).clearance.distance(here)
        for each in (points, [*points, points[0]])
    )
    assert opened.tolist() == closed.tolist()


@given(st.floats(1e-3, 1e3), st.floats(0.0, 2e3), st.booleans())
def test_a_limit_is_kept_where_nothing_exceeds_it(limit: float, value: float, is_upper: bool) -> None:
    """The verdict and the excess agree, for largest and for smallest values."""
    found = Limit("figure", limit, "1", is_upper=is_upper).used(value)
    assert found.met is (found.excess(value) <= 0.0)
