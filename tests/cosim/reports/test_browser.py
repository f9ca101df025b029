"""Every page in Chromium: no errors, nothing fetched, no wider than the window, readable without scripts; charts zoom and show
recorded values, the mechanism moves."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexfmu.benchmarks.hard_cases import suite
from flexfmu.benchmarks.hard_cases.case import CaseReport
from flexfmu.cosim.engine.master.simulator import Outcome
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.accuracy import WorkPrecisionTrial
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import measure_run, settings_for
from flexfmu.cosim.reports.comparison import ComparedRun
from flexfmu.cosim.reports.plots import draw_plots, robot_motion
from flexfmu.cosim.reports.report import report_page
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.studies.compare.comparison import compare_runs
from flexfmu.cosim.studies.paper.report import PaperReport
from flexfmu.cosim.studies.paper.tables import TABLES, compare, evaluators, printed_table
from flexfmu.cosim.studies.workprec.figures import html
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy

pytestmark = pytest.mark.slow

MakeRun = Callable[..., Run]
MOVING = ("report", "failed", "workprec", "paper")
"""Pages with the robot in motion."""

PAPER = 700
"""Width of what is printed on A4 [px]."""

PAGES = ("report", "failed", "comparison", "measured", "workprec", "hard-cases", "paper")


@pytest.fixture(scope="module")
def run(make_run: MakeRun) -> Run:
    """A run with a residual vibration."""
    return make_run()


@pytest.fixture(scope="module")
def folder(run: Run, make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all pages."""

    def report(of: Run) -> str:
        rest = settings_for(of).end_equilibrium if of.completed else None
        return report_page(summarise(of, measure_run(of)), draw_plots(of, rest)).html

    trials = [
        WorkPrecisionTrial("tools", f"method {line}", f"{error:g}", error, 1e-3 * (line + 1) * error**-0.2)
        for line in range(10)
        for error in (1e-2, 1e-5, 1e-8)
    ]
    trials.append(WorkPrecisionTrial("tools", "rk4", "5 ms", None, None, note="blew up"))
    other = make_run(changes={"payload.mass": 3.0})
    compared = [
        ComparedRun(f"{each.scene.payload.mass:g} kg", each.recording, measure_run(each), 0.43) for each in (run, other)
    ]
    # the torques of the first run 12.3 ms late, with noise
    noise = 0.5 * np.random.default_rng(0).standard_normal(run.recording.time.size)
    torques = {name: Column("N.m", run.recording[name].values + noise) for name in ("joint1.torque", "joint2.torque")}
    late = Recording(run.recording.time + 0.0123, torques)
    texts = {
        "report": report(run),
        "failed": report(make_run(outcome=Outcome.STEP_FAILED, end=0.2)),
        "comparison": compare_runs(compared).page(),
        "measured": compare_runs(compared, late).page(),
        "workprec": html(WorkPrecisionStudy(run.scene, 0.68, 1e-3, None, "", tuple(trials))),
        "hard-cases": suite.html(
            [suite.HardCaseResult(case, CaseReport("so it was", ())) for case in suite.hard_cases()]
        ),
        "paper": PaperReport(tuple(compare(printed_table(key), evaluators()) for key in TABLES[:3])).to_html(Path()),
    }
    out = tmp_path_factory.mktemp("pages")
    for name, text in texts.items():
        (out / f"{name}.html").write_text(text, encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def report(browser: Any, folder: Path) -> Iterator[Any]:
    """The report of the run at a usual width."""
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(f"file://{folder / 'report.html'}")
    yield page
    page.close()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_on_a_phone_and_on_a_desk(name: str, browser: Any, folder: Path) -> None:
    """Neither errors nor requests, at most 1 MB, and nothing beyond the window's edge; without scripts too."""
    path = folder / f"{name}.html"
    assert path.stat().st_size < 1e6
    for has_scripts in (True, False):
        context = browser.new_context(java_script_enabled=has_scripts)
        page, problems = context.new_page(), list[str]()
        page.on("console", lambda message, found=problems: found.append(message.text))
        page.on("pageerror", lambda error, found=problems: found.append(str(error)))
        page.on("request", lambda request, found=problems: found.append(request.url))
        page.goto(f"file://{path}")
        for width in (1200, 390):
            page.set_viewport_size({"width": width, "height": 800})
            page.wait_for_timeout(50.0)
            if has_scripts:
                assert page.evaluate("document.documentElement.scrollWidth") == width
            # tables are blocks on a phone
            cards = page.locator(".card").evaluate_all("all => all.map(each => each.scrollWidth - each.clientWidth)")
            assert width > 390 or max(cards, default=0) == 0
            shown = ".panel" if has_scripts else "svg.plain"
            boxes = page.locator(shown).evaluate_all("all => all.map(each => each.getBoundingClientRect().toJSON())")
            assert len(boxes) >= page.locator(".chart").count()
            for box in boxes:
                assert box["left"] >= 0.0
                assert box["right"] <= width
                assert box["height"] > 60.0
        assert page.locator("h1").inner_text()
        assert page.locator(".controls").count() == (has_scripts and name in MOVING)
        assert problems == [f"file://{path}"]
        context.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_on_paper(name: str, scheme: str, browser: Any, folder: Path) -> None:
    """Black on white, nothing beyond the edge or without use there, charts within their columns, and legends with their colours."""
    context = browser.new_context(color_scheme=scheme, viewport={"width": 1400, "height": 900})
    page = context.new_page()
    page.goto(f"file://{folder / name}.html")
    page.emulate_media(media="print")
    page.set_viewport_size({"width": PAPER, "height": 900})
    page.wait_for_timeout(200.0)
    assert page.evaluate("document.documentElement.scrollWidth") == PAPER
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    for box in page.locator("canvas, table, figure").evaluate_all(
        "all => all.map(each => each.getBoundingClientRect().toJSON())"
    ):
        assert box["right"] <= PAPER
    for style in page.locator(".key i").evaluate_all("all => all.map(each => getComputedStyle(each).printColorAdjust)"):
        assert style == "exact"
    # ink that is dark on paper, in charts too
    ink = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--ink')")
    assert ink.strip() == "#1c2733"
    assert not any(each.is_visible() for each in page.locator("button:not(.key), input, details:not([open])").all())
    context.close()


def chart_of(page: Any, title: str) -> Any:
    """The chart below a heading."""
    figure = page.locator("figure", has=page.locator("h3", has_text=re.compile(f"^{re.escape(title)}$")))
    figure.scroll_into_view_if_needed()
    return figure


def put_into_view(page: Any, title: str) -> Any:
    """The chart below a heading, in view; its place on the page."""
    figure = chart_of(page, title)
    return figure, figure.locator(".u-over").first.bounding_box()


def values_in(figure: Any) -> list[float]:
    """The instant that a chart shows, then the values of its curves."""
    said = re.search(r"time (\S+) s", figure.locator(".said").inner_text())
    assert said is not None
    texts = [said[1], *figure.locator(".key output").all_inner_texts()]
    return [float(each.split()[0].replace("−", "-")) for each in texts]


def test_pointing_shows_recorded_values_in_all_charts(report: Any, run: Run) -> None:
    """Time and both torques at an instant, also in a chart that isn't pointed at; and the robot at that instant."""
    figure, box = put_into_view(report, "Motor torques")
    other = chart_of(report, "Motor torques"), chart_of(report, "Tip deflections")
    for share in (0.3, 0.5, 0.7):
        chart_of(report, "Motor torques")
        box = figure.locator(".u-over").first.bounding_box()
        report.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        time, *torques = values_in(other[0])
        assert len(torques) == 2
        for joint, torque in enumerate(torques, start=1):
            exact = np.interp(time, run.recording.time, run.recording[f"joint{joint}.torque"].values)
            # the nearest of the page's points, at most half a communication step away
            assert torque == pytest.approx(exact, rel=0.02, abs=1.0)
        assert values_in(other[1])[0] == time
        moved = chart_of(report, "Scene").locator(".controls output").first.inner_text()
        assert float(moved.removesuffix(" ms")) == pytest.approx(1e3 * time, abs=3.0)


def test_a_finger_shows_values(browser: Any, folder: Path) -> None:
    """At the place of the tap."""
    context = browser.new_context(viewport={"width": 390, "height": 800}, has_touch=True)
    page = context.new_page()
    page.goto(f"file://{folder / 'report.html'}")
    figure, box = put_into_view(page, "Motor torques")
    page.touchscreen.tap(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    assert len(values_in(figure)) == 3
    context.close()


LIMITS = "page.charts.filter(each => each.overTime).map(each => each.panels[0].shown.x)"


def test_zooming_and_back(report: Any) -> None:
    """A drag shows less time in all charts over time; keys and a button show the whole again."""
    before, (figure, box) = report.evaluate(LIMITS), put_into_view(report, "Motor torques")
    report.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 60)
    report.mouse.down()
    report.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 70, steps=3)
    report.mouse.up()
    zoomed = report.evaluate(LIMITS)
    spans = [high - low for low, high in zoomed]
    # all but those of the dwell, which begin later
    assert sum(span < 0.1 for span in spans) == len(spans) - 1
    assert len({*map(tuple, zoomed[:3])}) == 1
    figure.get_by_role("button", name="reset zoom").click()
    assert report.evaluate(LIMITS) == before
    chart = figure.locator(".chart")
    for key in ("+", "ArrowRight", "0"):
        chart.press(key)
    assert report.evaluate(LIMITS) == before
    # wherever the focus is
    chart.press("+")
    report.get_by_role("button", name="play").press("Escape")
    assert report.evaluate(LIMITS) == before
    assert values_in(figure)


def test_a_zoom_between_points_shows_the_line_there(report: Any, run: Run) -> None:
    """The vertical axis has the values at both ends of an interval shorter than a step."""
    begin, end = 0.30002, 0.30008
    shown = "each => each.panels[0].shown.y"
    report.evaluate(f"page.charts.find(each => each.key === 'torques').zoom([{begin}, {end}])")
    low, high = report.evaluate(f"({shown})(page.charts.find(each => each.key === 'torques'))")
    report.evaluate("page.charts.find(each => each.key === 'torques').reset()")
    torques = [run.recording[f"joint{i}.torque"].values for i in (1, 2)]
    ends = [float(np.interp(t, run.recording.time, each)) for each in torques for t in (begin, end)]
    margin = 0.05 * np.ptp(ends)
    assert (low, high) == pytest.approx((min(ends) - margin, max(ends) + margin), rel=2e-3)


def test_the_name_of_a_mark_lies_on_no_curve(report: Any) -> None:
    """There is a line for it above all curves."""
    room = """page.charts.filter(({ overTime }) => overTime).flatMap(({ panels }) => panels.filter(({ marks }) => marks.length).map(({ plot, curves }) =>
      plot.valToPos(Math.max(...curves.flatMap(({ y }) => [...y].filter(isFinite))), 'y')))"""
    found = report.evaluate(room)
    assert found
    assert min(found) > 15.0


def test_a_zoom_stays_in_another_window_and_plays(report: Any) -> None:
    """Limits are the same at another width, those to scale about the same middle; the robot moves within the part in view alone."""
    limits = """() => page.charts.filter(({ key }) => ['scene', 'torques'].includes(key)).map(({ panels: [{ shown }] }) => [shown.x, shown.y])"""
    report.evaluate("page.charts.find(({ key }) => key === 'torques').zoom([0.1, 0.2])")
    # to scale: half as wide, about the middle
    report.evaluate("""() => { const chart = page.charts[0], [panel] = chart.panels, [[x0, x1], [y0, y1]] = [panel.shown.x, panel.shown.y];
      panel.show([0.75 * x0 + 0.25 * x1, 0.25 * x0 + 0.75 * x1], [y0, y1]); chart.button.hidden = false; }""")
    (scene_x, scene_y), torques = report.evaluate(limits)
    assert torques[0] == [0.1, 0.2]
    report.set_viewport_size({"width": 800, "height": 900})
    report.wait_for_timeout(300.0)
    (x, y), again = report.evaluate(limits)
    assert again == torques
    assert x == scene_x
    assert sum(y) == pytest.approx(sum(scene_y))
    # of frames, the one before the first among them
    instants = report.evaluate("""async () => { const { motion } = page.charts[0].panels[0], seen = []; motion.play();
      for (const end = performance.now() + 1500; performance.now() < end;) { await new Promise(requestAnimationFrame); seen.push(motion.time[motion.frame]); }
      motion.stop(); return seen; }""")
    assert 0.095 < min(instants) < max(instants) < 0.205
    report.set_viewport_size({"width": 1200, "height": 900})
    report.evaluate("page.charts.forEach(each => each.reset())")


def test_the_legend_hides_a_curve(report: Any) -> None:
    """And shows it again."""
    key = chart_of(report, "Tip deflections").get_by_role("button", name="link 2")
    hidden = "page.charts.find(each => each.key === 'deflections').panels[0].curves.map(each => !!each.off)"
    assert report.evaluate(hidden) == [False, False]
    key.click()
    assert report.evaluate(hidden) == [False, True]
    key.click()
    assert report.evaluate(hidden) == [False, False]


def test_the_mechanism_moves(report: Any, run: Run) -> None:
    """The slider's instant and magnification: the end effector is at the rigid position plus the magnified deviation, within the axes."""
    figure, robot = chart_of(report, "Scene"), robot_motion(run.plan, run.recording, run.robot)
    instants, x, y, dx, dy, *_ = np.asarray(robot["rows"], "<f4").astype(float)
    set_to = "(input, value) => { input.value = value; input.dispatchEvent(new Event('input')); }"
    place = """() => { const panel = page.charts[0].panels[0], { motion, shown } = panel, ends = [motion.extent('x'), motion.extent('y')];
      return [motion.at(motion.frame, motion.count - 1), ends, [shown.x, shown.y]]; }"""
    time, deflection = figure.locator(".controls input").all()
    for frame, power in ((0, 0.0), (100, 2.0), (instants.size - 1, 1.0)):
        time.evaluate(set_to, frame)
        deflection.evaluate(set_to, power)
        end, extents, shown = report.evaluate(place)
        expected = [each[frame] + 10.0**power * moved[frame] for each, moved in ((x, dx), (y, dy))]
        np.testing.assert_allclose(end, expected, rtol=1e-6)
        for (low, high), (first, last) in zip(extents, shown, strict=True):
            assert first < low < high < last
        assert f"{1e3 * instants[frame]:.0f} ms" in figure.locator(".controls output").first.inner_text()
    # it plays
    time.evaluate(set_to, 0)
    figure.get_by_role("button", name="play").click()
    while int(time.input_value()) == 0:
        report.wait_for_timeout(50.0)
    figure.get_by_role("button", name="pause").click()


@pytest.mark.parametrize(("name", "is_flexible"), [("report", True), ("workprec", False), ("paper", False)])
def test_what_does_not_deflect_is_not_magnified(name: str, is_flexible: bool, browser: Any, folder: Path) -> None:
    """A rigid robot in motion has no slider of its deflection."""
    page = browser.new_page()
    page.goto(f"file://{folder / name}.html")
    assert page.locator(".controls label", has_text="deflection").count() == is_flexible
    page.close()


def test_axe_finds_nothing(browser: Any, folder: Path) -> None:
    """No page violates a rule of accessibility that axe knows, in both colour schemes, on a desk and on a phone, all that is folded open."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright").Axe
    for scheme in ("light", "dark"):
        context = browser.new_context(color_scheme=scheme, bypass_csp=True)
        page = context.new_page()
        for name, width in product(PAGES, (1400, 390)):
            page.set_viewport_size({"width": width, "height": 900})
            page.goto(f"file://{folder / name}.html")
            page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
            found = axe().run(page).response["violations"]
            assert [(name, width, each["id"], each["nodes"][0]["html"][:200]) for each in found] == []
        context.close()
