"""What pages say first: an unstable loop before all else, and the figures of what was simulated."""

from __future__ import annotations

import html
import re
import warnings
from pathlib import Path

import control
import numpy as np
import pytest
from scipy.optimize import brentq

import flexfmu
from flexfmu.cosim.design.margins.loop_warnings import loop_sentences
from flexfmu.cosim.experiment.accuracy import WorkPrecisionTrial
from flexfmu.cosim.metrics.metrics import measure_run, settings_for
from flexfmu.cosim.reports.plots import draw_plots
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import instability, summarise
from flexfmu.cosim.studies.paper.report import PaperReport
from flexfmu.cosim.studies.workprec.figures import html as workprec_page
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy
from flexfmu.model.scene.schema import Scene

SAMPLE = 1e-3
"""Sample time of the loops [s]."""

SCENE = flexfmu.load_scene("barnard2012-6kg").replace(
    {
        "effects.proximal_bending": 1,
        "effects.distal_axial": 0,
        "effects.motor_inertia": 0.1,
        "trajectory.dwell": 0.1,
        "cosimulation.step": 1e-3,
        "cosimulation.tolerance": 1e-4,
        "cosimulation.drive": "torque",
    }
)


def loop(name: str, stiffness: float, damping: float) -> Scene:
    """The scene under a PD law."""
    pd = {"kind": "pd", "proportional": stiffness, "derivative": damping, "sample_time": SAMPLE}
    return SCENE.replace({"name": name, "controller": [pd]})


@pytest.mark.parametrize("weight", [0.0, -9.81])
def test_what_stays_is_called_an_offset(weight: float) -> None:
    """Under its weight a PD loop rests beside its end, where it doesn't ring."""
    run = flexfmu.run(loop("weight", 5e3, 50.0).replace({"effects.gravity": [0.0, weight], "trajectory.dwell": 0.6}))
    summary, place = summarise(run, measure_run(run)), settings_for(run).end_equilibrium
    text = report_page(summary, draw_plots(run, place)).html
    assert ("mostly an offset that stays" in text) == (weight != 0.0)
    # the same from the signals: how far the mean of the last tenth is off the end, and what swings about it
    last = run.recording.time > run.recording.time[-1] - 0.05
    off = [run.recording[f"end_effector.position.{axis}"].values[last] for axis in "xy"]
    mean = float(np.hypot(*(each.mean() - rest for each, rest in zip(off, place, strict=True))))
    assert (mean > 10.0 * max(np.ptp(each) for each in off)) == (weight != 0.0)


def growth(stiffness: float, damping: float) -> float:
    """Largest eigenvalue of the sampled loop about rest at both ends of the path, by python-control."""
    law = np.array([[stiffness, 0.0, damping, 0.0], [0.0, stiffness, 0.0, damping]])
    names = [f"joint{joint}.{what}" for what in ("position", "velocity") for joint in (1, 2)]
    found = []
    for place in ((-0.175, 0.32), (0.175, 0.32)):
        robot = flexfmu.linearize(SCENE, place, names)
        sampled = control.sample_system(control.ss(robot.A, robot.B[:, :2], robot.C, robot.D[:, :2]), SAMPLE)
        found.append(np.abs(np.linalg.eigvals(sampled.A - sampled.B @ law @ sampled.C)).max())
    return float(max(found))


def verdict_of(page: str) -> str:
    """The first sentence of a page."""
    found = re.search(r'<p class="verdict">(.*?)</p>', page, re.DOTALL)
    assert found is not None
    return html.unescape(re.sub(r"<[^>]*>", "", found[1]))


@pytest.mark.slow
def test_unstable_is_the_first_word_and_never_ranks() -> None:
    """For drawn gains, where python-control has an eigenvalue outside the unit circle: in reports and in comparisons, of scenes and of runs."""
    rng = np.random.default_rng(4)
    drawn = np.exp(rng.uniform(np.log([2e3, 60.0]), np.log([2e4, 600.0]), (12, 2)))
    sizes = [growth(*each) for each in drawn]
    chosen = [k for k, size in enumerate(sizes) if abs(size - 1.0) > 1e-3][:8]
    unstable = {f"loop{k}" for k in chosen if sizes[k] > 1.0}
    assert 2 <= len(unstable) <= len(chosen) - 2
    scenes, finished = [loop(f"loop{k}", *drawn[k]) for k in chosen], []
    for scene in scenes:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run = flexfmu.run(scene)
        summary = summarise(run, measure_run(run, 0))
        summary["health"] |= loop_sentences(run)
        assert bool(instability(summary["health"])) == (scene.name in unstable)
        page = report_page(summary, ()).html
        assert verdict_of(page).startswith("Unstable. ") == (scene.name in unstable)
        assert ('role="alert"' in page) == (scene.name in unstable)
        finished += [run] if run.completed else []
    for sources in (scenes, finished):
        there = [each.name if isinstance(each, Scene) else each.scene.name for each in sources]
        compared = flexfmu.compare(*sources)
        first, *ranks = verdict_of(compared.page()).split(". ")
        assert first == f"Unstable or failed: {', '.join(name for name in there if name in unstable)}"
        good = [run for run in compared.runs if run.name not in unstable]
        vibration, torque = ("residual_vibration_amplitude",), ("peak_torque_1", "peak_torque_2")
        for names, sentence in zip((vibration, torque), ranks, strict=False):
            worst = {run.name: max(run.metrics[name].value or 0.0 for name in names) for run in good}
            assert sentence.split()[0] == min(worst, key=worst.__getitem__)


def test_results_of_an_unstable_run_stay_unstable() -> None:
    """By the run, by the loop at rest where the run shows nothing yet, and of a run that ended."""
    assert instability({"outcome": "completed", "unstable_loop": "joint1 grows", "stability": None}) == "joint1 grows"
    about_rest = {"outcome": "completed", "unstable_loop": None, "stability": "the loop is unstable about the end"}
    assert instability(about_rest | {"stable": False}) == "the loop is unstable about the end"
    assert instability(about_rest | {"stability": "the loop is close to instability", "stable": True}) == ""
    assert instability({"outcome": "loop unstable", "message": "joint2 grows"}) == "joint2 grows"


@pytest.mark.slow
def test_pages_about_a_scene_have_one_frame() -> None:
    """A verdict, up to six figures, the robot in motion, what it is made of folded away: of every command."""
    scene = loop("loop", 5e3, 60.0).replace({"trajectory.dwell": 0.05})
    trials = (WorkPrecisionTrial("tools", "method", "1e-5", 1e-5, 1e-3, ""),)
    tuned = flexfmu.tune(scene, {"pd.kp": (4e3, 6e3)}, trials=3, processes=1)
    pages = {
        "run": report_page(summarise(run := flexfmu.run(scene), measure_run(run, 0)), draw_plots(run, None)).html,
        "compare": flexfmu.compare(run, flexfmu.run(scene.replace({"name": "other", "pd.kp": 4e3}))).page(),
        "sweep": flexfmu.sweep(scene, {"payload.mass": [5.0, 6.0]}, processes=1).page(),
        "margins": flexfmu.margins(scene, poses=1).page(),
        "tune": tuned.page(),
        "workprec": workprec_page(WorkPrecisionStudy(scene, 0.68, 1e-3, None, "", trials)),
        "paper": PaperReport().to_html(Path()),
    }
    for name, page in pages.items():
        assert verdict_of(page), name
        assert page.count('class="tile"') >= 1, name
        assert page.count('"motion":{') == 1, name
        assert "<summary>Scene file</summary>" in page, name
        assert "<summary>Effects</summary>" in page, name
    assert pages["compare"].count('class="tile"') == pages["margins"].count('class="tile"') == 6
    assert "<summary>Slaves</summary>" in pages["compare"]


@pytest.mark.slow
def test_a_tuning_never_ends_at_an_unstable_loop() -> None:
    """Gains just beyond the limit of stability by python-control, where a run has smaller errors than with those that were given."""
    limit = brentq(lambda damping: growth(5e3, damping) - 1.0, 60.0, 2e3)
    scene = loop("loop", 5e3, 30.0)
    tuned = flexfmu.tune(scene, {"pd.kd": (1.0002 * limit, 1.0004 * limit)}, method="sample", trials=3, processes=1)
    assert tuned.values == {}
    assert [bool(trial.message) for trial in tuned.trials] == [False, True, True]
    assert all(trial.message.startswith("the loop is unstable about") for trial in tuned.trials[1:])
    assert verdict_of(tuned.page()).startswith("RMS tracking error")
