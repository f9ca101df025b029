"""Runs that fail: what is blamed is at fault, and the remedy is one of the scene; what is too large to record is refused before the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.control.controllers.own_function import controller
from flexfmu.cosim.engine.errors import InputError, LoopWarning
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.experiment.run_checks import LARGEST_SIZE, recorded_bytes
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.cosim.many.prepared_scene import PreparedScene, companion_step, run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

EXAMPLE = Path(__file__).parents[3] / "examples" / "controller_scene.toml"
IMAGINARY_AXIS = {"rk4": 2.8284, "dopri5": 1.0}
"""Method → end of its stability interval on the imaginary axis, where undamped modes are."""

PD: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}
"""A stable loop."""


@pytest.fixture(scope="module")
def undamped() -> Scene:
    """The paper's robot with one bending mode, without damping, coarsely stepped."""
    changes: dict[str, Any] = {"effects.damping": {"kind": "none"}, "effects.proximal_bending": 1}
    return load_scene("barnard2012-6kg").replace(
        {**changes, "effects.distal_axial": 0, "trajectory.dwell": 0.0, "cosimulation.step": 1e-2}
    )


def pushed(scene: Scene, torques: tuple[float, float]) -> flexfmu.Run:
    """A run with constant torques."""

    @controller(sample_time=1e-3, outputs=["joint1.torque", "joint2.torque"])
    def push(reference, measurement):  # type: ignore[no-untyped-def]
        return list(torques)

    driven = scene.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    return flexfmu.run(driven, controllers=[push])


@pytest.mark.parametrize("method", IMAGINARY_AXIS)
def test_an_unstable_explicit_step_is_blamed_for_what_it_blows_up(undamped: Scene, method: str) -> None:
    """Explicit methods are unstable from a known product of step and largest frequency: there the step is too large, not a
    singularity near, though the motion that grows may pass one; with smaller ones the run completes."""
    fastest = 2.0 * np.pi * max(max(pose.frequencies) for pose in flexfmu.modes(undamped, 3))
    # far beyond the end of the interval both methods blow up within a few steps
    for step, is_stable in ((0.9 * IMAGINARY_AXIS[method], True), (4.0, False), (6.0, False), (15.0, False)):
        settings = {"cosimulation.integrator": method, "cosimulation.integrator_step": float(step / fastest)}
        run = run_scene(undamped.replace({**settings, "cosimulation.step": 0.1}))
        assert run.completed is is_stable, (step, run.message)
        if not is_stable:
            assert "singularity" not in run.message
            assert "make `cosimulation.integrator_step` smaller" in run.message


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("torques", [(60.0, 60.0), (-100.0, 100.0), (60.0, 0.0)])
def test_a_singularity_is_still_one(undamped: Scene, torques: tuple[float, float]) -> None:
    """Torques push the robot into it: a stable explicit step says so, as error control does."""

    for settings in ({}, {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": 5e-5}):
        run = pushed(undamped.replace(settings), torques)
        assert not run.completed
        assert "(type-2 singularity) is 0.0" in run.message


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.RunWarning")
@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.parametrize("torque", [1e10, 1e30, 1e300])
def test_an_absurd_input_is_named(undamped: Scene, torque: float) -> None:
    """Numbers that overflow come from it, not from a mechanism that can't be assembled."""

    run = pushed(undamped, (0.0, torque))
    assert f"check the inputs, of which joint2.torque = {torque:.6g} N.m is the largest" in run.message
    assert "assembled" not in run.message


def test_an_absurd_blend_is_named(undamped: Scene) -> None:
    """So is the acceleration of a path that turns within a nanometre."""
    run = run_scene(undamped.replace({"trajectory.blend.width": 1e-9, "cosimulation.step": 2e-4}))
    assert ".reference.acceleration = " in run.message
    assert "assembled" not in run.message


def test_a_static_start_that_fails_names_the_key() -> None:
    """The scene says "undeformed", not 2."""
    run = run_scene(load_scene("barnard2012-6kg").replace({"payload.mass": 1e6}))
    assert run.outcome is Outcome.INITIALISATION_FAILED
    assert 'start undeformed (`cosimulation.initial` = "undeformed")' in run.message
    assert "initial = 2" not in run.message


@pytest.mark.slow
def test_stiction_at_the_tightest_tolerance() -> None:
    """A slow motion far from the origin changes less in a step than its angles' last digits: that is no error, whatever the method."""
    scene = load_scene(EXAMPLE).replace({"shaper": [], "imperfection": [], "trajectory.duration": 3.0})
    friction = {"kind": "stiction", "coulomb": 1.0}
    scene = scene.replace(
        {"effects.joint_friction": friction, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-12}
    )
    found = []
    for method in ("automatic", "dopri5"):
        prepared = PreparedScene(scene.replace({"cosimulation.integrator": method}))
        prepared.stop_time = 0.3
        run = prepared.run()
        assert run.completed, run.message
        found.append(np.array([run.recording[f"joint{j}.position"].values for j in (1, 2)]))
    assert abs(found[0] - found[1]).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize(("integrator", "step"), [("rk4", 5e-5), ("rk4", 7e-5), ("dopri5", 5e-5), ("dopri5", 3e-4)])
def test_a_long_fixed_step_is_not_the_loops_fault(integrator: str, step: float) -> None:
    """A stable loop whose explicit integrator diverges: the step is the cause, the loop is named in the second place."""
    changes = {"cosimulation.integrator": integrator, "cosimulation.integrator_step": step}
    run = run_scene(load_scene("starter").replace(PD | changes))
    assert run.outcome is Outcome.STEP_FAILED
    remedy, found, _ = run.message.partition("make `cosimulation.integrator_step` smaller")
    assert "unstable" not in remedy
    assert found


def test_python_is_told_of_a_loop_that_margins_call_unstable() -> None:
    """A robot that its controller lets go falls slowly: `flexfmu.run` says what `flexfmu run` does."""
    gone = PD | {"controller.pd.proportional": 0.0, "controller.pd.derivative": 0.0, "trajectory.dwell": 0.0}
    with pytest.warns(LoopWarning, match="the loop is unstable about"):
        run = flexfmu.run(load_scene("barnard2012-6kg").replace(gone))
    assert run.completed
    assert "the loop is unstable about" in run.health.messages[-1]


@pytest.mark.parametrize(("dwell", "step"), [(1e-12, 1e-3), (1e-10, 2e-4), (1e-9, 2e-4), (1e-8, 2e-2)])
def test_a_dwell_without_an_instant_is_none(dwell: float, step: float) -> None:
    """Acceleration errors are those before the last jump, however short the dwell after it is."""
    scene = load_scene("barnard2012-0.1kg").replace(
        {"trajectory.profile": {"kind": "bang-bang"}, "cosimulation.step": step}
    )
    found, expected = (
        measure_run(run_scene(scene.replace({"trajectory.dwell": each})), companions=0)["end_acceleration_error"]
        for each in (dwell, 0.0)
    )
    assert found.value == pytest.approx(expected.value, rel=1e-4)


LOOP: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}


@pytest.mark.parametrize(("changes", "selection"), [
    ({}, EVERYTHING),
    ({"cosimulation.step": 1e-3}, EVERYTHING),
    (LOOP, EVERYTHING),
    ({"cosimulation.step": 1e-4}, Selection(["joint1.torque"], 0, 1e-3)),
])  # fmt: skip
def test_the_estimate_is_what_is_recorded(changes: dict[str, Any], selection: Selection) -> None:
    """Within a fifth of the values that a run has in the end, and its companion's."""
    scene = load_scene("barnard2012-6kg").replace({**changes, "trajectory.dwell": 0.1})
    run = run_scene(scene, record=selection)
    loop: Loop = loop_of(scene)
    parts = scene_system(scene, loop, run.fmu_path)
    needed = PreparedScene(scene, record=selection)._recording.needed
    for each, step in (
        (run, run.communication_step),
        (None, companion_step(parts, loop.motion, run.communication_step)),
    ):
        found = each if each is not None else run.companion and run.companion.run(None)
        assert found is not None
        own = [column for name, column in found.recording.columns.items() if "end_effector.reference" not in name]
        arrays = [part for column in own for part in (column.values, column.first, column.second) if part is not None]
        values = found.recording.time.size * (1 + len(arrays))
        estimated = recorded_bytes(parts, needed, loop.motion.stop_time, step) / 8.0
        assert 0.8 < estimated / values < 1.6


OUT_OF_PROPORTION = {
    "run barnard2012-6kg --set trajectory.duration=430": "`trajectory.duration` = 430 s: 0.43 s?",
    "run barnard2012-6kg --set trajectory.dwell=250": "`trajectory.dwell` = 250 s: 0.25 s?",
    "run barnard2012-6kg --set cosimulation.step=2e-7": "the communication step is 2e-07 s: 0.0002 s?",
    "compare barnard2012-6kg --variant long:trajectory.duration=430": "s: 0.43 s?",
    "plan barnard2012-6kg --set trajectory.duration=900": "s: 0.9 s?",
    "sweep barnard2012-6kg --vary trajectory.duration=900 --metrics peak_torque_1 --no-plot": "s: 0.9 s?",
}
"""Command → the value that was meant."""


@pytest.mark.parametrize("command", OUT_OF_PROPORTION)
def test_values_in_milliseconds_are_asked_about(command: str, tmp_path: Path) -> None:
    """With sizes, duration and the value that was meant; nothing is written, nothing runs for minutes. In a sweep it is the
    case's own failure."""
    found = CliRunner().invoke(app, [*command.split(), "--out", str(tmp_path / "out")])
    assert found.exit_code != 0
    assert OUT_OF_PROPORTION[command] in found.output
    if command.startswith("run"):
        assert found.exit_code == 2
        assert all(part in found.output for part in (" GB and ", " GB for its companion", " s in steps of ", "--yes"))
        assert not any((tmp_path / "out").glob("*"))


def test_python_asks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The keyword accepts it."""
    monkeypatch.setattr("flexfmu.cosim.experiment.run_checks.LARGEST_SIZE", 1e6)
    with pytest.raises(InputError, match=r"record about .* GB for its companion, .*--yes`, in Python accept_size=True"):
        flexfmu.run("barnard2012-6kg")
    assert flexfmu.run("barnard2012-6kg", accept_size=True).completed


def test_shipped_scenes_are_below_the_limit() -> None:
    """All of them, and with the finest step of the benchmarks."""
    for name in ("barnard2012-6kg", "barnard2012-0.1kg"):
        PreparedScene(load_scene(name), communication_step=5e-6).check_size()
    assert LARGEST_SIZE > 1e9
