"""Optimal control: exact derivatives, collocation of the elastic motion, closed forms of fastest motions, limits that hold."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.reference_design.control_rows import Area, ReferenceLimits, RobotLimits, modal_displacements
from flexfmu.model.reference_design.joint_spline import JointSpline, fitted
from flexfmu.model.reference_design.optimal_control import (
    Aim,
    MotionProgramme,
    OptimalMotion,
    optimal_motions,
    stretched,
)
from flexfmu.model.reference_design.transcription import CollocationGrid, Transcription, transcribed
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

SCENE = load_scene("barnard2012-6kg").replace({"effects.proximal_bending": 1, "effects.distal_axial": 0})
RIGID = SCENE.replace({"effects.proximal_bending": 0})

GRIDS = CollocationGrid(16, 16, 3), CollocationGrid(16, 16, 4)
FINER = CollocationGrid(24, 24, 3), CollocationGrid(24, 24, 5)
WIDE = 1e6


def _given(scene: Scene, splines: int = 16) -> JointSpline:
    return fitted(plan(scene).joints, splines)


def _area(scene: Scene, *regions: float) -> Area:
    """A large rectangle, less what is above (in y) the heights of the regions."""
    start = np.array(scene.trajectory.start)
    distances = tuple(lambda points, y=y: y - points[:, 1] for y in regions)
    return Area(start, np.eye(2), np.array([-0.05, -0.1]), np.array([0.4, 0.05]), distances)


def _torque(scene: Scene, spline: JointSpline) -> RealArray:
    """Largest torques (2,) [N m] on a fine grid."""
    equations = transcribed(scene, spline, CollocationGrid(spline.intervals, 64, 4))
    joints = equations.joints(spline)
    return np.asarray(abs(equations.values(equations.arguments(joints, equations.settled(joints)))[-2:]).max(axis=1))


@pytest.mark.parametrize("stages", [2, 3, 5])
def test_the_grid_integrates_and_differentiates_polynomials(stages: int) -> None:
    """Up to the degree that Radau IIA is exact for, from rest."""
    grid = CollocationGrid(16, 3, stages)
    t = grid.points
    assert grid.weights @ t ** (2 * stages - 2) == pytest.approx(1 / (2 * stages - 1), rel=1e-13)
    values, first, second = grid.derivatives
    motion = np.concatenate([[0.0], t**2])
    assert values @ motion == pytest.approx(t**2)
    assert first @ motion == pytest.approx(2 * t)
    assert second @ motion == pytest.approx(2 * np.ones(len(t)))


def test_the_elastic_motion_converges_with_the_order_of_the_method() -> None:
    """Half the step, a thirty-second of the error, or a sixteenth as stiff coordinates converge more slowly."""
    spline = _given(SCENE)

    def torque(intervals: int) -> RealArray:
        equations = transcribed(SCENE, spline, CollocationGrid(16, intervals, 3))
        joints = equations.joints(spline)
        z = equations.arguments(joints, equations.settled(joints))
        assert abs(equations.values(z)[: equations.n]).max() < 1e-6
        return equations.values(z)[-2:, intervals * 3 // 2 - 1]

    exact = torque(512)
    errors = [abs(torque(intervals) - exact).max() for intervals in (64, 128)]
    assert errors[0] / errors[1] > 15
    assert errors[1] < 0.01


@pytest.fixture(scope="module", params=["time", "energy", "torque"])
def programme(request: pytest.FixtureRequest) -> tuple[MotionProgramme, RealArray]:
    """A small programme with two robots and a region, and a point near its start."""
    aim: Aim = request.param
    spline = stretched(_given(SCENE, 8), ReferenceLimits(WIDE, WIDE, WIDE))
    other = SCENE.replace({"payload.mass": 4.0})
    robots = [RobotLimits(SCENE, np.array([70.0, 71.0])), RobotLimits(other, np.array([50.0, 51.0]))]
    equations = [transcribed(robot.scene, spline, CollocationGrid(8, 4, 2)) for robot in robots]
    limits = ReferenceLimits(20.0, 500.0, 4e4)
    found = MotionProgramme(equations, robots, limits, _area(SCENE, 0.35), spline, aim)
    rng = np.random.default_rng(1)
    x = found.start(spline)
    return found, x + 1e-2 * rng.normal(size=x.size) * np.maximum(abs(x), 1e-2)


def test_derivatives_of_the_programme_are_exact(programme: tuple[MotionProgramme, RealArray]) -> None:
    """Jacobian and Hessian of the Lagrangian in a random direction, against differences."""
    found, x = programme
    rng = np.random.default_rng(2)
    direction = rng.normal(size=x.size) * np.maximum(abs(x), 1e-2)
    jacobian, hessian = found.derivatives["jac_g"], found.derivatives["hess_lag"]
    step = 1e-5
    ahead, behind = (jacobian(x + sign * step * direction, []) for sign in (1, -1))
    slope = ((ahead[0] - behind[0]) / (2 * step)).full().ravel()
    exact = (jacobian(x, [])[1] @ direction).full().ravel()
    assert exact == pytest.approx(slope, rel=1e-5, abs=1e-6 * abs(slope).max())
    # the gradient of multipliers · g + weight · f
    mu, weight = rng.normal(size=len(exact)), 0.7
    gradient = found.gradient
    change = (ahead[1] - behind[1]).T @ mu + weight * (
        gradient(x + step * direction) - gradient(x - step * direction)
    ).T
    upper = hessian(x, [], weight, mu).full()
    full = np.triu(upper) + np.triu(upper, 1).T
    found_change = (change / (2 * step)).full().ravel()
    assert full @ direction == pytest.approx(found_change, rel=1e-4, abs=1e-5 * abs(found_change).max())


def _fastest(limits: ReferenceLimits) -> JointSpline:
    """The fastest motion of a rigid robot within limits of its references alone."""
    robot = RobotLimits(RIGID, np.full(2, WIDE))
    area = Area(np.zeros(2), np.eye(2), np.full(2, -1.0), np.full(2, 1.0))
    *_, last = optimal_motions([robot], limits, area, _given(RIGID), grids=GRIDS)
    assert last.converged
    return last.spline


@pytest.mark.parametrize("speed", [WIDE, 4.0])
def test_limited_acceleration_gives_the_fastest_motion_from_rest_to_rest(speed: float) -> None:
    """Bang-bang, T = 2 √(D / a), or with a limited speed T = D / v + v / a; no spline is faster, and one of 16 intervals is near."""
    limits = ReferenceLimits(speed, 100.0, WIDE)
    spline = _fastest(limits)
    way = abs(np.diff(spline.coefficients[[0, -1]], axis=0)).max()
    fastest = 2 * np.sqrt(way / 100.0) if speed == WIDE else way / speed + speed / 100.0
    assert 0.999 * fastest <= spline.duration < 1.12 * fastest
    assert max(limits.used(spline)) < 1.001


def test_limited_jerk_gives_the_fastest_motion_from_rest_to_rest() -> None:
    """Four phases of constant jerk, T = (32 D / j)^(1/3)."""
    spline = _fastest(ReferenceLimits(WIDE, WIDE, 5000.0))
    way = abs(np.diff(spline.coefficients[[0, -1]], axis=0)).max()
    fastest = (32 * way / 5000.0) ** (1 / 3)
    assert 0.999 * fastest <= spline.duration < 1.12 * fastest


@pytest.fixture(scope="module")
def optimum() -> tuple[RobotLimits, ReferenceLimits, list[OptimalMotion]]:
    """The fastest motion of a robot with two elastic coordinates."""
    given = _given(SCENE, 24)
    used = ReferenceLimits(1.0, 1.0, 1.0).used(given)
    limits = ReferenceLimits(*(2.5 * each for each in used))
    robot = RobotLimits(SCENE, _torque(SCENE, given))
    return robot, limits, list(optimal_motions([robot], limits, _area(SCENE, 0.325), given, grids=FINER))


@pytest.mark.slow
def test_limits_hold_between_the_points(optimum: tuple[RobotLimits, ReferenceLimits, list[OptimalMotion]]) -> None:
    """Torques on another grid, references everywhere; much faster than the given motion at the same torques."""
    robot, limits, motions = optimum
    last = motions[-1].spline
    assert last.duration < 0.55 * SCENE.trajectory.duration
    assert (_torque(SCENE, last) / robot.torque).max() < 1.002
    assert max(limits.used(last)) < 1.001
    assert all(motion.converged for motion in motions)


def test_no_mode_vibrates_at_the_end(optimum: tuple[RobotLimits, ReferenceLimits, list[OptimalMotion]]) -> None:
    """On a finer grid: displacement and rate / frequency of each mode, as displacements of the end effector."""
    robot, _, motions = optimum
    last = motions[-1].spline
    equations = transcribed(SCENE, last, CollocationGrid(24, 72, 4))
    joints, n = equations.joints(last), equations.n
    z = equations.arguments(joints, equations.settled(joints))[:, -1]
    modal, frequencies = modal_displacements(SCENE, equations.ends[1], equations.rest[1])
    place, rate = modal @ (z[:n] - equations.rest[1]), modal @ z[n : 2 * n] / last.duration / frequencies
    assert np.hypot(place, rate).sum() < robot.residual


def test_the_least_effort_at_a_given_duration() -> None:
    """Root mean square torque and energy of the rigid robot fall below those of the given motion in the same time."""
    given = _given(RIGID)
    robot, limits = RobotLimits(RIGID, 1.2 * _torque(RIGID, given)), ReferenceLimits(WIDE, WIDE, WIDE)

    def efforts(spline: JointSpline) -> tuple[float, float]:
        equations = Transcription(RIGID, spline.coefficients[[0, -1]], np.zeros(0), GRIDS[1])
        joints = equations.joints(spline)
        torque = equations.values(equations.arguments(joints, np.zeros(0)))[-2:]
        power = torque * spline.evaluate(GRIDS[1].points, 1)[1].T
        weights = GRIDS[1].weights
        return float(np.sqrt((torque**2).sum(axis=0) @ weights)), float(np.maximum(power, 0.0).sum(axis=0) @ weights)

    usual = efforts(given)
    for index, aim in enumerate(("rms_torque", "energy")):
        *_, last = optimal_motions([robot], limits, _area(RIGID), given, aim, given.duration, GRIDS)
        assert last.spline.duration == pytest.approx(given.duration, rel=1e-12)
        assert efforts(last.spline)[index] < 0.9 * usual[index]


def test_a_motion_is_stretched_to_its_limits() -> None:
    """To 1.1 of its duration, or to the cube root of an excess of jerk."""
    given = _given(RIGID)
    jerk = ReferenceLimits(1.0, 1.0, 1.0).used(given)[2]
    slower = stretched(given, ReferenceLimits(WIDE, WIDE, jerk / 8))
    assert slower.duration == pytest.approx(2 * given.duration)
    assert stretched(given, ReferenceLimits(WIDE, WIDE, WIDE)).duration == pytest.approx(1.1 * given.duration)
