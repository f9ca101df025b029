"""Optimal control within limits that hold for a band of payloads: closed forms, limits judged by the FMU, and the programmes below."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog

import flexfmu
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.reference_design import optimal_control
from flexfmu.model.reference_design.elastic_response import ElasticResponse, RobotVariant, VariantModel
from flexfmu.model.reference_design.joint_spline import JointSpline, fitted
from flexfmu.model.reference_design.loads import Drives, Loads
from flexfmu.model.reference_design.optimal_control import (
    CHECKED,
    GROUPS,
    LOOSE,
    Aim,
    Improvement,
    LeftVibration,
    MotionProblem,
    ResidualVibration,
    Stage,
    Way,
    bounds,
    optimal_motion,
)
from flexfmu.model.reference_design.quadratic_programme import solve_quadratic
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.motor import Motor
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

PAYLOADS = np.array([5.4, 6.0, 6.6])


WIDE = 1e6


def above(points: RealArray) -> tuple[RealArray, RealArray]:
    """Distances from a table at y = 0.27 m."""
    return points[np.newaxis, ..., 1] - 0.27, np.broadcast_to([0.0, 1.0], (1, *points.shape))


def free(points: RealArray) -> tuple[RealArray, RealArray]:
    """Distances from nothing."""
    return np.ones((1, *points.shape[:-1])), np.zeros((1, *points.shape))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("barnard2012-6kg")


@pytest.fixture(scope="module")
def variants() -> list[dict[str, float]]:
    return [{"payload.mass": float(mass)} for mass in PAYLOADS]


@pytest.fixture(scope="module")
def given(scene: Scene) -> JointSpline:
    return fitted(plan(scene).joints, 20)


MOTOR = Motor(
    1.2,
    3.5,
    600.0,
    1e-4,
    25.0,
    0.9,
    torque_speed_curve=((0.0, 3.5), (100.0, 3.0), (600.0, 1.0)),
    thermal_time_constant=0.5,
)


def rates(*largest: float) -> dict[str, RealArray]:
    """Limits of speed, acceleration and jerk of both joints."""
    return {name: np.full(2, each) for name, each in zip(("speed", "acceleration", "jerk"), largest, strict=True)}


@pytest.fixture(scope="module")
def problem(scene: Scene, variants: list[dict[str, float]], given: JointSpline) -> MotionProblem:
    robots = [RobotVariant(scene, each) for each in variants]
    response = ElasticResponse(robots, given.coefficients[0], 60).of_motion(given, derivatives=False)
    limits = {"torque": abs(response.torque).max(axis=1), **rates(20.0, 500.0, 4e4)}
    return MotionProblem([Way(robots, given, above)], limits, 5e-6, loose=LOOSE)


def within(violations: Mapping[str, float]) -> bool:
    """Whether all limits are met on the fine grid."""
    return all(each <= CHECKED[name] for name, each in violations.items())


@pytest.fixture(scope="module")
def improvements(problem: MotionProblem, given: JointSpline) -> list[Improvement]:
    return list(optimal_motion(problem.begun([given.with_duration(0.24)], loose=LOOSE)))


def test_quadratic_programmes_without_curvature_have_the_solution_of_linear_ones() -> None:
    random = np.random.default_rng(0)
    for _ in range(5):
        cost, matrix, right = random.standard_normal(6), random.standard_normal((30, 6)), random.uniform(0.5, 2.0, 30)
        bound = np.full(6, 3.0)
        x, _ = solve_quadratic(np.zeros((6, 6)), cost, matrix, right, -bound, bound)
        assert cost @ x == pytest.approx(linprog(cost, matrix, right, bounds=(-3.0, 3.0)).fun, abs=1e-6)
        assert (matrix @ x - right).max() < 1e-6


def test_quadratic_programmes_find_the_nearest_point_of_a_half_space() -> None:
    normal, wished = np.array([3.0, 4.0]), np.array([2.0, 2.0])
    x, _ = solve_quadratic(
        np.eye(2), -wished, normal[np.newaxis], np.array([5.0]), np.full(2, -np.inf), np.full(2, np.inf)
    )
    np.testing.assert_allclose(x, wished - (normal @ wished - 5.0) / 25.0 * normal, atol=1e-6)


def test_derivatives_of_a_cycle_are_those_of_finite_differences(
    scene: Scene, variants: list[dict[str, float]], given: JointSpline, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Limits at instants of both ways, loads of the whole cycle, and the vibration that goes on from way to way."""
    # differences are smaller than the errors of motions that are only compared
    monkeypatch.setattr(optimal_control, "COMPARED", 1e-13)
    empty, back = scene.replace({"payload.mass": 0.0}), replace(given, coefficients=given.coefficients[::-1])
    robots = [[RobotVariant(scene, each) for each in variants[::2]], [RobotVariant(empty)] * 2]
    motions, loads = (
        (given.with_duration(0.25), back.with_duration(0.2)),
        {
            "torque": 50.0,
            "power": 300.0,
            "supply_power": 300.0,
            "regenerated_power": 300.0,
            "motor_torque": 0.7,
            "reaction": 200.0,
            "stress": 2e7,
        },
    )
    drives, pairs = Drives((MOTOR, replace(MOTOR, gear_ratio=20.0)), 0.01), ("torque", "power", "motor_torque")
    limits = {name: np.full((2, 2) if name in pairs else 2, value) for name, value in loads.items()}
    ways = [Way(few, motion.with_duration(0.2), above, 0.05) for few, motion in zip(robots, motions, strict=True)]
    of_cycle = {
        "rms_torque": np.full((2, 2), 20.0), "energy": np.full(2, 40.0), "motor_rms_torque": np.full((2, 2), 0.8), "regenerated_energy": np.full(2, 5.0),
    }  # fmt: skip
    limits |= of_cycle | rates(20.0, 500.0, 4e4)
    stage = Stage(MotionProblem(ways, limits, 2e-6, drives=drives), motions, 1)
    state = stage.state(motions)
    linear = stage.linear(state)
    direction = 1e-6 * np.random.default_rng(0).standard_normal(linear.jacobian.shape[1])

    def moved(sign: int) -> list[RealArray]:
        changed = []
        for way, motion in zip(stage.ways, motions, strict=True):
            coefficients, own = motion.coefficients.copy(), sign * direction[way.columns]
            coefficients[4:-4] += own[:-1].reshape(2, -1).T
            changed.append(JointSpline(coefficients, motion.duration + own[-1]))
        found = stage.state((changed[0], changed[1]), derivatives=False)
        return [found.values[linear.deciding], found.amplitudes]

    differences = [0.5 * (ahead - behind) for ahead, behind in zip(moved(1), moved(-1), strict=True)]
    exact = [linear.jacobian @ direction, linear.amplitudes_by @ direction]
    assert {GROUPS[k] for k in linear.groups[linear.values > 0.0]} >= {*loads, *of_cycle}
    for difference, by in zip(differences, exact, strict=True):
        np.testing.assert_allclose(difference, by, atol=2e-4 * abs(by).max())


def test_residual_and_loads_of_the_motors_are_those_of_the_fmu(scene: Scene, given: JointSpline) -> None:
    """The residual is bounded; torques, powers, RMS torques over motion and dwell and energies agree, also between instants of the grid."""
    motion = given.with_duration(0.3)
    elastic = ElasticResponse([RobotVariant(scene)], motion.coefficients[0], 128)
    response, vibration = (
        elastic.of_motion(motion, derivatives=False),
        ResidualVibration(elastic.models, motion.coefficients[-1]),
    )
    bound = bounds(vibration.matrices, vibration.away(response.end))
    metrics = flexfmu.run(scene, trajectory=motion.trajectory(), tolerance=1e-8).metrics
    residual = float(metrics["residual_vibration_amplitude"])
    assert 0.4 * bound[0] < residual < 1.02 * bound[0]
    loads = Loads(response, vibration.holding, scene.trajectory.dwell)
    torque, power = loads.values("torque")[0], loads.values("power")[0]
    rms = np.sqrt(loads.need("rms_torque")[0] / (motion.duration + scene.trajectory.dwell))
    for joint in range(2):
        of_joint = [float(metrics[f"{name}_{joint + 1}"]) for name in ("peak_torque", "rms_torque")]
        assert [abs(torque[:, joint]).max(), rms[joint]] == pytest.approx(of_joint, rel=2e-3)
        powers = [float(metrics[f"{name}_{joint + 1}"]) for name in ("peak_power", "peak_regenerated_power")]
        assert [power[:, joint].max(), -power[:, joint].min()] == pytest.approx(powers, rel=2e-3)
    energy = sum(float(metrics[f"positive_energy_{joint}"]) for joint in (1, 2))
    assert loads.need("energy")[0] == pytest.approx(energy, rel=1e-3)


def test_loads_of_shafts_joints_and_links_are_those_of_the_fmu(scene: Scene, given: JointSpline) -> None:
    """Shafts by `motor_loads`, forces by the FMU's outputs, stresses at more places by `link_stresses`."""
    motion, names = given.with_duration(0.3), ("reaction", "stress")
    # torques jump where gears change the direction of their losses
    elastic = ElasticResponse([RobotVariant(scene)], motion.coefficients[0], 512, loads=names)
    response, rest = elastic.of_motion(motion, derivatives=False), elastic.models[0].rest(motion.coefficients[-1])
    motors = (MOTOR, replace(MOTOR, gear_ratio=20.0))
    drives = Drives(motors, scene.effects.motor_inertia)
    loads = Loads(response, rest.torque, scene.trajectory.dwell, drives, names)
    run = flexfmu.run(scene.replace({"effects.reactions": True}), trajectory=motion.trajectory(), tolerance=1e-8)
    time = motion.duration + scene.trajectory.dwell
    for joint, load in enumerate(flexfmu.motor_loads(run, motors)):
        use = {margin.name: margin.use for margin in load.margins}
        assert loads.need("motor_torque")[0, joint] == pytest.approx(use["torque at speed"], rel=5e-3)
        rms = np.sqrt(loads.need("motor_rms_torque")[0, joint] / time)
        assert rms == pytest.approx(use["RMS torque"], rel=1e-3)
    for k, name in enumerate(("elbow1", "elbow2", "leg1", "leg2")):
        force = np.hypot(*(run.recording[f"{name}.reaction.{axis}"].values for axis in "xy"))
        moving = force[run.recording.time <= motion.duration]
        assert loads.values("reaction")[0, :, k].max() == pytest.approx(moving.max(), rel=2e-3)
    largest = max(each.combined.value for each in flexfmu.link_stresses(run) if each.combined is not None)
    assert 0.9 * largest < loads.need("stress").max() < 1.002 * largest


@pytest.mark.slow
def test_the_fastest_motion_meets_its_limits_for_all_payloads_in_the_fmu(
    scene: Scene, improvements: list[Improvement], problem: MotionProblem
) -> None:
    (best,), violations = improvements[-1]
    assert within(violations)
    assert not within(improvements[0][1])
    assert best.duration < 0.21
    for mass, torque in zip(PAYLOADS, problem.limits["torque"], strict=True):
        run = flexfmu.run(scene, trajectory=best.trajectory(), tolerance=1e-8, parameters={"payload.mass": float(mass)})
        assert float(run.metrics["residual_vibration_amplitude"]) < 1.06 * problem.residual
        peaks = np.array([float(run.metrics[f"peak_torque_{joint}"]) for joint in (1, 2)])
        assert (peaks < 1.002 * torque).all()
        assert run.recording["end_effector.position.y"].values.min() > 0.27 - 2e-5
    speeds, accelerations, jerks = abs(best.evaluate(np.linspace(0.0, 1.0, 1001), 3)[1:]).max(axis=(1, 2))
    assert (speeds, accelerations, jerks) < (20.002, 500.05, 40004.0)


@pytest.fixture(scope="module")
def rigid(scene: Scene) -> Scene:
    return scene.replace({"effects.proximal_bending": 0, "effects.distal_axial": 0})


@pytest.mark.parametrize(
    ("speed", "acceleration", "jerk"), [(WIDE, 100.0, WIDE), (4.0, 100.0, WIDE), (WIDE, WIDE, 5000.0)]
)
def test_limited_references_give_the_fastest_motion_from_rest_to_rest(
    rigid: Scene, given: JointSpline, speed: float, acceleration: float, jerk: float
) -> None:
    """T = 2 √(D / a), with a limited speed D / v + v / a, or (32 D / j)^(1/3); no spline is faster, one of 20 intervals is near."""
    limits = {"torque": np.full((1, 2), WIDE), **rates(speed, acceleration, jerk)}
    problem = MotionProblem([Way([RobotVariant(rigid)], given, free)], limits, 1e-6, loose=LOOSE)
    *_, ((fast,), violations) = optimal_motion(problem)
    way = abs(np.diff(given.coefficients[[0, -1]], axis=0)).max()
    fastest = (32 * way / jerk) ** (1 / 3)
    if jerk == WIDE:
        fastest = 2 * np.sqrt(way / acceleration) if speed == WIDE else way / speed + speed / acceleration
    assert within(violations)
    assert 0.999 * fastest <= fast.duration < 1.12 * fastest


def test_a_rigid_robot_has_a_fastest_cycle(rigid: Scene, given: JointSpline) -> None:
    """Nothing vibrates on from way to way; both ways are as fast as one alone."""
    limits = {"torque": np.full((1, 2), WIDE), **rates(WIDE, 100.0, WIDE)}
    robot, back = RobotVariant(rigid), replace(given, coefficients=given.coefficients[::-1])
    alone, both = (
        [*optimal_motion(MotionProblem([Way([robot], motion, free) for motion in motions], limits, 1e-6, loose=LOOSE))][
            -1
        ]
        for motions in ([given], [given, back])
    )
    assert within(both[1])
    assert [each.duration for each in both[0]] == pytest.approx([alone[0][0].duration] * 2, rel=1e-3)


def test_a_limit_that_time_hardly_moves_is_kept_from_the_first_motions_on(rigid: Scene, given: JointSpline) -> None:
    """RMS torques that gravity makes for the most part: a programme that would rather miss them than be slow gets a higher price at once."""
    slow, pause = given.with_duration(1.0), 0.25
    elastic = ElasticResponse([RobotVariant(rigid)], slow.coefficients[0], 60)
    response = elastic.of_motion(slow, derivatives=False)
    squares = Loads(response, elastic.models[0].rest(slow.coefficients[-1]).torque, pause).of_cycle("rms_torque")
    limits = {
        "torque": np.full((1, 2), WIDE),
        "rms_torque": np.sqrt(squares / (1.0 + pause)),
        **rates(WIDE, WIDE, WIDE),
    }
    way = Way([RobotVariant(rigid)], slow.with_duration(0.65), above, pause)
    found = list(optimal_motion(MotionProblem([way], limits, 1e-6, loose=LOOSE)))
    (best,), last = found[-1]
    assert within(last)
    assert best.duration < 0.63
    # three first motions are too fast, and none is later
    assert all(violations["rms_torque"] < 0.01 for _, violations in found[3:])


@pytest.mark.parametrize("aim", ["torque", "rms_torque", "energy"])
def test_the_effort_has_its_derivatives_and_falls_in_the_given_duration(
    problem: MotionProblem, given: JointSpline, aim: Aim
) -> None:
    """Its slope is that of finite differences; the best motion needs less than the given one, in the same time and within limits."""
    stage = Stage(problem, (given,), 2, aim)
    direction = np.append(1e-4 * np.random.default_rng(0).standard_normal(2 * len(given.coefficients[4:-4])), 0.0)
    first = stage.state((given,))
    costs = [stage.state((given.moved(sign * direction),), derivatives=False).cost for sign in (1.0, -1.0)]
    linear = stage.linear(first)
    assert first.cost == pytest.approx(1.0)
    assert linear.slope @ direction == pytest.approx(0.5 * (costs[0] - costs[1]), rel=1e-3)
    assert np.linalg.eigvalsh(linear.curvature).min() > -1e-9 * abs(linear.curvature).max()
    *_, (motions, violations) = optimal_motion(problem, aim=aim)
    assert within(violations)
    assert motions[0].duration == given.duration
    assert stage.state(motions, derivatives=False).cost < 0.9


@pytest.mark.parametrize("seed", range(4))
def test_gripping_and_leaving_a_payload_gives_no_energy_to_vibration(seed: int) -> None:
    """Of a robot without damping whose motors stand still, for drawn poses, payloads and pauses: what swings never grows from cycle to cycle."""
    random = np.random.default_rng(seed)
    scene = load_scene("barnard2012-6kg").replace({"effects.damping": {"kind": "none"}})
    masses, cases = random.uniform(0.1, 8.0, (2, 5)), np.arange(5)
    pose = plan(scene).joints.evaluate(random.uniform(0.0, 0.43), 0, "left")[0, 0]
    models = [VariantModel([RobotVariant(scene, {"payload.mass": float(m)}) for m in each]) for each in masses]
    rests = [[model.rest(pose)] for model in models]
    left = LeftVibration(rests, rests, random.uniform(0.01, 0.3, 2).tolist(), [cases, cases])
    n = rests[0][0].elastic.shape[1]
    still = np.broadcast_to(np.eye(2 * n).reshape(2, n, 2, n), (5, 2, n, 2, n))
    left.renew([still, still])
    assert (left.growth < 1.0 + 1e-6).all()
    assert left.growth.min() > 0.1
