"""Margins of scenes: critical gains are those of simulations, the command says what they are, and what one reads from a drawn curve is the
number."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import c_function, looped
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.control.blocks.equations import block
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.c_function import SIGNATURE
from flexfmu.cosim.design.margins.course import PathLoop, Place
from flexfmu.cosim.design.margins.linear_blocks import linear_block
from flexfmu.cosim.design.margins.loop_warnings import stability_warning
from flexfmu.cosim.design.margins.margins import ALL, growth
from flexfmu.cosim.design.margins.pictures import disk_of, loop_curves, margin_plots
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.design.margins.scene_margins import MarginsResult, scene_margins, write_margins
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_loop import loop_of, own_loop
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.experiment.wiring import inline_block
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.reports.chart import FIRST, Curve, Panel
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import Variable
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import spline

PD: dict[str, Any] = {"kind": "pd", "proportional": 1e4, "derivative": 60.0, "sample_time": 1e-3}
SEVERAL_RATES: list[dict[str, Any]] = [
    {"kind": "encoder", "counts_per_turn": 1e12, "window": 3, "sample_time": 2.5e-4},
    {"kind": "delay", "time": 3e-4, "sample_time": 2.5e-4},
    {"kind": "lag", "time_constant": 2e-4},
]


def grows(scene: Scene, angles: tuple[float, float], factor: float) -> bool:
    """Whether small motions about standstill grow with torques times a factor."""
    ports = [
        Variable(f"joint{i}.torque{end}", "N.m", "Torque", way, start)  # type: ignore[arg-type]
        for way, end, start in (("input", ".input", 0.0), ("output", "", None))
        for i in (1, 2)
    ]
    law = lambda x, u, p: (factor * u, x)  # noqa: E731
    gain = block("gain", "Gain", law, sample_time=1e-3, inputs=ports[:2], outputs=ports[2:])
    loop = own_loop(scene, spline([0.0, 0.6], np.array([[angles, angles]]), coordinates="joints"))
    loop = replace(loop, inline_blocks=(inline_block(as_slave(gain, SlaveNames())), *loop.inline_blocks))
    run = PreparedScene(loop.motion.scene, loop=loop).run()
    change, time = np.abs(np.diff(run.recording["gain.joint1.torque"].values)), run.recording.time[1:]
    early, late = (np.sqrt(np.mean(change[(time > a) & (time <= a + 0.2)] ** 2)) for a in (0.2, 0.4))
    return bool(late > early)


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        looped(PD, gravity=(0.0, -1e-4)),
        looped({**PD, "kind": "pid", "proportional": 1e3, "integral": 4e3, "derivative": 8.0, "filter_time": 1e-3}, *SEVERAL_RATES, gravity=(0.0, -1e-4)),
    ],
    ids=["one rate", "several rates, delay and lag"],
)  # fmt: skip
def test_the_critical_gain_is_that_of_simulations(scene: Scene) -> None:
    pose = scene_margins(scene, poses=1).poses[0]
    assert pose.is_stable
    predicted = pose.loops[-1].gain_margin
    assert (predicted.name, predicted.label, predicted.unit) == ("gain_margin", "Gain margin", "1")
    assert not grows(scene, pose.joints, 0.99 * predicted)
    assert grows(scene, pose.joints, 1.01 * predicted)


def test_payload_errors_count() -> None:
    exact, heavy = (
        scene_margins(looped(PD, *each), poses=1).poses[0].poles
        for each in ([], [{"kind": "payload-error", "relative": 0.5}])
    )
    assert abs(heavy[0].imag) < abs(exact[0].imag)


def test_what_has_no_margins_says_why() -> None:
    uneven = [{**PD, "sample_time": 0.001234567}, {"kind": "feedforward", "sample_time": 0.00098765}]
    with pytest.raises(InputError, match="has no loop: margins need"):
        scene_margins(looped(PD).replace({"cosimulation.drive": "motion", "controller": []}), poses=1)
    with pytest.raises(InputError, match="have a common period"):
        scene_margins(looped(PD).replace({"controller": uneven}), poses=1)


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_runs_warn_of_loops_that_are_unstable_or_nearly() -> None:
    scene = looped(PD).replace({"trajectory.duration": 0.1})
    critical = scene_margins(scene, poses=1).worst.gain_margin
    assert stability_warning(flexfmu.run(scene)) is None
    for share, *sentences in (
        (0.95, "with torques 5.3 % larger it is unstable"),
        (1.25, "small motions grow tenfold in", "with torques 20 % smaller it is stable"),
    ):
        gains = {"proportional": share * critical * 1e4, "derivative": share * critical * 60.0}
        warning = stability_warning(flexfmu.run(scene.replace({"controller": [{**PD, **gains}]}))) or ""
        assert all(each in warning for each in sentences)


@pytest.mark.slow
def test_the_command_prints_margins_and_draws_pictures(tmp_path: Path) -> None:
    """And fails where the loop is unstable."""
    example = str(Path(__file__).parents[4] / "examples" / "controller_scene.toml")
    command, out = ["margins", example, "--poses", "1"], tmp_path / "m"
    found = CliRunner().invoke(app, [*command, "--json", "--out", str(out)])
    assert found.exit_code == 0
    data = json.loads(found.stdout)
    assert data["stable"]
    assert 1.5 < data["worst"]["gain_margin"] < 2.5
    assert {path.name for path in out.iterdir()} == {
        *("bode.png", "margins.csv", "margins.html", "nyquist.png", "root-locus.png")
    }
    page = (out / "margins.html").read_text(encoding="utf-8")
    assert "Nyquist diagram about −1" in page
    assert page.count('class="tile"') == 6
    found = CliRunner().invoke(app, [*command, "--set", "controller.pd.proportional=5e4"])
    assert found.exit_code == 1
    assert "Unstable at path 1.00" in found.stdout


def test_a_function_in_c_is_linearised(tmp_path: Path) -> None:
    """By finite differences: those of PD control in C are its gains, and it counts no samples."""
    names = [f"{kind}{joint}" for kind in ("r", "v_r", "q", "v") for joint in (1, 2)]
    body = "for (int j = 0; j < 2; ++j) y[j] = p[0] * (u[j] - u[4 + j]) + p[1] * (u[2 + j] - u[6 + j]);"
    (tmp_path / "own.c").write_text(f"{SIGNATURE.format('own')} {{ {body} }}\n")
    gains = {"kp": 1e4, "kd": 60.0}
    own = c_function(tmp_path / "own.c", inputs=names, outputs=["u1", "u2"], parameters=gains, sample_time=1e-3)
    linear, _ = linear_block(BlockSlave(own), np.linspace(0.0, 1.0, 8))
    expected = np.hstack([gain * np.eye(2) for gain in (1e4, 60.0, -1e4, -60.0)])
    np.testing.assert_allclose(linear.d, expected, rtol=1e-7, atol=1e-4)
    assert linear.a.shape == (0, 0)


TRACKING: dict[str, Any] = {"kind": "computed-torque", "proportional": 3600.0, "derivative": 120.0, "sample_time": 1e-3}


ROUGH: list[dict[str, Any]] = [
    {"kind": "quantisation", "resolution": 1e-3},
    {"kind": "noise", "standard_deviation": 1e-3},
    {"kind": "saturation", "limit": 500.0},
]


@pytest.mark.parametrize(
    ("controllers", "other"),
    [
        # roundings, noise and limits
        ([PD], {"imperfection": [{**each, "sample_time": 1e-3} for each in ROUGH]}),
        # neither the robot nor its compensation has Coulomb friction at standstill
        ([TRACKING], {"effects.joint_friction.coulomb": 2.0}),
        ([PD, {"kind": "friction-compensation", "viscous": 0.0, "coulomb": 1.0, "motion": "measured", "sample_time": 1e-3}], {}),
        # from cycle to cycle, not within the loop
        ([PD, {"kind": "learning", "gain": 1e3, "cycles": 3, "sample_time": 1e-3}], {}),
        # references aren't in the loop: an integrator among them is no instability
        ([PD], {"filter": [{"kind": "biquad", "numerator": [1.0], "denominator": [1.0, 0.0], "signal": "reference"}]}),
    ],
    ids=["imperfections", "computed torque", "friction compensation", "learning", "references"],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LearningWarning")
def test_what_is_not_in_the_loop_leaves_the_margins_as_they_are(
    controllers: list[dict[str, Any]], other: dict[str, Any]
) -> None:
    plain = scene_margins(looped(controllers[0]), poses=1).worst
    found = scene_margins(looped(controllers[0]).replace({"controller": controllers, **other}), poses=1).worst
    for name in ("gain_margin", "delay_margin", "sensitivity_peak"):
        assert getattr(found, name) == pytest.approx(getattr(plain, name), rel=1e-6), name


def test_jitter_counts_with_its_mean() -> None:
    """Between 0 and a sample late: as a delay of half a sample, linearly interpolated, but for the mean of its numbers."""
    jitter, delay = (
        scene_margins(looped(PD, {"signal": "velocity", "sample_time": 1e-3, **each}), poses=1).worst.gain_margin
        for each in ({"kind": "jitter", "time": 1e-3}, {"kind": "delay", "time": 5e-4})
    )
    assert jitter == pytest.approx(delay, rel=0.02)


def lqg(position_error: float, measurement_noise: float, **other: Any) -> Scene:
    """A regulator that is designed at the start, stable there and at the end, but not everywhere in between."""
    design = {"position_error": position_error, "measurement_noise": measurement_noise, **other}
    return looped({"kind": "state-feedback", "pose": "start", "torque_deviation": 10.0, "sample_time": 1e-3, **design})


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
@pytest.mark.slow
@pytest.mark.parametrize("scene", [lqg(3e-5, 1e-4), lqg(1e-3, 1e-5)], ids=["a quarter of the path", "a hundredth"])
def test_the_worst_pose_is_found_between_stable_ends(scene: Scene) -> None:
    """As by a sweep over 41 poses; the command fails, and the run warns."""
    found = scene_margins(scene, poses=2)
    assert all(pose.is_stable for pose in found.poses if pose.s in (0.0, 1.0))
    assert not found.is_stable
    assert found.worst.gain_margin == 1.0
    loop = loop_of(scene, about_rest=True)
    course = PathLoop(WiredLoop(scene, loop), loop.motion)
    swept = [growth(next(course.loops(Place(s, course.payload)))[0]).real for s in np.linspace(0.0, 1.0, 41)]
    worst = max(found.poses, key=lambda pose: pose.radius)
    assert worst.poles[0].real == pytest.approx(max(swept), rel=0.02, abs=0.01)
    warning = stability_warning(flexfmu.run(scene))
    assert warning is not None
    assert f"the loop is unstable about the pose at {100.0 * worst.s:.2g}"[:-1] in warning


@pytest.mark.slow
@pytest.mark.parametrize("signal", ["joint1.velocity", "joint1.reference.velocity", "end_effector.velocity.x"])
def test_gains_are_those_of_the_motion(signal: str) -> None:
    """A gain that follows a velocity is the constant gain that it is at that velocity; the run of a too large one diverges."""
    over = {"over": signal, "at": [-3.0, -0.5, 0.5, 3.0], "derivative": [4.0, 1.0, 1.0, 4.0]}
    fast = scene_margins(looped({**PD, "schedule": over}).replace({"trajectory.duration": 0.1}), poses=2)
    assert not fast.is_stable
    assert all(pose.is_stable for pose in fast.poses if pose.s in (0.0, 1.0))
    slow = scene_margins(looped({**PD, "schedule": over}).replace({"trajectory.duration": 50.0}), poses=2)
    assert slow.is_stable
    assert slow.worst.gain_margin == pytest.approx(scene_margins(looped(PD), poses=2).worst.gain_margin, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signal", "at", "factors"),
    [
        ("end_effector.position.x", [0.0103, 0.0123, 0.0143], [1.0, 40.0, 1.0]),
        ("joint2.velocity", [0.0, 8.0], [1.0, 60.0]),
    ],
)
def test_narrow_peaks_of_schedules_are_found(signal: str, at: list[float], factors: list[float]) -> None:
    """Between the places of equal intervals a gain can peak for a hundredth of the path; an unstable loop has no largest sensitivity."""
    found = scene_margins(looped({**PD, "schedule": {"over": signal, "at": at, "derivative": factors}}), poses=2)
    assert not found.is_stable
    assert all(pose.is_stable for pose in found.poses if pose.s in (0.0, 1.0))
    assert np.isnan(found.worst.sensitivity_peak)


@pytest.mark.slow
def test_the_worst_payload_of_a_band_is_found() -> None:
    """A light payload is worst for a PD controller; what is worst over a band is worst with one of its payloads."""
    scene = looped(PD)
    found = flexfmu.margins(scene, poses=2, payload_band=(1.0, 8.0))
    each = [
        flexfmu.margins(looped(PD, {"kind": "payload-error", "relative": mass / 6.0 - 1.0}), poses=2).worst
        for mass in (1.0, 6.0, 8.0)
    ]
    assert found.worst.gain_margin == pytest.approx(min(one.gain_margin for one in each), rel=1e-6)
    assert found.worst.disk_margin == pytest.approx(min(one.disk_margin for one in each), rel=1e-6)
    assert {pose.payload for pose in found.poses} >= {1.0, 6.0}


LOOPS: dict[str, tuple[list[dict[str, Any]], dict[str, float]]] = {
    "single": ([{"kind": "delay", "time": 1e-3, "sample_time": 1e-3}], {"proportional": 2e3, "derivative": 15.0}),
    "several": ([{"kind": "lag", "time_constant": 2e-4}, {"kind": "delay", "time": 3e-4, "sample_time": 2.5e-4}], {}),
    "unstable": ([{"kind": "delay", "time": 5e-3, "sample_time": 1e-3}], {"proportional": 3e4, "derivative": 300.0}),
}
"""One sample time: curves are exact; several ones; and a delay that the gains don't bear."""


@cache
def margins_of(name: str) -> MarginsResult:
    """Those of the paper's robot with few modes and a PD."""
    imperfections, gains = LOOPS[name]
    return scene_margins(looped({**PD, **gains}, *imperfections), poses=2)


def curve_of(panel: Panel) -> Curve:
    """The drawn curve of the worst loop: the one with a colour and many points."""
    (found,) = (each for each in panel.curves if each.colour == FIRST and each.x.size > 100 and not each.dashes)
    return found


def test_margins_are_read_from_the_drawn_curves() -> None:
    """Magnitude where the phase passes -180 degrees, and phase where the magnitude passes 0 dB."""
    single = margins_of("single")
    worst = loop_curves(single.poses)[0].margins
    gain, phase = margin_plots(single.poses)[0].panels
    frequency, decibels, degrees = curve_of(gain).x, curve_of(gain).y, curve_of(phase).y
    expected = 20.0 * np.log10(worst.gain_margin)
    assert np.abs(-_read(decibels, (degrees + 180.0) / 360.0) - expected).min() < 0.01 * expected
    margins = 180.0 - np.abs(_read(degrees, 1e-4 * decibels) % 360.0)
    assert np.abs(margins).min() == pytest.approx(np.degrees(worst.phase_margin), rel=0.01)
    # and marked there, to scale
    (f, _), (top, bottom) = gain.curves[-1].x, gain.curves[-1].y
    assert (top, bottom) == (0.0, pytest.approx(-expected))
    assert np.interp(f, frequency, decibels) == pytest.approx(-expected, rel=0.01)


def _read(values: RealArray, turns: RealArray) -> RealArray:
    """Values where another curve passes a whole number, linearly between points."""
    k = np.flatnonzero(np.diff(np.floor(turns)))
    share = (np.maximum(np.floor(turns[k]), np.floor(turns[k + 1])) - turns[k]) / (turns[k + 1] - turns[k])
    return np.asarray(values[k] + share * (values[k + 1] - values[k]))


@pytest.mark.parametrize("name", ["single", "several"])
def test_curves_touch_the_disk_and_are_continuous(name: str) -> None:
    """They stay outside of each loop's own disk; with several sample times the margin is a bound, which the curve needn't reach. Phases
    have no jump by a turn, two turns on the axis at most, and -180 degrees among them."""
    result = margins_of(name)
    for curve in loop_curves(result.poses):
        middle, radius = disk_of(curve.margins.disk_margin)
        least = np.abs(curve.response - middle).min()
        assert least > (1.0 - 1e-3) * radius
        assert name == "several" or least < (1.0 + 1e-2) * radius
    # the drawn one is that of the worst
    bode, nyquist = margin_plots(result.poses)
    (disk,) = (each for each in nyquist.panels[0].curves if each.fill)
    assert (0.5 * (disk.x.min() + disk.x.max()), 0.5 * np.ptp(disk.x)) == pytest.approx(
        disk_of(min(row.disk_margin for p in result.poses for row in p.loops if row.channel != ALL)), rel=1e-3
    )
    phases = [each.y for each in bode.panels[1].curves if each.x.size > 100]
    assert np.nanmax(phases) - np.nanmin(phases) <= 720.0
    assert bode.panels[1].level == -180.0
    assert np.nanmax(np.abs(np.diff(phases))) < 180.0


def test_files_have_pictures(tmp_path: Path) -> None:
    """A table and three pictures, of unstable loops too; diagrams beside each other say so, and label one loop."""
    legends = [axes.get_legend() for axes in margins_of("unstable").plot().axes]
    assert sum("unstable" in text.get_text() for each in legends if each for text in each.get_texts()) == 2
    table, *pictures, page = write_margins(margins_of("unstable"), tmp_path)
    assert [path.name for path in (table, *pictures, page)] == [
        "margins.csv",
        "bode.png",
        "nyquist.png",
        "root-locus.png",
        "margins.html",
    ]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
