"""Wishes that can't be fulfilled are told in one sentence; distances to regions agree with closed forms."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import Candidate, Judge
from flexfmu.cosim.design.plans.clearance import Clearance, Polygon, clearance_of_trace
from flexfmu.cosim.design.plans.goals import LEAST_DWELL, checked_goals, goals_of
from flexfmu.cosim.design.plans.optimal import nodes_of
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.kinematics import RigidKinematics
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.joint import EndEffectorTrajectory

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
        ({"minimise": "energy", "duration": 0.5, "plan.cycle.pause": 0.2}, "rad and to rest for 0.4 s with"),
        ({"payload_band": [8.0, 4.0]}, "lightest and the heaviest"),
        ({"payload_band": 1.0}, "must be"),
        ({"residual": -1e-6}, "must be above 0"),
        ({"minimise": "energy", "duration": 0.4, "front": ["energy", "time"]}, "in its place with a `duration`"),
        ({"limits": {"torque": {"ratio": 0.0}}}, "must be above 0"),
        ({"limits": {"torqe": 1.0}}, "did you mean `torque`"),
        ({"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [1.0, 0.0]]}]}, "keep_out"),
        ({"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]}]}, "on one line"),
        (
            {"keep_out": [{"kind": "polygon", "points": [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]]}]},
            "sides of `points` cross or touch, (0, 0) to (1, 1) and (1, 0) to (0, 1) m",
        ),
        ({"keep_out": [{"kind": "box", "corners": [[0.0, 0.3], [0.1, 0.3]]}]}, "opposite corners"),
        ({"payload_band": 30.0}, "`plan.payload_band`: must be a fraction to both sides"),
        ({"payload_band": [-1.0, 3.0]}, "[lightest, heaviest] in kg"),
        ({"limits": {"jerk": "high"}}, "`plan.limits.jerk`: a limit must be above 0"),
        ({"damping_band": 0.2, "effects.damping": {"kind": "none"}}, "no damping that could vary"),
        ({"damping_band": 0.2, "effects.damping": {"kind": "modal", "ratio": 0.0}}, "no damping that could vary"),
        ({"cosimulation.drive": "torque"}, "torque drive without a controller"),
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
@given(st.floats(-0.08, 0.08), st.floats(0.002, 0.03), st.floats(0.3, 0.4), st.booleans())
def test_first_motions_go_around_walls(x: float, half_width: float, top: float, is_upright: bool) -> None:
    """From start to end like the given motion, on one side of a drawn wall that it passes through; smoothed by a few millimetres."""
    low, high = (0.15, top) if is_upright else (0.315, 0.355)
    wall = {"kind": "box", "corners": [[x - half_width, low], [x + half_width, high]]}
    goals, free = (checked_goals(SCENE.replace({"plan.keep_out": each})) for each in ([wall], []))
    joints, given_joints = goals.first_motion, free.first_motion
    assert joints.duration == given_joints.duration
    ends = [each.evaluate([0.0, each.duration], 0, "left")[0] for each in (joints, given_joints)]
    np.testing.assert_allclose(*ends, atol=1e-6)
    moving = EndEffectorTrajectory(joints, RigidKinematics(SCENE.mechanism))
    points = moving.evaluate(np.linspace(0.0, joints.duration, 501), 0)[0]
    if goals.clearance.along(goals.trace).min() < -goals.wishes.margin:
        assert goals.clearance.along(points).min() > -0.008
        assert goals.clearance.along(goals.trace).min() < goals.clearance.along(points).min()


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
    # the programmes have all corners, with three payloads
    nodes = Counter((robots[k].stiffness, robots[k].damping) for k in nodes_of(robots, 4))
    assert nodes.keys() == {(each.stiffness, each.damping) for each in robots}
    masses = len({each.payload for each in robots})
    assert all(count == min(4 if corner == (1.0, 1.0) else 3, masses) for corner, count in nodes.items())


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


def signed_distance(corners: RealArray, points: RealArray) -> RealArray:
    """Distances (N,) of points from a polygon, negative within it, by the winding number and the distances from all sides."""
    after = np.roll(corners, -1, axis=0)
    side, away = after - corners, points[:, None] - corners
    onward = points[:, None] - after
    turn = np.arctan2(
        away[..., 0] * onward[..., 1] - away[..., 1] * onward[..., 0], np.einsum("nkj,nkj->nk", away, onward)
    )
    share = np.clip(np.einsum("nkj,kj->nk", away, side) / np.einsum("kj,kj->k", side, side), 0.0, 1.0)
    distance = np.hypot(*np.moveaxis(away - share[..., None] * side, -1, 0)).min(axis=1)
    return np.asarray(np.where(np.abs(turn.sum(axis=1)) > np.pi, -distance, distance))


def star(random: np.random.Generator) -> RealArray:
    """Corners (N, 2) about the origin, 0.5 to 1 away from it, some of them reflex."""
    count, angle = int(random.integers(3, 9)), random.uniform(0.0, 2.0 * np.pi)
    around = angle + 2.0 * np.pi * np.sort(random.uniform(0.0, 1.0, count) * 0.3 + np.arange(count)) / count
    return np.asarray(random.uniform(0.5, 1.0, count)[:, None] * np.column_stack([np.cos(around), np.sin(around)]))


@settings(max_examples=50)
@given(st.integers(0, 10_000))
def test_distances_from_outlines_and_their_gradients(seed: int) -> None:
    """By a second formulation, whatever the sense of rotation, at reflex corners too; the gradient is the slope of the distance."""
    random = np.random.default_rng(seed)
    corners, points = star(random), random.uniform(-2.0, 2.0, (500, 2))
    polygon = Polygon.of(corners)
    distance, gradient = polygon.distance(points)
    assert distance == pytest.approx(signed_distance(corners, points), abs=1e-14)
    assert Polygon.of(corners[::-1]).distance(points)[0] == pytest.approx(distance, abs=1e-14)
    step = 1e-7
    slope = np.stack(
        [(polygon.distance(points + step * e)[0] - polygon.distance(points - step * e)[0]) / (2 * step) for e in np.eye(2)],
        axis=1,
    )  # fmt: skip
    # but where two sides are equally near
    smooth = np.abs(np.hypot(*slope.T) - 1.0) < 1e-5
    assert smooth.mean() > 0.98
    assert gradient[smooth] == pytest.approx(slope[smooth], abs=1e-4)


@settings(max_examples=50)
@given(st.integers(0, 10_000))
def test_distances_of_segments_and_their_gradients(seed: int) -> None:
    """Those of the nearest of many points; negative where one is inside, and then moving that far sideways is enough."""
    random = np.random.default_rng(seed)
    polygon, (start, end) = Polygon.of(star(random)), random.uniform(-1.5, 1.5, (2, 200, 2))
    distance, by_start, by_end = polygon.of_segments(start, end)
    share = np.linspace(0.0, 1.0, 801)
    points = start[:, None] + share[:, None] * (end - start)[:, None]
    nearest = polygon.distance(points.reshape(-1, 2))[0].reshape(200, -1).min(axis=1)
    outside = distance > 0.0
    assert distance[outside] == pytest.approx(nearest[outside], abs=4e-3)
    assert (nearest[~outside] < 2e-3).all()
    normal = by_start + by_end
    assert np.hypot(*normal.T) == pytest.approx(1.0)
    away = (-distance * (1.0 + 1e-9) + 1e-9)[:, None] * normal
    assert (polygon.of_segments(start + away, end + away)[0][~outside] > -1e-6).all()
    random_step = 1e-7 * random.normal(size=(2, 200, 2))
    change = np.einsum("nj,nj->n", by_start, random_step[0]) + np.einsum("nj,nj->n", by_end, random_step[1])
    found = polygon.of_segments(start + random_step[0], end + random_step[1])[0] - distance
    # but where two corners are equally near, or a segment begins to cross; sideways ways of turning ones change by their ends
    assert (np.abs(found - change)[outside] < 1e-10).mean() > 0.95


def test_links_keep_clear_where_regions_say_so() -> None:
    """A box below an elbow's way is passed by the end effector, and not by the link, by the distance of a brute-force scan and the link's radius."""
    box = {"kind": "box", "corners": [[-0.36, -0.2], [-0.30, -0.05]]}
    goals = [goals_of(SCENE.replace({"plan.keep_out": [{**box, "links": each}]})) for each in (False, True)]
    alone, linked = (each.clearance.distance(goals[0].trace) for each in goals)
    elbow = RigidKinematics(SCENE.mechanism).elbows(goals[0].trace)[0]
    share = np.linspace(0.0, 1.0, 4001)[:, None, None]
    points = np.array([-0.1, 0.0]) + share * (elbow - np.array([-0.1, 0.0]))
    corners = np.array([[-0.36, -0.2], [-0.30, -0.2], [-0.30, -0.05], [-0.36, -0.05]])
    brute = signed_distance(corners, points.reshape(-1, 2)).reshape(4001, -1).min(axis=0) - 0.0175
    assert alone.min() > 0.1
    assert linked.min() < -0.003
    assert np.minimum(alone, brute) == pytest.approx(linked, abs=1e-6)
    # by the end effector's place
    point, step = goals[0].trace[250:251], 1e-6
    clearance = goals[1].clearance
    slope = [
        (clearance.distance(point + step * e) - clearance.distance(point - step * e))[0] / (2 * step) for e in np.eye(2)
    ]
    distance, gradient = clearance.distances(point)
    assert gradient[distance.argmin(), 0] == pytest.approx(slope, rel=1e-4)


def test_a_motion_clears_what_it_goes_around() -> None:
    across = np.linspace(0.0, 0.3, 301)
    trace = np.column_stack([across, 0.05 * np.sin(np.pi * across / 0.3)])
    clearance = clearance_of_trace(trace, corridor=0.01, below=1e-3)
    allowed = [[0.15, 0.055], [-0.005, 0.001], [0.305, 0.02], [0.15, 0.0599]]
    kept_clear = [[0.15, 0.04], [0.15, 0.065], [-0.02, 0.001], [0.32, 0.02], [0.15, -0.002]]
    assert (clearance.distance(np.array(allowed)) > 0.0).all()
    assert (clearance.distance(np.array(kept_clear)) < 0.0).all()
    # the chord is no way between what lies above and below it
    assert (clearance.distance(np.linspace([0.03, 0.0], [0.27, 0.0], 25)) < -0.01).all()
    # without regions everything is allowed
    assert np.isinf(Clearance(()).distance(np.array(kept_clear))).all()


def way_of(random: np.random.Generator) -> RealArray:
    """A smooth way of about 0.3 m with points some 0.5 mm apart, as a run records it."""
    x = np.linspace(-0.15, 0.15, 601)
    bends = random.uniform(-0.01, 0.01, 4)
    return np.column_stack([x, sum(bend * np.cos((k + 1) * 9.0 * x) for k, bend in enumerate(bends))])


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_the_depth_of_a_way_is_that_of_a_finely_sampled_one(seed: int) -> None:
    """Walls of 10 µm to 3 mm, wedges, stars and blocks, wherever points of the way lie."""
    random = np.random.default_rng(seed)
    way = way_of(random)
    place = way[random.integers(50, 550)] + random.uniform(-1e-3, 1e-3, 2)
    stretch = np.array([10.0 ** random.uniform(-5.0, -2.5), 10.0 ** random.uniform(-3.0, -1.3)])
    shape, angle = star(random) * stretch, random.uniform(0.0, 2.0 * np.pi)
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    region = Polygon.of(place + shape @ turned.T)
    found = max((each.depth for each in region.stretches(way)), default=0.0)
    # a thousandth of a millimetre apart, where the way is near
    near = np.flatnonzero(np.hypot(*(way - place).T) < np.hypot(*shape.T).max() + 1e-3)
    low, high = max(near[0] - 1, 0), min(near[-1] + 1, len(way) - 1)
    index = np.linspace(low, high, 500 * (high - low) + 1)
    fine = np.column_stack([np.interp(index, np.arange(len(way)), each) for each in way.T])
    exact = max(0.0, -float(signed_distance(region.corners, fine).min()))
    assert found == pytest.approx(exact, abs=1.5e-6)
    assert found >= exact - 1e-8


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.floats(1e-6, 1e-3), st.floats(2e-3, 0.05), st.floats(-1.2, 1.2))
def test_a_way_through_a_wall_is_as_far_off_as_the_walls_end(
    seed: int, thickness: float, beyond: float, slant: float
) -> None:
    """However thin the wall is, and more so the thinner; beside it, and where a corner is cut, the depth alone counts."""
    way = way_of(np.random.default_rng(seed))
    k = 300
    along = (way[k + 1] - way[k - 1]) / np.hypot(*(way[k + 1] - way[k - 1]))
    up = np.array(
        [np.sin(slant) * along[0] - np.cos(slant) * along[1], np.sin(slant) * along[1] + np.cos(slant) * along[0]]
    )
    side = 0.5 * thickness * np.array([up[1], -up[0]])
    place = way[k] + 1e-4 * along
    wall = Polygon.of(
        [place - 0.1 * up - side, place - 0.1 * up + side, place + beyond * up + side, place + beyond * up - side]
    )
    passed = Clearance((wall,), thin=True)
    # far from it no motion of 0.1 mm would go around it
    if beyond > 12.0 * thickness / np.cos(slant):
        assert passed.passage(way) > 0.3 * beyond
        assert passed.passage(way) < 1.1 * beyond + thickness
        assert passed.along(way).min() < -0.3 * beyond
    # moved aside by more than the wall reaches, nothing is passed
    clear = Clearance((Polygon.of(wall.corners - 0.2 * up),), thin=True)
    assert clear.passage(way + 0.0) == 0.0


def test_a_corner_that_is_cut_is_not_passed_through() -> None:
    """The depth counts there, as within a margin it is allowed."""
    box = Clearance((Polygon.of([(0, 0), (1, 0), (1, 1), (0, 1)]),), thin=True)
    for depth in (1e-6, 1e-4, 1e-2):
        cut = np.array([[-1.0, 1.0 + 2 * depth], [1.0 + 2 * depth, -1.0]])[:, ::-1]
        assert box.passage(cut) == 0.0
        grazing = np.array([[-0.5, 1.0 - depth], [1.5, 1.0 - depth]])
        assert box.along(grazing).min() == pytest.approx(-depth)


def test_motors_replace_the_given_motions_limits() -> None:
    """Of a scene with motors what they can is the limit, unless the wishes say otherwise; without them such a limit is an error."""
    scene = load_scene("barnard2012-6kg")
    assert {"torque", "rms_torque", "power"} <= goals_of(scene).limits.keys()
    motor = {"continuous_torque": 1.6, "peak_torque": 4.8, "maximum_speed": 600.0, "gear_ratio": 25.0}
    limits = goals_of(scene.replace({"motor": motor, "plan.limits.power": {"ratio": 1.5}})).limits
    assert limits.keys() == {
        "residual",
        "clearance",
        "motor_torque",
        "motor_rms_torque",
        "motor_speed",
        "power",
        "speed",
        "acceleration",
        "jerk",
    }
    assert limits["motor_torque"].limit == 1.0
    free = goals_of(scene.replace({"motor": motor, "plan.limits.motor_rms_torque": "free"})).limits
    assert "motor_rms_torque" not in free
    with pytest.raises(InputError, match="add a section `motor`"):
        goals_of(scene.replace({"plan.limits.motor_torque": 0.9}))


@pytest.mark.slow
def test_limits_of_shafts_are_of_the_motors_and_ratios_of_the_given_motion() -> None:
    """A number is a share of what the motor can; a ratio is one of what the given motion asks of it: by gear, rotor and friction in numpy."""
    motor = {
        "continuous_torque": 1.6, "peak_torque": 4.8, "maximum_speed": 600.0, "gear_ratio": 25.0, "gear_efficiency": 0.9, "rotor_inertia": 4e-5,
    }  # fmt: skip
    limits = {"motor_torque": {"ratio": 1.2}, "motor_rms_torque": 0.9, "motor_speed": {"ratio": 1.1}}
    scene = load_scene("barnard2012-6kg").replace(
        {"motor": motor, "plan.payload_band": 0.0, "plan.limits": limits, "effects.proximal_bending": 1}
    )
    judge, needs = Judge(goals_of(scene), 1), list[tuple[float, float, float]]()
    faster = Candidate("faster", "search", judge.goals.scene.replace({"trajectory.duration": 0.4}))
    for each in (judge.given.candidate, faster):
        run = flexfmu.run(each.scene, communication_step=5e-5, tolerance=1e-8)
        time = run.recording.time
        torque = np.column_stack([run.recording[f"joint{joint}.torque"].values for joint in (1, 2)])
        _, speed, acceleration = run.plan.joints.evaluate(np.minimum(time, run.plan.duration), 2, "left")
        speed[time > run.plan.duration] = acceleration[time > run.plan.duration] = 0.0
        shaft = torque / 25.0 * 0.9 ** -np.sign(torque * speed) + 4e-5 * 25.0 * acceleration
        rms = np.sqrt(np.trapezoid(shaft**2, time, axis=0) / time[-1])
        needs.append((abs(shaft).max() / 4.8, rms.max() / 1.6, abs(speed).max() * 25.0 / 600.0))
    uses = {use.figure: use for use in judge.assess(faster).uses}
    (given_torque, _, given_speed), (torque, rms, speed) = needs
    assert uses["motor_torque"].share == pytest.approx(torque / given_torque / 1.2, rel=0.02)
    assert uses["motor_rms_torque"].share == pytest.approx(rms / 0.9, rel=2e-3)
    assert uses["motor_speed"].share == pytest.approx(speed / given_speed / 1.1, rel=2e-3)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"continuous_torque": 0.2}, "continuous_torque"),
        ({"continuous_torque": 0.2, "peak_torque": 0.3, "thermal_time_constant": 20.0}, "continuous_torque"),
        ({"torque_speed_curve": [[0.0, 0.2], [300.0, 4.8]]}, "torque_speed_curve"),
    ],
)
def test_a_motor_that_cannot_hold_the_payload_is_an_error(changes: dict[str, Any], key: str) -> None:
    motor = {"continuous_torque": 1.6, "peak_torque": 4.8, "maximum_speed": 600.0, "gear_ratio": 25.0}
    with pytest.raises(InputError, match=rf"`motor\.{key}` allows 0\.2 N·m at rest, less than"):
        checked_goals(load_scene("barnard2012-6kg").replace({"motor": motor | changes}))
