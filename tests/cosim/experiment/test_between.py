"""What stands between motion, controller and robot: shapers in their three ways, every imperfection, foreign slaves; and recording apart from
communicating: fewer instants, instants between communication points, chosen steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import pd
from python_slave import SampledSlave

import flexfmu
from flexfmu.cosim.control.shapers import Shaper
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene, run_scene
from flexfmu.cosim.many.variants import run_variants
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.summary import summarise
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.shapers.designs import zero_vibration
from flexfmu.trajectories.shapers.sequence import Oscillator

MODE = {"frequency": 58.0, "ratio": 0.02}
COMPUTED_TORQUE = {"kind": "computed-torque", "proportional": 3600.0, "derivative": 120.0, "sample_time": 1e-3}
SIGNALS = ("torque", "position", "velocity", "reference")


def at_samples(run: Run, name: str, sample_time: float) -> np.ndarray:
    """A signal right after its sample instants."""
    time = run.recording.time
    right = np.append(np.diff(time) > 0.0, True)
    number = time / sample_time
    return np.asarray(run.recording[name].values[right & (abs(number - np.round(number)) < 1e-6)])


@pytest.fixture(scope="module")
def motion_driven(robot: Scene) -> Scene:
    """A quick motion that leaves vibration."""
    return robot.replace({"cosimulation.drive": "motion", "trajectory.duration": 0.35})


def residual(run: Run) -> float:
    """Residual vibration [m]."""
    value = measure_run(run, companions=0)["residual_vibration_amplitude"].value
    assert value is not None
    return value


def test_shapers_in_a_motion_driven_scene(motion_driven: Scene) -> None:
    """On the joints, analytically and sampled, a shaper cancels the vibration; the run is longer by its duration, and the
    summary says by how much and how far the path is left."""
    unshaped = run_scene(motion_driven)
    shaper = {"kind": "zvd"}
    joints = run_scene(motion_driven.replace({"shaper": [shaper]}))
    sampled = run_scene(motion_driven.replace({"shaper": [shaper | {"apply": "sampled", "sample_time": 2.5e-4}]}))
    assert residual(joints) < 0.1 * residual(unshaped)
    assert residual(sampled) == pytest.approx(residual(joints), rel=0.1)
    shaping = summarise(joints, measure_run(joints, companions=0))["shaping"]
    assert shaping["added_time"] == pytest.approx(joints.plan.duration - 0.35)
    assert 1e-4 < shaping["path_deviation"] < 2e-3
    assert "shaping" not in summarise(unshaped, measure_run(unshaped, companions=0))


def test_a_shaper_along_the_path_keeps_it(motion_driven: Scene) -> None:
    """The rigid robot's end effector stays on its path."""
    scene = motion_driven.replace({"shaper": [{"kind": "zv", "modes": [MODE], "apply": "path"}]})
    loop = loop_of(scene)

    assert loop.motion.deviation < 1e-9
    assert loop.motion.duration > 0.35


def test_sampled_references_are_shaped_by_the_split_sequence(motion_driven: Scene) -> None:
    """The sampled shaper's positions at its instants are those of the trajectory shaped by the split impulses, exactly:
    that is the plan that the metrics compare with."""
    sequence = zero_vibration(Oscillator(**MODE), 1)
    run = flexfmu.run(motion_driven, shapers=[Shaper(sequence, "sampled", sample_time=1e-3)])
    shaped = at_samples(run, "joint1.reference.position", 1e-3)
    planned = run.plan.joints.evaluate(1e-3 * np.arange(shaped.size), 0)[0, :, 0]
    np.testing.assert_allclose(shaped, planned, rtol=0.0, atol=1e-12)
    assert "trajectory.joint1.reference.position" in run.recording.columns


def test_two_shapers_act_one_after_the_other(motion_driven: Scene) -> None:
    """Their durations add up."""
    modes = [{"kind": "zv", "modes": [{"frequency": frequency}]} for frequency in (50.0, 100.0)]
    assert loop_of(motion_driven.replace({"shaper": modes})).motion.duration == pytest.approx(0.35 + 0.01 + 0.005)


def test_more_modes_than_there_are_is_an_error(motion_driven: Scene) -> None:
    """A rigid robot has nothing to shape for."""
    rigid = motion_driven.replace(
        {"effects.proximal_bending": 0, "effects.distal_axial": 0, "shaper": [{"kind": "zv"}]}
    )
    with pytest.raises(InputError, match=r"`shaper\.mode_count` = 1, but .* has 0 modes"):
        run_scene(rigid)


KINDS: dict[str, dict[str, Any]] = {
    "saturation": {"limit": 1e3},
    "rate-limit": {"rate": 1e9},
    "delay": {"time": 0.0},
    "quantisation": {"resolution": 1e-12},
    "noise": {"standard_deviation": 0.0},
    "jitter": {"time": 1e-9},
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_imperfection_can_act_on_every_signal(robot: Scene, kind: str) -> None:
    """Imperfections that are next to nothing change next to nothing, wherever they act."""
    short = robot.replace({"trajectory.dwell": 0.0, "cosimulation.step": 1e-3, "controller": [COMPUTED_TORQUE]})
    run = run_scene(
        short.replace({"imperfection": [{"kind": kind, "signal": each, **KINDS[kind]} for each in SIGNALS]})
    )
    assert run.completed
    assert [each.sample_time for each in run.slaves[-len(SIGNALS) :]] == [1e-3] * len(SIGNALS)
    assert (measure_run(run, companions=0)["peak_tracking_error_1"].value or 1.0) < 1e-3


def test_delays_and_lags_begin_with_the_static_torque(robot: Scene) -> None:
    """Before anything has passed a delay line or a lag, the motors hold the robot: it doesn't drop at the start."""
    late = [
        {"kind": "delay", "time": 5e-4, "sample_time": 2.5e-4},
        {"kind": "lag", "time_constant": 1e-4, "sample_time": 1e-4},
    ]
    scene = robot.replace({"trajectory.dwell": 0.0, "controller": [COMPUTED_TORQUE], "imperfection": late})
    run = run_scene(scene)
    angle = run.recording["joint1.position"].values[run.recording.time < 2e-3]
    assert abs(angle - angle[0]).max() < 1e-7
    assert "lag.joint1.torque" in run.recording.columns


def test_an_exported_controller(robot: Scene, tmp_path: Path) -> None:
    """The FMU of a controller moves the robot as its Python twin does: from the scene file, with its parameters, and by its path,
    which stands for the block that it was exported from, sampled at the same instants, no step late."""
    short = robot.replace({"trajectory.dwell": 0.0, "cosimulation.step": 1e-3})
    path = build_fmu(pd(5e3, 100.0, sample_time=1e-3), tmp_path / "mine.fmu").path
    gains = {f"joint{joint}.proportional_gain": 1e4 for joint in (1, 2)}
    section = {"kind": "fmu", "path": str(path), "name": "mine", "parameters": gains}
    for gain, exported in (
        (1e4, run_scene(short.replace({"controller": [section]}))),
        (5e3, flexfmu.run(short, controllers=[path])),
    ):
        assert {each.name: each.sample_time for each in exported.slaves}["mine"] == 1e-3
        assert {each.seconds for each in exported.delays} == {0.0}
        python = flexfmu.run(short, controllers=[pd(gain, 100.0, sample_time=1e-3)]).recording
        for name in ("joint1.position", "end_effector.position.y"):
            twin = np.interp(exported.recording.time, python.time, python[name].values)
            np.testing.assert_allclose(exported.recording[name].values, twin, rtol=0.0, atol=1e-12)


class Constant(SampledSlave):
    """A slave with foreign names that outputs what it is made with."""

    name = "foreign"
    sample_time = 1e-3
    variables = (SlaveVariable("in", "input"), SlaveVariable("out", "output"))

    def __init__(self, value: float) -> None:
        super().__init__()
        self.memory[1] = value

    def sample(self, time: float) -> None: ...


def test_foreign_names_are_connected_explicitly(robot: Scene) -> None:
    """A section's `connect` names its own inputs, or the robot's with the source behind them."""
    section = {
        "kind": "python",
        "source": f"{__name__}:Constant",
        "arguments": {"value": -15.0},
        "connect": {"in": "joint1.position", "plant.joint1.torque": "foreign.out"},
    }
    loop = loop_of(robot.replace({"controller": [section]}))
    assert loop.connect == {"foreign.in": "joint1.position", "plant.joint1.torque": "foreign.out"}
    run = flexfmu.run(robot.replace({"trajectory.dwell": 0.0}), controllers=[Constant(-15.0)], connect=loop.connect)
    assert run.recording["joint1.torque"].values[-1] == -15.0


BROKEN = {
    "broken_class": "class Mine:\n    def __init__(self):\n        raise KeyError('gain')\n",
    "broken_module": "1 / 0\n",
    "broken_syntax": "def damper(:\n",
}


@pytest.mark.parametrize(("source", "message"), [
    ("nowhere:Thing", "can't import nowhere"),
    ("math:thing", "module math has no 'thing'"),
    ("math:sqrt", "math:sqrt\\(\\)"),
    ("math:pi", "a float can't be a slave"),
    ("broken_class:Mine", r"Mine\(\): KeyError: 'gain' \(.*broken_class\.py, line 3\)"),
    ("broken_module:Mine", r"can't import broken_module: ZeroDivisionError: .* \(.*broken_module\.py, line 1\)"),
    ("broken_syntax:Mine", r"broken_syntax isn't valid Python: .*line 1"),
])  # fmt: skip
def test_own_sources_that_fail_are_named(robot: Scene, tmp_path: Path, source: str, message: str) -> None:
    """Module, name, call and kind are checked, each with its sentence; what a user's file raises is told with its line."""
    for name, text in BROKEN.items():
        (tmp_path / f"{name}.py").write_text(text)
    section = {"kind": "python", "source": source, "folder": str(tmp_path)}
    with pytest.raises(InputError, match=message):
        loop_of(robot.replace({"controller": [section]}))


def test_state_feedback_from_the_scene_file(robot: Scene) -> None:
    """LQG weights of the file make a controller that arrives."""
    lqg = run_scene(robot.replace({"controller": [{"kind": "state-feedback", "sample_time": 1e-3}]}))
    end = abs(lqg.recording["joint1.position"].values[-1] - lqg.recording["joint1.reference.position"].values[-1])
    assert lqg.completed
    assert end < 1e-3


SMALL: dict[str, Any] = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "trajectory.dwell": 0.05}
PD: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.01,
    "cosimulation.step": 5e-4,
    "controller": [{"kind": "pd", "proportional": 1e3, "derivative": 10.0, "sample_time": 1e-3}],
}
MODAL = "der("


@pytest.fixture(scope="module")
def small() -> Scene:
    """Two elastic coordinates."""
    return load_scene("barnard2012-6kg").replace(SMALL)


def same(found: Recording, whole: Recording) -> bool:
    """Whether all instants found are in the other recording, with the same bits."""
    chosen = np.isin(whole.time, found.time)
    return np.array_equal(whole.time[chosen], found.time) and all(
        np.array_equal(whole[name].values[chosen], column.values) for name, column in found.columns.items()
    )


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, PD])
def test_every_nth_point(small: Scene, changes: dict[str, Any]) -> None:
    """An interval of so many communication steps records the same bits at fewer instants: its multiples, jumps of the motion
    and the end; with controllers not each of their sample instants."""
    scene = small.replace({"cosimulation.step": 5e-4} | changes)
    whole = run_scene(scene).recording
    some = run_scene(scene, record=Selection(None, 2, 2e-3))
    assert some.completed
    assert same(some.recording, whole)
    regular = np.round(some.recording.time / 2e-3) * 2e-3
    others = some.recording.time[abs(some.recording.time - regular) > 1e-9]
    assert {*others.tolist()} <= {*some.plan.joints.breakpoints, some.plan.stop_time}
    assert np.unique(some.recording.time).size < 0.3 * np.unique(whole.time).size


def test_instants_between_points(small: Scene) -> None:
    """An interval below the step, or beside it, gives values between the points, to the tolerance."""
    scene = small.replace({"cosimulation.step": 1.5e-3, "cosimulation.tolerance": 1e-8})
    fine = run_scene(scene, communication_step=5e-4, tolerance=1e-10).recording
    between = run_scene(scene, record=Selection(["joint1.torque", "end_effector.position.x"], 0, 5e-4)).recording
    assert np.array_equal(between.time, fine.time)
    for name, column in between.columns.items():
        expected = fine[name].values
        # right after a jump the step spans several periods of the fastest mode
        assert np.median(abs(column.values - expected)) < 1e-8 * abs(expected).max()
        assert column.first is None


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_chosen_steps_keep_the_tolerance(small: Scene, tolerance: float) -> None:
    """At every recorded instant, of all signals but those of the modes' rates, for the scene's payload and another one."""
    scene = small.replace({"cosimulation.step": "auto", "cosimulation.tolerance": tolerance})
    prepared = PreparedScene(scene)
    for parameters in ({}, {"payload.mass": 2.0}):
        found = prepared.run(parameters)
        exact = run_scene(scene, communication_step=1e-3, tolerance=1e-11, parameters=parameters).recording
        assert found.completed
        assert np.array_equal(found.recording.time, exact.time)
        for name, column in found.recording.columns.items():
            expected = exact[name].values
            if not name.startswith(MODAL):
                assert abs(column.values - expected).max() <= tolerance * abs(expected).max(), name


def test_chosen_steps_are_the_same_whatever_ran_before(small: Scene) -> None:
    """The steps depend on scene and parameters, not on the runs before; neither on what the recording is for."""
    scene = small.replace({"cosimulation.step": "auto"})
    prepared = PreparedScene(scene)
    first, changed, again = (prepared.run(each).recording for each in ({}, {"payload.mass": 0.1}, {}))
    assert same(first, again)
    assert same(PreparedScene(scene).run({"payload.mass": 0.1}).recording, changed)


def test_keys_of_the_scene(small: Scene) -> None:
    """`record`, `record_step` and `record_order`, for runs and variants alike."""
    keys = {"record": ["joint1.torque"], "record_step": 1e-2, "record_order": 1, "step": 2e-3}
    scene = small.replace({f"cosimulation.{key}": value for key, value in keys.items()})
    (variant,) = run_variants(scene, [{"payload.mass": 5.0}], lambda run: run.recording)
    assert variant.value is not None
    for recording in (run_scene(scene).recording, variant.value):
        assert [*recording.columns] == ["joint1.torque"]
        assert recording["joint1.torque"].first is not None
        assert recording["joint1.torque"].second is None
        assert recording.time.size < 70


def test_steps_are_chosen_only_for_a_motion(small: Scene) -> None:
    """A torque-driven robot and one with controllers need a step; so does step control."""
    for changes in (
        PD | {"cosimulation.step": "auto"},
        {"cosimulation.step": None, "cosimulation.step_control": {"tolerance": 1e-3}},
    ):
        with pytest.raises(SceneError, match=r"`step` is missing: with .* it is needed, 1e-3 s for example"):
            small.replace(changes)
    with pytest.raises(
        InputError, match="communication steps are chosen where the planned motion alone drives the robot"
    ):
        run_scene(small.replace({"cosimulation.step": "auto"}), input_order=3)
    with pytest.raises(
        InputError, match=r"every whole number of communication steps of 0.0005 s, not every 0.0007 s; 0.0005 s"
    ):
        run_scene(small.replace(PD), record=Selection(None, 2, 7e-4))
