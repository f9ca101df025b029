"""What a run leaves behind for machines and people: summary.json and report.html with the moving mechanism and the magnified path."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from html import escape
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.files import to_json
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.experiment.accuracy import AccuracyAnswer, FigureError, PricedSettings, WorkPrecisionTrial
from flexfmu.cosim.experiment.cycles import in_cycles
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS, display, metric
from flexfmu.cosim.metrics.metrics import measure_run, settings_for
from flexfmu.cosim.metrics.small_deflections import exceeded
from flexfmu.cosim.reports.page import Figure
from flexfmu.cosim.reports.plots import draw_plots, magnification, path_panel, rigid_motion, robot_motion, to_scale
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import MOTOR_VALUES, describe_effects, summarise

MakeRun = Callable[..., Run]


class Tags(HTMLParser):
    """Fails unless every element of a page closes the one opened last."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open += [tag] if tag not in {"meta", "br", "hr", "img", "link", "input", "wbr"} else []

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def report_of(run: Run) -> str:
    """The report of a run."""
    settings = settings_for(run) if run.completed else None
    plots = draw_plots(run, None if settings is None else settings.end_equilibrium)
    return report_page(summarise(run, measure_run(run)), plots).html


def test_a_report_shows_what_accuracy_costs(make_run: MakeRun) -> None:
    """The answer's sentences, and every setting that was tried for each figure; what else is coarse isn't warned of."""
    figures = tuple(
        FigureError(name, unit, "0.01", 0.01 * value, value, 2e-3 * value, 1e-3 * value, 0.0, 3e-3 * value)
        for name, unit, value in (("peak_torque_1", "N.m", 70.0), ("residual_vibration_amplitude", "m", 1e-5))
    )
    costs = [(1e-1, 1e-3), (3e-3, 2e-3), (2e-3, 4e-3), (1e-5, 9e-3)]
    tried = [
        WorkPrecisionTrial(each.name, f"set {k % 2}", f"setting {k}", *cost)
        for each in figures
        for k, cost in enumerate(costs)
    ]
    chosen, own, dearest = (
        PricedSettings(f"set; setting {k}", time, 1.0) for k, time in ((1, 2e-3), (0, 1e-3), (9, 0.1))
    )
    answer = AccuracyAnswer(figures, chosen, own, dearest, None, {}, 4, "nothing is cheaper", tuple(tried))
    run = replace(make_run(), accuracy=answer)
    page, plots = report_of(run), {each.key: each for each in draw_plots(run, None)}
    Tags(page)
    assert all(escape(sentence).replace("&#x27;", "&#39;") in page for sentence in answer.lines())
    assert page.index("Accuracy</h2>") < page.index("what its accuracy costs") < page.index("Plots</h2>")
    for each in figures:
        (panel,) = plots[f"accuracy-{each.name}"].panels
        assert sum(curve.x.size for curve in panel.curves if curve.label.startswith("set ")) == len(costs)
        assert {marker.text: (marker.x, marker.y) for marker in panel.markers} == {
            "chosen": (pytest.approx(3e-3), pytest.approx(2.0)),
            "default": (pytest.approx(1e-1), pytest.approx(1.0)),
            "dearest": (pytest.approx(1e-12), pytest.approx(100.0)),
        }
    assert "tried" not in summarise(run, measure_run(run))["accuracy"]


def test_summary_has_the_contract_s_keys(make_run: MakeRun) -> None:
    """Users' scripts read these keys."""
    run = make_run()
    summary = summarise(run, measure_run(run))
    keys = "scene effects metrics errors own_metrics own_errors health slaves delays timing versions units"
    assert list(summary) == keys.split()
    assert list(summary["metrics"]) == list(COMMON_METRICS)
    assert {"flexfmu", "casadi", "fmpy", "numpy", "python", "platform", "compiler"} <= set(summary["versions"])
    assert summary["health"]["outcome"] == "completed"
    assert summary["health"]["warnings"] == []
    assert summary["timing"]["total"] == pytest.approx(0.37)
    assert json.loads(to_json(summary)) == json.loads(json.dumps(summary))


def test_curves_peak_at_the_metrics(make_run: MakeRun) -> None:
    """The report's curves are in the unit of their axis: the highest point of each is the metric beside it."""
    run = tracking(make_run())
    metrics = {name: measurement.value or 0.0 for name, measurement in measure_run(run).items()}
    panels = {plot.key: plot.panels[0] for plot in draw_plots(run, settings_for(run).end_equilibrium)}
    peaks = {key: [np.abs(curve.y) for curve in panel.curves] for key, panel in panels.items()}
    for key, factor, unit, names in (
        ("torques", 1.0, "N·m", ["peak_torque_1", "peak_torque_2"]),
        ("tracking", 1e3, "mrad", ["peak_tracking_error_1", "peak_tracking_error_2"]),
        ("position", 1e3, "mm", ["peak_position_error"]),
        ("dwell", 1e6, "µm", ["residual_vibration_amplitude"]),
    ):
        assert f"[{unit}]" in panels[key].label
        for curve, name in zip(peaks[key], names, strict=False):
            assert curve.max() == pytest.approx(factor * metrics[name], rel=2e-3), name


def tracking(run: Run) -> Run:
    """The run of a robot whose joints sway about their planned motion, by 3 and 6 mrad."""
    time, columns = run.recording.time, {}
    for joint in (1, 2):
        sway = [3e-3 * joint * 40.0**k * np.sin(40.0 * time + k * np.pi / 2) for k in range(5)]
        for order, kind in ((0, "position"), (2, "acceleration")):
            planned = run.recording[f"joint{joint}.reference.{kind}"]
            moved = np.array([planned.values, planned.first, planned.second]) + sway[order : order + 3]
            columns[f"joint{joint}.{kind}"] = Column("rad", *moved)
    return replace(run, recording=run.recording.with_columns(columns))


def test_coarse_step_is_said(make_run: MakeRun) -> None:
    """At 16 ms a 58 Hz vibration is hardly sampled once a period: the metrics that depend on it are named, others are not."""
    warnings = summarise(run := make_run(step=1.6e-2), measure_run(run))["health"]["warnings"]
    names = {warning["metric"] for warning in warnings}
    assert "residual_vibration_amplitude" in names
    assert "end_position_error" not in names
    assert "step of 0.016 s is too coarse" in report_of(run)
    assert all("communication step of 0.016 s is too coarse" in warning["message"] for warning in warnings)


@pytest.mark.slow
def test_large_deflections_are_said(make_run: MakeRun) -> None:
    """A link bent by half its length is no linear beam: summary and report say so, here by the deflection alone, since the
    coordinates weren't recorded."""
    run = make_run()
    assert summarise(run, measure_run(run))["health"]["large_deflections"] == []
    name = "link21.tip_deflection"
    bent = Column("m", *(0.0 * table for table in (run.recording.time,) * 3))
    bent.values[7] = -0.12
    bent_run = replace(run, recording=run.recording.with_columns({name: bent}))
    sentences = summarise(bent_run, measure_run(bent_run))["health"]["large_deflections"]
    assert len(sentences) == 1
    assert sentences[0].startswith("links bend by up to 50 % of their length: the path may be off by more than 50 %")
    assert "Links bend by up to 50 % of their length" in report_of(bent_run)


def test_the_larger_of_both_joints_is_shown(make_run: MakeRun) -> None:
    """As a figure, against the limit of both motors, and in the sentence on links that bend."""
    run = make_run()
    of_both = {"peak_torque": 70.0, "peak_tip_deflection": 1e-3}
    changed = {f"{name}_{joint}": value * joint for name, value in of_both.items() for joint in (1, 2)}
    summary = summarise(run, {**measure_run(run), **{name: metric(name, value) for name, value in changed.items()}})
    for limits in ((100.0, 100.0), (100.0, 90.0)):
        torques = [changed["peak_torque_1"], changed["peak_torque_2"]]
        summary["motors"] = [
            {
                **{key: None for key, _, _ in MOTOR_VALUES},
                "joint": joint,
                "name": "",
                "margins": [
                    {"name": "peak torque", "value": value, "limit": limit, "unit": "N.m", "use": value / limit}
                ],
            }
            for joint, (value, limit) in enumerate(zip(torques, limits, strict=True), 1)
        ]
        page = report_page(summary, ())
        (label, (torque,)), (other, (deflection,)), *_ = page.tiles
        has_limit = limits[0] == limits[1]
        assert label == "Peak torque, larger of both joints" + (", limit 100 N·m" if has_limit else "")
        assert other == "Tip deflection, larger of both links"
        assert torque == display("peak_torque_2", torques[1], 4)
        assert (torque.is_over, deflection.is_over) == (has_limit, False)
        assert "while its links bend by up to 2 mm" in "".join(page.verdict)


def test_an_unstable_loop_is_the_alarm(make_run: MakeRun) -> None:
    """Also where the communication step is too coarse, which is a warning."""
    run = make_run()
    summary = summarise(run, measure_run(run))
    coarse = {"metric": "settling_time", "estimated_error": 1e-3, "message": ""}
    summary["health"] |= {"unstable_loop": "joint1 grows", "warnings": [coarse]}
    notices = re.findall(r'<div class="notice (\w+)"( role="alert")?><b>(.*?)</b>', report_page(summary, ()).html)
    assert [each[:2] for each in notices] == [("failed", ' role="alert"'), ("warned", "")]
    assert notices[0][2] == "The loop is unstable."


@pytest.mark.parametrize(("share", "said"), [(0.009, 0), (0.011, 1)])
def test_large_elongations_are_said(make_run: MakeRun, share: float, said: int) -> None:
    """No metal stretches by more than a hundredth; the distal links' own length counts."""
    run = make_run()
    stretched = np.zeros_like(run.recording.time)
    stretched[5] = share * run.scene.mechanism.distal.length
    columns = {"link12.elongation": Column("m", stretched)}
    found = exceeded(replace(run, recording=run.recording.with_columns(columns)))
    assert len(found) == said


def test_large_deflections_are_said_in_percent(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """In two digits, without a power of ten."""
    run = make_run()
    monkeypatch.setattr("flexfmu.cosim.metrics.small_deflections.path_errors", lambda run: (0.9, 0.9))
    bent = {"link11.tip_deflection": Column("m", 1.6 * run.scene.mechanism.proximal.length + 0.0 * run.recording.time)}
    (sentence,) = exceeded(replace(run, recording=run.recording.with_columns(bent)))
    assert sentence.startswith("links bend by up to 160 % of their length: the path is off by more than 50 %")


def test_effects_that_are_not_there_are_not_listed(make_run: MakeRun) -> None:
    """The list of effects follows the scene."""
    scene = make_run().scene
    assert list(describe_effects(scene)) == ["proximal_bending", "distal_axial", "damping", "gravity", "payload"]
    without = {"effects.gravity": [0.0, 0.0], "effects.damping": {"kind": "none"}, "payload.mass": 0.0}
    bare = scene.replace({**without, "effects.distal_axial": 0})
    assert list(describe_effects(bare)) == ["proximal_bending"]
    assert list(describe_effects(bare.replace({"effects.proximal_bending": 0}))) == ["rigid"]


def test_cut_short_run_has_no_metrics(make_run: MakeRun) -> None:
    """Half a motion has no peak: null instead of a number that looks like one."""
    run = make_run(outcome=Outcome.STEP_FAILED, end=0.2)
    summary = summarise(run, measure_run(run))
    assert set(summary["metrics"].values()) == {None}
    assert summary["health"]["outcome"] == "step failed"
    assert summary["health"]["end_time"] == pytest.approx(0.2, abs=1e-3)


def test_report_is_one_offline_file(make_run: MakeRun) -> None:
    """No address, nothing to fetch; tags close in order; identifiers are unique and references resolve."""
    text = report_of(make_run())
    assert not re.search(r"https?:|@import|<img|src=", text.replace("/*! https://github.com/leeoniya/uPlot", ""))
    assert "default-src 'none'" in text
    Tags(text)
    identifiers = re.findall(r' id="([^"]+)"', text)
    assert len(identifiers) == len(set(identifiers))
    assert set(re.findall(r'href="(?!data:)#?([^)"]*)', text)) <= set(identifiers)


def test_report_shows_scene_metrics_and_plots(make_run: MakeRun) -> None:
    """Effects, every metric, every plot, parameters and versions are on the page."""
    text = report_of(make_run())
    assert text.count('class="chart"') == 9
    labels = [info.label for info in COMMON_METRICS.values()]
    words = ("Motor torques", "Residual vibration", "mechanism.base_half_distance", "Point mass of 6 kg", "fmpy")
    assert [wanted for wanted in (*labels, *words) if escape(wanted) not in text] == []


def test_a_verdict_has_no_rounding(make_run: MakeRun) -> None:
    """Lengths below 1e-12 m are zero and have no frequency; a robot that learns goes there and back."""
    run = make_run()
    summary, plots = summarise(run, measure_run(run)), [*draw_plots(run, settings_for(run).end_equilibrium)]
    assert "mostly at" in str([*report_page(summary, plots).verdict])
    summary["metrics"] |= {"residual_vibration_amplitude": 3.6e-16, "peak_position_error": 2.9e-16}
    summary["metrics"]["residual_vibration_rms"] = 1e-16
    summary["scene"]["controller"] = [{"kind": "learning", "cycles": 3}]
    page = report_page(summary, plots)
    verdict = "".join(page.verdict)
    assert "a residual vibration of 0 mm, within the settling band; it has no position error" in verdict
    assert "there and back 3 times with pauses of 0.25 s" in page.lead


def test_report_of_a_failed_run_says_so(make_run: MakeRun) -> None:
    """A run that broke off is shown as far as it came, under a notice; without any step that is the scene's picture."""
    text = report_of(make_run(outcome=Outcome.STEP_FAILED, end=0.2))
    assert "did not finish" in text
    assert "step failed at 0.2 s" in text
    assert "Residual vibration</h3>" not in text
    Tags(text)
    assert report_of(make_run(outcome=Outcome.INITIALISATION_FAILED, end=-1.0)).count('class="chart"') == 1


def test_report_escapes_what_it_shows(make_run: MakeRun) -> None:
    """A message of the FMU is text, not markup."""
    run = make_run()
    summary = summarise(run, dict.fromkeys(COMMON_METRICS, Metric(None)))
    summary["health"]["messages"] = ["<b>solver & state</b>"]
    assert "&lt;b&gt;solver &amp; state&lt;/b&gt;" in report_page(summary, []).html


@pytest.mark.parametrize(("largest", "times"), [(2.4e-4, 100.0), (2.5e-4, 50.0), (1.0, 1.0), (3e-12, 1.0), (0.0, 1.0)])
def test_magnification_is_a_round_number(largest: float, times: float) -> None:
    """A tenth of a proximal link of 0.24 m at most, 1, 2 or 5 times a power of ten, and never a reduction."""
    deviation = np.zeros((20, 2))
    deviation[7, 0] = largest * (1.0 - 1e-9)
    assert magnification(deviation, 0.24) == times


def test_the_path_is_magnified_about_the_rigid_one(make_run: MakeRun) -> None:
    """Rigid position plus m times the deviation; reading a point gives the deviation as recorded."""
    run = make_run()
    rigid, magnified = path_panel(run, 50.0).curves
    recorded = np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"])
    reference = np.stack([rigid.x, rigid.y])
    np.testing.assert_allclose(
        np.stack([magnified.x, magnified.y]), reference + 50.0 * (recorded - reference), rtol=1e-12
    )
    np.testing.assert_allclose(magnified.more["deviation in y [µm]"], 1e6 * (recorded - reference)[1], rtol=1e-12)
    np.testing.assert_array_equal(magnified.more["time [s]"], run.recording.time)


@pytest.mark.parametrize(
    ("changes", "begin"),
    [({"trajectory.duration": 60.0}, 0.0), ({"trajectory.way_back": "same-path", "trajectory.cycles": 3}, 2 * 0.86)],
    ids=["slow", "cycles"],
)
def test_a_slow_motion_is_shown_whole_and_of_cycles_the_last(
    changes: dict[str, Any], begin: float, make_run: MakeRun
) -> None:
    """The robot in motion and the path."""
    single = make_run()
    motion = in_cycles(plan(single.scene.replace({"trajectory.dwell": 0.0, **changes})))
    run = replace(single, plan=motion, recording=rigid_motion(motion))
    robot, (rigid, _) = robot_motion(run.plan, run.recording, run.robot), path_panel(run, 1.0).curves
    time = robot["rows"][0]
    assert [time[0], time[-1]] == pytest.approx([begin, run.plan.stop_time], abs=1e-2)
    assert robot["slower"] * np.ptp(time) == pytest.approx(6.0, rel=0.05)
    # there is the whole motion
    assert np.ptp(rigid.x) == pytest.approx(0.35, rel=1e-2)


def test_figures_of_pages_have_the_numbers_of_their_script() -> None:
    """A true minus, and powers of ten without a zero."""
    texts = {1.234e-6: "1.23e−6", -1.234e-6: "−1.23e−6", -2.5: "−2.5", 1.0e7: "1e7"}
    for value, text in texts.items():
        assert Figure.of("mean_power_1", value, digits=3) == f"{text} W"


@pytest.mark.parametrize(
    ("changes", "is_to_scale"),
    [
        ({}, False),  # 350 mm wide and 25 mm high
        ({"trajectory.height": 0.12, "trajectory.width": 0.12, "trajectory.start": [-0.06, 0.40]}, True),
        ({"trajectory.lift": [1.0, 0.0], "trajectory.width": 0.2, "trajectory.start": [0.0, 0.3]}, False),
    ],
)
def test_a_path_has_a_shape_that_shows_it(make_run: MakeRun, changes: dict[str, Any], is_to_scale: bool) -> None:
    """To scale where that is no strip; unequal scales are told."""
    plot = to_scale("k", "Path", "", path_panel(make_run(changes=changes), 1.0))
    assert plot.panels[0].is_to_scale == is_to_scale == ("different scales" not in plot.caption)
