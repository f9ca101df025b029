"""Loads of motors behind gears against closed forms, and the inertia of the load against the model."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_build import depends_on, scene_key
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.cosim.metrics.motors import MotorLoad, divided, largest_load_inertia, motor_loads, multiplied
from flexfmu.cosim.metrics.segments import bernstein_basis
from flexfmu.cosim.reports.plots import motor_plots
from flexfmu.cosim.reports.summary import motor_table, summarise
from flexfmu.model.kinematics import load_mass_matrix
from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.motor import Motor

MakeRun = Callable[..., Run]
OMEGA = 2.0 * math.pi
SECTION = {"continuous_torque": 1.0, "peak_torque": 3.0, "maximum_speed": 300.0}
MOTOR = Motor(**SECTION, gear_ratio=10.0, gear_efficiency=0.8)


def waves(offset: float, amplitude: float, shift: int = 0, steps: int = 500) -> Column:
    """A constant plus a derivative of a sine of one period, over one period of 1 s."""
    phase = OMEGA * np.linspace(0.0, 1.0, steps + 1)
    column = [amplitude * OMEGA**k * np.sin(phase + 0.5 * math.pi * k) for k in range(shift, shift + 3)]
    return Column("", column[0] + offset, *column[1:])


def loaded(
    run: Run, torque: tuple[float, ...], speed: tuple[float, float], motor: Motor = MOTOR, steps: int = 500
) -> MotorLoad:
    """The load of motor 1, whose torque and speed are `waves`."""
    columns = {}
    for joint in ("joint1", "joint2"):
        columns[f"{joint}.torque"] = waves(*torque, steps=steps)  # type: ignore[arg-type]
        columns[f"{joint}.reference.velocity"] = waves(*speed, steps=steps)
        columns[f"{joint}.reference.acceleration"] = waves(0.0, speed[1], 1, steps=steps)
    return motor_loads(replace(run, recording=Recording(np.linspace(0.0, 1.0, steps + 1), columns)), motor)[0]


@pytest.fixture(scope="module")
def run(make_run: MakeRun) -> Run:
    """A planned motion, whose recording the tests replace."""
    return make_run()


@pytest.mark.parametrize(("speed", "factor"), [(4.0, 1.0 / 0.8), (-4.0, 0.8), (0.0, 1.0)])
def test_gear_losses_follow_the_power(run: Run, speed: float, factor: float) -> None:
    """A constant torque of 20 N.m behind a gear of 10: losses add to it when motoring, and help when the load drives."""
    load = loaded(run, (20.0, 0.0), (speed, 0.0))
    peak, rms, fast = load.margins
    assert peak.value == pytest.approx(2.0 * factor, rel=1e-12)
    assert rms.value == pytest.approx(2.0 * factor, rel=1e-12)
    assert fast.value == pytest.approx(abs(speed) * 10.0, rel=1e-12, abs=1e-12)
    assert float(load.power[0]) == pytest.approx(20.0 * speed * factor)


def test_sine_torque_at_constant_speed(run: Run) -> None:
    """Half a period motors with 1/η, half of it is driven with η; RMS of each half is peak / √2."""
    load = loaded(run, (0.0, 30.0), (5.0, 0.0))
    assert load.margins[0].value == pytest.approx(3.0 / 0.8, rel=1e-9)
    assert load.margins[0].time == pytest.approx(0.25, abs=2e-4)
    assert load.margins[1].value == pytest.approx(3.0 / math.sqrt(2.0) * math.sqrt(0.5 * (0.8**-2 + 0.8**2)), rel=1e-9)
    # a constant torque and a sine of speed: the losses turn round with the speed, within a step too
    exact = 2.0 * math.sqrt(0.5 * (0.8**-2 + 0.8**2))
    for steps in (500, 499):
        assert loaded(run, (20.0, 0.0), (0.0, 5.0), steps=steps).margins[1].value == pytest.approx(exact, rel=1e-9)
    # without losses in the gear it is the sine's
    perfect = loaded(run, (0.0, 30.0), (5.0, 0.0), replace(MOTOR, gear_efficiency=1.0))
    assert perfect.margins[1].value == pytest.approx(3.0 / math.sqrt(2.0), rel=1e-10)


def test_motor_inertia_counts_once(make_run: MakeRun) -> None:
    """The scene's `effects.motor_inertia`, which is in the torque already, is taken out before the rotor's is put in."""
    motor = replace(MOTOR, rotor_inertia=2e-3, gear_efficiency=1.0)
    included = 2e-3 * 10.0**2
    run = make_run(changes={"effects.motor_inertia": included})
    # without a load the motor accelerates its rotor alone: J i q̈
    load = loaded(run, (0.0, included * 5.0, 1), (0.0, 5.0), motor)
    assert load.margins[1].value == pytest.approx(2e-3 * 10.0 * 5.0 * OMEGA / math.sqrt(2.0), rel=1e-9)
    assert load.margins[0].value == pytest.approx(2e-3 * 10.0 * 5.0 * OMEGA, rel=1e-9)


def test_copper_losses(run: Run) -> None:
    """Loss R (T/k)², and the supply's power is mechanical power plus loss."""
    motor = replace(MOTOR, gear_efficiency=1.0, torque_constant=0.5, winding_resistance=2.0)
    load = loaded(run, (10.0, 20.0), (5.0, 0.0), motor)
    square = 1.0 + 2.0**2 / 2.0
    assert load.rms_current == pytest.approx(math.sqrt(square) / 0.5, rel=1e-10)
    assert load.peak_current == pytest.approx(3.0 / 0.5, rel=1e-10)
    assert load.copper_loss == pytest.approx(2.0 * square / 0.5**2, rel=1e-10)
    assert load.mean_electrical_power == pytest.approx(1.0 * 50.0 + 2.0 * square / 0.25, rel=1e-10)
    assert load.peak_electrical_power == pytest.approx(3.0 * 50.0 + 2.0 * 9.0 / 0.25, rel=1e-10)
    without = loaded(run, (10.0, 20.0), (5.0, 0.0))
    assert without.copper_loss is without.rms_current is without.mean_electrical_power is None


def test_which_limit_is_hit(run: Run) -> None:
    """A sentence for each limit that is exceeded, with instant and pose; a limit that is just reached isn't exceeded."""
    load = loaded(run, (20.0, 0.0), (-4.0, 0.0), replace(MOTOR, gear_efficiency=1.0, peak_torque=2.0))
    assert load.critical.name == "RMS torque"
    assert list(load.exceeded) == ["motor 1: RMS torque of 2 N·m exceeds the limit of 1 N·m by 100 %"]
    load = loaded(run, (0.0, 30.0), (50.0, 0.0), replace(MOTOR, name="small", maximum_speed=400.0))
    first, second, third = load.exceeded
    assert first.startswith("motor 1 (small): peak torque of 3.75 N·m at 0.25")
    assert "end effector at (0." in first
    assert "RMS torque" in second
    assert "speed of 500 rad/s" in third


def test_load_inertia_is_that_of_the_model(make_run: MakeRun) -> None:
    """The mass matrix is what unit accelerations at standstill need as torques, without gravity."""
    changes = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "effects.gravity": [0.0, 0.0]}
    changes |= {"effects.damping": "none", "payload.inertia": 0.02, "mechanism.distal.inner_diameter": 0.02}
    run = make_run(changes=changes)
    model, empty = numeric_model(run.scene), np.zeros((0, 1))
    joints = run.plan.joints.evaluate(np.array([0.0, 0.1, 0.2]), 0)[0]
    matrices = load_mass_matrix(run.scene, joints)
    for pose, matrix in zip(joints, matrices, strict=True):
        for joint in (0, 1):
            motion = np.concatenate([pose, np.zeros(2), np.eye(2)[joint]])
            torques = np.asarray(model.motion(empty, empty, empty, motion)[3]).ravel()
            np.testing.assert_allclose(matrix[:, joint], torques, rtol=1e-12)
    assert largest_load_inertia(run)[0] >= matrices[:, 0, 0].max()


def test_inertia_ratio_is_a_metric_of_scenes_with_motors(make_run: MakeRun) -> None:
    """Load inertia over rotor inertia times the square of the ratio."""
    run = make_run(changes={"motor": {**SECTION, "rotor_inertia": [1e-4, 2e-4], "gear_ratio": 20}})
    found, load = metrics_of(run), largest_load_inertia(run)
    assert found["inertia_ratio_1"] == pytest.approx(load[0] / (1e-4 * 400.0))
    assert found["inertia_ratio_2"] == pytest.approx(load[1] / (2e-4 * 400.0))
    assert "inertia_ratio_1" not in metrics_of(make_run())
    assert metrics_of(make_run(changes={"motor": SECTION}))["inertia_ratio_1"] is None


def test_summary_and_pictures(make_run: MakeRun) -> None:
    """With motors the summary has a table, each motor a picture; without, there is nothing new."""
    run = make_run(changes={"motor": {**SECTION, "torque_constant": 0.5}})
    motors = summarise(run, {})["motors"]
    assert [motor["joint"] for motor in motors] == [1, 2]
    assert motors[0]["exceeded"]
    rows = {name: texts for name, *texts in motor_table(motors).rows}
    assert rows["speed"][0].endswith("rad/s, 3 %")
    assert rows["peak current"][0].endswith(" A")
    assert "copper loss, mean" not in rows
    assert [plot.key for plot in motor_plots(run)] == ["motor-1", "motor-2", "motor-power"]
    assert list(motor_plots(make_run())) == []
    assert "motors" not in summarise(make_run(), {})


@pytest.mark.parametrize("seed", range(5))
def test_pieces_keep_their_signs(seed: int) -> None:
    """Cut at their zeros, polynomials are the same and of one sign on each piece; products are those of the values."""
    random = np.random.default_rng(seed)
    start, control = np.arange(20.0), random.normal(size=(6, 20, 3))
    control[..., 0] += np.linspace(-3.0, 3.0, 20)
    begin, duration, pieces = divided(start, np.ones(20), control)
    assert duration.sum() == pytest.approx(20.0)
    np.testing.assert_allclose(begin[1:], begin[:-1] + duration[:-1], atol=1e-12)
    basis = bernstein_basis(np.linspace(0.0, 1.0, 9), 5)
    values = np.tensordot(basis, pieces, axes=1)
    inner = np.sign(values[1:-1, :, :2])
    np.testing.assert_array_equal(inner, np.broadcast_to(inner[3], inner.shape))
    # the same polynomials at the same times
    for piece in range(begin.size):
        segment = min(int(begin[piece] + 0.5 * duration[piece]), 19)
        theta: RealArray = begin[piece] - segment + np.linspace(0.0, 1.0, 9) * duration[piece]
        np.testing.assert_allclose(values[:, piece], bernstein_basis(theta, 5) @ control[:, segment], atol=1e-12)
    product = bernstein_basis(np.linspace(0.0, 1.0, 9), 10) @ multiplied(pieces[..., 0], pieces[..., 1])
    np.testing.assert_allclose(product, values[..., 0] * values[..., 1], atol=1e-12)


def test_motors_and_strengths_do_not_change_the_fmu() -> None:
    """Variants of them share one FMU."""
    scene = load_scene("barnard2012-6kg")
    other = scene.replace({"motor": SECTION, "mechanism.material.yield_strength": 2e8})
    assert scene_key(other) == scene_key(scene)
    assert not depends_on("motor.gear_ratio")
    assert not depends_on("mechanism.material.yield_strength")
    assert depends_on("mechanism.material.density")


@pytest.mark.parametrize("seed", range(8))
def test_a_motor_gets_no_hotter_than_its_bound(run: Run, seed: int) -> None:
    """The largest temperature of a repeated run lies between the mean heat and its bound; it is that of a lag over many cycles."""
    random = np.random.default_rng(seed)
    motor = replace(MOTOR, thermal_time_constant=float(random.choice([0.05, 0.3, 2.0, 60.0])))
    load = loaded(run, (*random.normal(0.0, 3.0, 2),), (4.0, 0.0), motor)
    use = {margin.name: margin.use for margin in load.margins}
    assert (
        use["RMS torque"] ** 2 * (1.0 - 1e-9)
        <= use["heat"]
        <= use["RMS torque"] ** 2 * motor.heating(1.0)[0] * (1.0 + 1e-9)
    )
    # the lag, step by step
    heat, keep = 0.0, np.exp(-np.diff(load.time) / motor.thermal_time_constant)  # type: ignore[operator]
    squares = 0.5 * (load.torque[1:] ** 2 + load.torque[:-1] ** 2) / motor.continuous_torque**2
    for _ in range(max(3, round(12.0 * motor.thermal_time_constant))):  # type: ignore[operator]
        largest = heat
        for each, square in zip(keep.tolist(), squares.tolist(), strict=True):
            heat = each * heat + (1.0 - each) * square
            largest = max(largest, heat)
    assert use["heat"] == pytest.approx(largest, rel=2e-3)


def test_the_torque_at_a_speed_is_that_of_the_curve(run: Run) -> None:
    motor = replace(MOTOR, torque_speed_curve=((0.0, 3.0), (20.0, 2.0), (60.0, 1.0)))
    load = loaded(run, (8.0, 0.0), (4.0, 0.0), motor)
    use = {margin.name: margin.use for margin in load.margins}
    # 1 N m at the shaft at 40 rad/s, where 1.5 N m are allowed
    assert use["torque at speed"] == pytest.approx(1.0 / 1.5, rel=1e-9)
    torque, slope = motor.largest_torque(np.array([-40.0, 10.0, 90.0]))
    assert torque.tolist() == pytest.approx([1.5, 2.5, 1.0])
    assert slope.tolist() == pytest.approx([0.025, -0.05, 0.0])


@pytest.mark.parametrize(
    ("curve", "said"),
    [
        ([[0.0, 3.0]], "two or more points"),
        ([[10.0, 3.0], [5.0, 2.0]], "ascending"),
        ("flat", "a list of"),
        ([[0, 0], [1, 1]], "above 0"),
    ],
)
def test_wrong_curves_are_told(curve: object, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        load_scene("barnard2012-6kg").replace({"motor": {**SECTION, "torque_speed_curve": curve}})
