"""`flexfmu shaper`: what it co-simulates, recommends, prints and writes."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.control.sections import with_payload_error
from flexfmu.cosim.design.shapers import examination
from flexfmu.cosim.design.shapers import study as shaping
from flexfmu.cosim.design.shapers.recommendation import recommend, write_shaped
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.planning import MotionPlan, plan, shape_joints, shape_path
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import DampedModes
from flexfmu.trajectories.shapers.designs import design
from flexfmu.trajectories.shapers.sequence import UNSHAPED, Oscillator, ShapedTrajectory

SHIPPED = (files("flexfmu.model.scene") / "scenes" / "barnard2012-6kg.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def scene() -> Scene:
    """The paper's robot with 6 kg and bang-bang profile, which makes it vibrate, coarsely stepped."""
    changes = {"trajectory.profile": {"kind": "bang-bang"}, "cosimulation.step": 1e-3}
    return load_scene("barnard2012-6kg").replace(changes)


@pytest.fixture(scope="module")
def motion(scene: Scene) -> MotionPlan:
    """Its planned motion."""
    return plan(scene)


@pytest.mark.parametrize(
    ("frequencies", "shaped"), [([20.0, 59.0, 61.0], [20.0, 59.0]), ([20.0, 30.0, 40.0, 50.0], [20.0, 30.0, 40.0])]
)
def test_modes_near_the_lowest_are_shaped_for(
    motion: MotionPlan, monkeypatch: pytest.MonkeyPatch, frequencies: list[float], shaped: list[float]
) -> None:
    """Up to three times the lowest frequency and no more than three: a motion hardly excites what lies above."""
    found = DampedModes(np.array(frequencies), np.full(len(frequencies), 0.01))
    monkeypatch.setattr(shaping, "damped_modes", lambda scene, pose: found)
    wanted = shaping.design_modes(motion, (-0.3, 0.3))
    assert [mode.frequency for mode in wanted.modes] == shaped
    assert wanted.band == (20.0, shaped[-1])
    # payload errors are symmetric about zero, which is exactly among them; a scene without payload has none
    assert shaping.payload_errors(motion.scene, 0.3, 7) == [-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
    assert shaping.payload_errors(motion.scene.replace({"payload.mass": 0.0}), 0.3, 7) == [0.0]


def result(
    motion: MotionPlan, name: str, added: float, settling: float | None, stray: float = 0.0, residual: float = 5e-5
) -> shaping.CandidateResult:
    """A result with one trial."""
    candidate = shaping.ShapedMotion(name, "joints" if added else "-", UNSHAPED, motion)
    trial = shaping.PayloadTrial(0.0, 1e-6 if settling == 0.0 else residual, settling, 50.0)
    return shaping.CandidateResult(candidate, added, stray, (trial,))


@pytest.mark.slow
def test_design_modes_are_those_of_the_end_pose(motion: MotionPlan) -> None:
    """The two low modes of the loaded robot; a lighter payload raises them, a heavier one lowers them."""
    found = shaping.design_modes(motion, [-0.3, 0.0, 0.3])
    np.testing.assert_allclose([mode.frequency for mode in found.modes], [58.84, 73.54], atol=0.01)
    np.testing.assert_allclose([mode.ratio for mode in found.modes], [0.0180, 0.0225], atol=1e-4)
    np.testing.assert_allclose(found.path_range, (56.84, 58.84), atol=0.01)
    np.testing.assert_allclose(found.first_band, (52.81, 67.54), atol=0.01)
    np.testing.assert_allclose(found.band, (52.81, 84.11), atol=0.01)


def test_alternatives_hold_what_they_promise(motion: MotionPlan) -> None:
    """All kinds are there, the shortest first; convolved ones cancel both modes, SI keeps 5 % over the band."""
    modes = shaping.design_modes(motion, [-0.3, 0.0, 0.3])
    found = {each.name: each.sequence for each in shaping.alternatives(modes)}
    assert {"um-zv", "zv", "mzv", "zvd", "ei", "zvdd", "2-hump-ei", "3-hump-ei", "si", "zv x zv"} <= set(found)
    assert list(found) == sorted(found, key=lambda name: found[name].duration)
    for mode in modes.modes:
        assert found["zvd x zvd"].residual(mode.frequency, mode.ratio)[0] < 1e-12
    band = np.linspace(*modes.band, 500)
    assert np.max(found["si"].residual(band, modes.modes[0].ratio)) <= 0.05 * 1.001


@pytest.mark.slow
def test_shaped_joints_silence_the_robot(motion: MotionPlan) -> None:
    """Through the FMU, against bang-bang's residual vibration: ZV for one mode leaves a fifth, for both modes a tenth."""
    fmu = build_scene(motion.scene).path
    modes = [Oscillator(58.84, 0.018), Oscillator(73.54, 0.0225)]
    motions = motion, *(shape_joints(motion, design("zv", modes[:count])) for count in (1, 2))
    unshaped, single, double = (
        shaping.simulate(shaping.ShapedMotion("zv", "joints", UNSHAPED, each), 0.0, fmu) for each in motions
    )
    assert unshaped.residual == pytest.approx(45.5e-6, rel=0.02)
    assert single.residual < 0.2 * unshaped.residual
    assert double.residual < 0.05 * unshaped.residual
    assert double.peak_torque < single.peak_torque < unshaped.peak_torque


@pytest.mark.slow
def test_the_fmu_takes_a_shaped_motion_with_another_payload(motion: MotionPlan) -> None:
    """One FMU with the payload as its parameter gives what an FMU built from the changed scene gives."""
    heavier = with_payload_error(motion.scene, 0.3)
    shaped = shape_path(motion, design("ei", [Oscillator(58.84, 0.018)]))
    one = shaping.simulate(shaping.ShapedMotion("ei", "path", UNSHAPED, shaped), 0.3, build_scene(motion.scene).path)
    own = measure_run(run_scene(heavier, motion=replace(shaped, scene=heavier)), companions=0)
    assert one.residual == pytest.approx(own["residual_vibration_amplitude"].value, rel=1e-9)
    assert one.settling_time == pytest.approx(own["settling_time"].value, abs=1e-8)


def test_both_ways_report_deviation_and_time(motion: MotionPlan) -> None:
    """Shaped joints leave the path, a shaped s(t) doesn't; both take longer by the sequence's duration, and so can the path."""
    sequence = design("zvd", [Oscillator(58.84, 0.018)])
    joints, path = shape_joints(motion, sequence), shape_path(motion, sequence)
    assert 3e-4 < joints.deviation < 7e-4
    assert path.deviation < 1e-15
    assert shaping.slower(motion, 0.02).motion.duration == pytest.approx(0.45)
    assert shaping.slower(motion, 0.02).motion.profiled.path == motion.profiled.path
    for shaped in (joints, path):
        assert shaped.duration == pytest.approx(motion.duration + sequence.duration, rel=1e-14)
        assert shaped.stop_time == pytest.approx(motion.stop_time + sequence.duration, rel=1e-14)
        end = shaped.joints.evaluate(shaped.duration, 0)[0, 0]
        np.testing.assert_allclose(end, motion.joints.evaluate(motion.duration, 0)[0, 0], atol=1e-13)


def test_what_can_not_be_applied_is_left_out_with_its_reason(motion: MotionPlan) -> None:
    """A shaper that would drive backwards along the path is still tried on the joints."""
    slow = shaping.Alternative("um-zv", design("um-zv", [Oscillator(0.5)]))
    found, refused = shaping.candidates(motion, [slow])
    assert [(each.name, each.application) for each in found] == [("unshaped", "-"), ("um-zv", "joints")]
    assert "go backwards" in refused["um-zv on path"]


STRAYING = [(0.0, 0.05), (0.008, 0.0, 2e-3), (0.01, 0.0, 1e-4)]
SOONEST = ["rest within 10 µm 10.0 ms after", "50.0 ms"]
NEAREST = ["nearest is unshaped: joint jerk inf rad/s³ above 1e+04 rad/s³, peak torque 50 N·m above 10 N·m"]


@pytest.mark.parametrize(
    ("results", "limits", "name", "reasons"),
    [
        # added and settling time count together; of equal ones the smaller path deviation wins; unsettled ones don't count
        ([(0.0, 0.05), (0.005, None), (0.017, 0.0), (0.008, 0.002, 2e-3), (0.01, 3e-5, 1e-4)], {}, "shaper 4", SOONEST),
        ([(0.0, 0.001), (0.008, 0.0)], {}, "unshaped", ["no shaper brings the robot to rest sooner"]),
        # without rest within the dwell the smallest worst residual decides
        ([(0.0, None), (0.008, None, 0.0, 2e-5)], {}, "shaper 1", ["20 µm at worst instead of 50 µm"]),
        # what strays, takes or asks for more than allowed isn't recommended however soon it rests
        (STRAYING, {"deviation": 1e-3}, "shaper 2", []),
        (STRAYING, {"deviation": 1e-3, "added_time": 9e-3}, "unshaped", []),
        (STRAYING, {"torque": 60.0}, "shaper 1", []),
        ([(0.0, 0.05)], {"jerk": 1e4, "torque": 10.0}, None, NEAREST),
    ],
)
def test_the_soonest_at_rest_within_the_limits_is_recommended(
    motion: MotionPlan, results: list[Any], limits: dict[str, float], name: str | None, reasons: list[str]
) -> None:
    """And the sentence says why, or by how much the nearest misses."""
    found = [result(motion, f"shaper {k}" if k else "unshaped", *each) for k, each in enumerate(results)]
    chosen = recommend(found, 1e-5, limits)
    assert (chosen.result.candidate.name, chosen.keeps_limits) == (name or "unshaped", name is not None)
    assert all(each in chosen.reason for each in reasons)


def test_a_controlled_scene_is_studied_with_its_controller_unless_the_drive_is_perfect(scene: Scene) -> None:
    """The scene's own shapers never act besides; a perfect drive needs no controller, and none can't be studied. Residual
    vibration needs a dwell: fifteen periods of the lowest mode."""
    assert shaping.studied(scene, 50.0) is scene
    assert shaping.studied(scene.replace({"trajectory.dwell": 0.0}), 50.0).trajectory.dwell == pytest.approx(0.3)
    loop = [{"kind": "pd", "proportional": 1e4, "derivative": 1e2, "sample_time": 1e-3}]
    controlled = scene.replace({"cosimulation.drive": "torque", "controller": loop, "shaper": [{"kind": "zv"}]})
    assert shaping.studied(controlled, 50.0, "perfect") == scene
    assert shaping.studied(controlled, 50.0) == controlled.replace({"shaper": ()})
    assert shaping.studied(controlled, 50.0, "controller") == controlled.replace({"shaper": ()})
    with pytest.raises(InputError, match=r"has no \[\[controller\]\] to study shapers with"):
        shaping.studied(scene, 50.0, "controller")


def test_jerk_is_that_of_the_joint_references(motion: MotionPlan) -> None:
    """Infinite where accelerations jump; else the largest third derivative, here against differences of the second."""
    assert shaping.peak_jerk(motion) == np.inf
    smooth = plan(motion.scene.replace({"trajectory.profile": {"kind": "poly7"}}))
    times = np.linspace(0.0, smooth.duration, 200_001)
    acceleration = smooth.joints.evaluate(times, 2)[2]
    differences = np.abs(np.diff(acceleration, axis=0)).max() / times[1]
    assert shaping.peak_jerk(smooth) == pytest.approx(differences, rel=1e-3)


@pytest.mark.parametrize("name", ["zvd x zvd", "si"])
def test_the_written_scene_applies_the_advice(motion: MotionPlan, tmp_path: Path, name: str) -> None:
    """The file is the scene with that shaper and no other: its planned motion is the candidate's, and paths still lead to their files."""
    modes = shaping.design_modes(motion, [-0.3, 0.0, 0.3])
    tried, _ = shaping.candidates(motion, [each for each in shaping.alternatives(modes) if each.name == name])
    wanted = next(each for each in tried if each.application == "joints")
    source, target = tmp_path / "mine.toml", tmp_path / "elsewhere" / "shaped.toml"
    target.parent.mkdir()
    controller = '[[controller]]\nkind = "python"\nsource = "own:zero"\n'
    source.write_text(f'{SHIPPED}{controller}\n[[shaper]]  # an old one\nkind = "zv"\n', encoding="utf-8")
    write_shaped(str(source), wanted.section, target)
    text = target.read_text(encoding="utf-8")
    assert (text.count("\n[[shaper]]"), "an old one" in text) == (1, False)
    scene = load_scene(target)
    assert Path(scene.controller[0].folder).resolve() == tmp_path
    times = np.linspace(0.0, wanted.motion.duration, 300)
    shaped = loop_of(scene.replace({"controller": ()})).motion
    reference = ShapedTrajectory(plan(scene).joints, wanted.sequence)
    np.testing.assert_allclose(shaped.joints.evaluate(times, 2), reference.evaluate(times, 2), rtol=1e-9, atol=1e-9)


def test_rigid_robots_need_no_shaper(scene: Scene) -> None:
    """Nothing vibrates: the error says what to add."""
    rigid = scene.replace({"effects.proximal_bending": 0, "effects.distal_axial": 0})
    with pytest.raises(InputError, match="nothing vibrates in scene barnard2012-6kg"):
        shaping.design_modes(plan(rigid), [0.0])


@pytest.mark.slow
def test_the_command_writes_and_says_what_it_recommends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """JSON, CSV and the picture; the printed JSON is the written one; the shaped robot rests sooner. For people: the modes, the
    recommendation with its reason, a slower motion beside it, and a scene with the shaper."""

    def few(modes: shaping.DesignModes) -> list[shaping.Alternative]:
        return [each for each in shaping.alternatives(modes) if each.name in ("zv", "ei")]

    monkeypatch.setattr(examination, "alternatives", few)
    scene, out = tmp_path / "coarse.toml", tmp_path / "out"
    text = SHIPPED.replace("step = 2e-4", "step = 1e-3").replace('kind = "poly7"', 'kind = "bang-bang"')
    scene.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, ["shaper", str(scene), "--out", str(out), "--json", "--payload-errors"])
    assert done.exit_code == 0, done.output
    data = json.loads((out / "shapers.json").read_text(encoding="utf-8"))
    assert json.loads(done.stdout) == data
    names = [(each["shaper"], each["shapes"]) for each in data["alternatives"]]
    assert names == [("unshaped", "-"), ("zv", "joints"), ("zv", "path"), ("ei", "joints"), ("ei", "path")]
    unshaped, zv, zv_path = data["alternatives"][:3]
    assert zv["worst_residual_vibration"] < 0.3 * unshaped["worst_residual_vibration"]
    assert zv_path["path_deviation"] < 1e-15 < zv["path_deviation"]
    assert zv["added_time"] == pytest.approx(zv["impulses"]["times"][-1])
    assert data["recommendation"]["shapes"] == "joints"
    advised = next(each for each in data["alternatives"] if each["shaper"] == data["recommendation"]["shaper"])
    assert data["slower"]["added_time"] == pytest.approx(advised["added_time"])
    # a line of the table for each simulation, in SI units
    rows = list(csv.DictReader((out / "shapers.csv").read_text(encoding="utf-8").splitlines()))
    trials = [trial for each in data["alternatives"] for trial in each["trials"]]
    assert len(rows) == len(trials) == 35
    for row, trial in zip(rows, trials, strict=True):
        assert float(row["payload_error"]) == pytest.approx(trial["payload_error"])
        assert (float(row["settling_time"]) if row["settling_time"] else None) == trial["settling_time"]
    assert (out / "sensitivity.png").read_bytes().startswith(b"\x89PNG")
    assert "<svg" in (out / "sensitivity.svg").read_text(encoding="utf-8")
    planned = tmp_path / "shaped.toml"
    done = CliRunner().invoke(app, ["shaper", str(scene), "--out", str(out), "--payload-band", "0", "-o", str(planned)])
    assert done.exit_code == 0, done.output
    assert load_scene(planned).shaper[0].kind == "zv"
    words = " ".join(done.stdout.split())
    for each in (
        '[[shaper]] kind = "zv" modes = [',
        "Designed for 58.84 Hz (damping ratio 0.0180), 73.54 Hz",
        "Recommended: zv on joints: rest within 10 µm",
        "An unshaped motion slower by the same",
    ):
        assert each in words


@pytest.mark.parametrize("band", ["1", "-0.1", "nan"])
def test_bad_bands_are_refused(band: str, tmp_path: Path) -> None:
    """A payload of nothing or less isn't simulated; usage errors end with status 2."""
    done = CliRunner().invoke(app, ["shaper", "barnard2012-6kg", "--out", str(tmp_path), "--payload-band", band])
    assert done.exit_code == 2
    assert "--payload-band must be at least 0 and below 1" in done.output
