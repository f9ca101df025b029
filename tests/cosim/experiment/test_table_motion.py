"""Scenes with ``kind = "table"``: the same robot follows the same motion, whatever it comes from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.design.shapers.recommendation import write_shaped
from flexfmu.cosim.experiment.planning import MotionPlan, shape_joints, shape_path
from flexfmu.cosim.experiment.scene_build import scene_key
from flexfmu.cosim.reports.modes_table import modes_along_path
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import read_scene_text
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.shapers.designs import zero_vibration
from flexfmu.trajectories.shapers.sequence import Oscillator
from flexfmu.trajectories.table import write_table

SHORT = {"trajectory.dwell": 0.05}


@pytest.fixture(scope="module")
def known() -> MotionPlan:
    """A motion along a path."""
    return flexfmu.reference_motion(flexfmu.load_scene("barnard2012-6kg").replace(SHORT))


@pytest.fixture(scope="module")
def folder(known: MotionPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same motion as tables of end effector and joints."""
    place = tmp_path_factory.mktemp("tables")
    write_table(place / "task.csv", known.task)
    write_table(place / "joints.csv", known.joints, "joints")
    return place


def tabulated(known: MotionPlan, file: Path, **keys: object) -> Scene:
    """The scene with a table for its motion."""
    return known.scene.replace({"trajectory": {"kind": "table", "file": str(file), "dwell": 0.05, **keys}})


@pytest.mark.parametrize("name", ["task", "joints"])
def test_plan_and_run(known: MotionPlan, folder: Path, name: str) -> None:
    """References and metrics are those of the path; joints by inverse, the end effector by forward kinematics."""
    scene = tabulated(known, folder / f"{name}.csv")
    motion = flexfmu.reference_motion(scene)
    instants = np.linspace(0.0, 0.48, 481)
    for found, expected in ((motion.task, known.task), (motion.joints, known.joints)):
        for order, scale in enumerate((1e-11, 1e-8, 1e-4)):
            a, b = (each.evaluate(instants, 2, "left")[order] for each in (found, expected))
            np.testing.assert_allclose(a, b, atol=scale)
    assert (motion.duration, motion.stop_time) == pytest.approx((0.43, 0.48))
    ours, theirs = (flexfmu.measure_run(flexfmu.run(each), companions=0) for each in (scene, known.scene))
    for metric in ("peak_torque_1", "peak_position_error", "rms_acceleration_error", "residual_vibration_amplitude"):
        assert ours[metric].value == pytest.approx(theirs[metric].value, rel=1e-5), metric


def test_results_are_a_motion(known: MotionPlan, tmp_path: Path) -> None:
    """What was recorded is run again, with both limits at jumps of the acceleration."""
    first = flexfmu.run(known.scene.replace({"trajectory.profile": "bang-bang"}))
    first.recording.write_csv(tmp_path / "results.csv")
    again = flexfmu.run(tabulated(known, tmp_path / "results.csv", coordinates="joints", dwell=0.0))
    assert again.plan.duration == pytest.approx(0.48)
    peaks = [flexfmu.measure_run(run, companions=0)["peak_torque_1"].value for run in (first, again)]
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-6)


def test_one_fmu_for_all_motions_from_a_start(known: MotionPlan, folder: Path) -> None:
    """The robot knows of its motion where it starts, nothing else; scenes with a path keep their key."""
    task = tabulated(known, folder / "task.csv")
    assert scene_key(task) == scene_key(task.replace({"trajectory.degree": 7, "trajectory.duration": 0.5}))
    assert '"trajectory":{"start":[-0.175,0.32]}' in scene_key(known.scene)
    (folder / "elsewhere.csv").write_text("time,x,y\n0,-0.17,0.32\n1,-0.1,0.32\n")
    assert scene_key(tabulated(known, folder / "elsewhere.csv")) != scene_key(task)


@pytest.mark.parametrize("name", ["task", "joints"])
def test_duration_scales_the_motion(known: MotionPlan, folder: Path, name: str) -> None:
    """It is that of the file, unless it is given; the scene of another file has that one's."""
    file = folder / f"{name}.csv"
    scene = tabulated(known, file)
    assert scene.trajectory.duration == 0.43
    slower = flexfmu.reference_motion(scene.replace({"trajectory.duration": 0.86}))
    instants = np.linspace(0.0, 0.86, 87)
    expected = known.joints.evaluate(0.5 * instants, 2, "left")
    for order in range(3):
        found = slower.joints.evaluate(instants, 2, "left")[order]
        np.testing.assert_allclose(found, expected[order] * 0.5**order, atol=1e-4)
    (folder / "long.csv").write_text("time,x,y\n0,-0.175,0.32\n2,-0.1,0.32\n")
    assert scene.replace({"trajectory.file": str(folder / "long.csv")}).trajectory.duration == 2.0
    assert scene == tabulated(known, file)


def test_modes_and_shapers(known: MotionPlan, folder: Path) -> None:
    """Poses by arc length as on the path; shaped joints leave it as far; there is no profile to shape."""
    motion = flexfmu.reference_motion(tabulated(known, folder / "joints.csv"))
    for found, expected in zip(modes_along_path(motion, 3), modes_along_path(known, 3), strict=True):
        assert (found.x, found.y, found.q11) == pytest.approx((expected.x, expected.y, expected.q11), abs=1e-6)
        assert found.frequencies == pytest.approx(expected.frequencies, rel=1e-5)
    sequence = zero_vibration(Oscillator(30.0, 0.0))
    shaped, reference = (shape_joints(each, sequence) for each in (motion, known))
    assert shaped.deviation == pytest.approx(reference.deviation, rel=1e-5)
    assert motion.deviation < 1e-9
    said = r"spline of degree 7 \(C3\) through \d+ rows of joint positions ... jerks in joints.csv has no profile along a path"
    with pytest.raises(TrajectoryError, match=said):
        shape_path(motion, sequence)


def test_whole_turns_and_working_modes(known: MotionPlan, folder: Path) -> None:
    """Angles may count from another turn; the working mode must be that of the scene."""
    time, angles = np.linspace(0.0, 0.43, 44), known.joints.evaluate(np.linspace(0.0, 0.43, 44), 0)[0]
    turned, other = folder / "turned.csv", folder / "other.csv"
    rows = np.column_stack([time, angles + 2.0 * np.pi])
    np.savetxt(turned, rows, delimiter=",", header="time,q11,q21", comments="", fmt="%.17g")
    start = flexfmu.reference_motion(tabulated(known, turned)).joints.evaluate(0.0, 0)[0, 0]
    assert start == pytest.approx(known.joints.evaluate(0.0, 0)[0, 0])
    other.write_text("time,q11,q21\n0,2.737,3.380\n1,2.322,2.759\n")
    with pytest.raises(SceneError, match=r"`mechanism.working_mode` must be 'left' for q11 = .* got 'elbows-out'"):
        tabulated(known, other)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,x,y\n0,-0.175,0.32\n1,0,0.3\n2,0.9,0.3\n", r"far.csv, line 4: reach of leg 1 is -0.\d+ m at \(x, y\) = \(0.9, 0.3\)"),
        ("time,q11,q21\n0,2.2,0.9\n1,3.1,0\n", r"far.csv, line 3: the elbows are 0.67\d+ m apart .* below 0.6 m: move"),
        ("time,x,y\n0,-0.175,0.32\n2,0.175,-0.32\n", "reach of leg 1|type-2 singularity"),
    ],
)  # fmt: skip
def test_out_of_reach(known: MotionPlan, folder: Path, text: str, said: str) -> None:
    """At a row the message names file and line, between rows the instant."""
    file = folder / "far.csv"
    file.write_text(text)
    with pytest.raises((TrajectoryError, SceneError), match=said):
        flexfmu.reference_motion(tabulated(known, file).replace({"mechanism.distal.length": 0.3}))


@pytest.mark.parametrize(("keys", "said"), [
    ({"degree": 4}, "`trajectory.degree` must be 3, 5 or 7"),
    ({"degree": 5}, "task.csv gives derivatives up to order 3, which need `degree` = 7, got 5"),
    ({"noise": 1e-5}, "`noise` smooths positions, but .*task.csv has vx, vy, ax, ay, jx, jy: remove these columns"),
    ({"noise": 0.0}, "`trajectory.noise` must be above 0.0 m or rad, got 0.0 m or rad"),
    ({"start": [0.0, 0.3]}, "`trajectory.start` is not a known key"),
    ({"duration": 0.0}, "`trajectory.duration` must be above 0.0 s"),
    ({"kind": "spline"}, "`trajectory.kind` must be one of 'pick-and-place', 'table', got 'spline'"),
    ({"file": "nowhere.csv"}, "cannot read the motion nowhere.csv: No such file"),
])  # fmt: skip
def test_wrong_keys(known: MotionPlan, folder: Path, keys: dict[str, object], said: str) -> None:
    """Each names the key, the value and what would be right."""
    section = {"kind": "table", "file": str(folder / "task.csv"), **keys}
    with pytest.raises(SceneError, match=said):
        known.scene.replace({"trajectory": section})


def test_relative_to_the_scene_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever the scene is loaded from, and where a shaper's command writes it with its shaper."""
    before, _, rest = read_scene_text("barnard2012-6kg")[0].partition("[trajectory]")
    table = '[trajectory]\nkind = "table"\nfile = "task.csv"\n\n[cosimulation]'
    (folder / "scene.toml").write_text(before + table + rest.partition("[cosimulation]")[2])
    monkeypatch.chdir(folder.parent)
    assert flexfmu.load_scene(Path(folder.name) / "scene.toml").trajectory.duration == 0.43
    (folder / "below").mkdir()
    write_shaped(str(folder / "scene.toml"), {"kind": "zv"}, folder / "below" / "shaped.toml")
    shaped = flexfmu.load_scene(folder / "below" / "shaped.toml")
    assert (shaped.trajectory.duration, len(shaped.shaper)) == (0.43, 1)


def test_the_report_says_which_spline(known: MotionPlan, folder: Path) -> None:
    """Degree, continuity, rows and file, in the plan and in the summary."""
    (folder / "few.csv").write_text("time,x,y,vx,vy\n0,-0.175,0.32,0,0\n1,0,0.3,0.2,0\n2,0.1,0.3,0,0\n")
    motion = flexfmu.reference_motion(tabulated(known, folder / "few.csv"))
    assert motion.source == "spline of degree 5 (C3) through 3 rows of end-effector positions, velocities in few.csv"
    again = flexfmu.reference_motion(tabulated(known, folder / "few.csv", degree=3))
    assert again.source.startswith("spline of degree 3 (C1) through 3 rows")
