"""Every page in Chromium: no errors, nothing fetched, no wider than the window, readable without scripts; charts zoom and show
recorded values, the mechanism moves."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
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
from flexfmu.cosim.reports.plots import bent_robot, draw_plots
from flexfmu.cosim.reports.report import render_report
from flexfmu.cosim.reports.summary import summarise
from flexfmu.cosim.studies.compare.comparison import compare_runs
from flexfmu.cosim.studies.paper.report import PaperReport
from flexfmu.cosim.studies.workprec.figures import html
from flexfmu.cosim.studies.workprec.study import WorkPrecisionStudy

pytestmark = pytest.mark.slow

MakeRun = Callable[..., Run]
PAGES = ("report", "failed", "comparison", "measured", "workprec", "hard-cases", "paper")
ARGUMENTS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@pytest.fixture(scope="module")
def run(make_run: MakeRun) -> Run:
    """A run with a residual vibration."""
    return make_run()


@pytest.fixture(scope="module")
def folder(run: Run, make_run: MakeRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all pages."""

    def report(of: Run) -> str:
        rest = settings_for(of).end_equilibrium if of.completed else None
        return render_report(summarise(of, measure_run(of)), draw_plots(of, rest))

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
        "paper": PaperReport().to_html(Path()),
    }
    out = tmp_path_factory.mktemp("pages")
    for name, text in texts.items():
        (out / f"{name}.html").write_text(text, encoding="utf-8")
    return out


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One browser for all tests."""
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("needs chromium")
    with pytest.importorskip("playwright.sync_api").sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report(browser: Any, folder: Path) -> Iterator[Any]:
    """The report of the run at a usual width."""
    page = browser.new_page(viewport={"width": 1200, "height": 900})
    page.goto(f"file://{folder / 'report.html'}")
    yield page
    page.close()


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_on_a_phone_and_on_a_desk(name: str, browser: Any, folder: Path) -> None:
    """Neither errors nor requests, at most 1.5 MB, and nothing beyond the window's edge; without scripts too."""
    path = folder / f"{name}.html"
    assert path.stat().st_size < 1.5e6
    for has_scripts in (True, False):
        context = browser.new_context(java_script_enabled=has_scripts)
        page, problems = context.new_page(), list[str]()
        page.on("console", lambda message, found=problems: found.append(message.text))
        page.on("pageerror", lambda error, found=problems: found.append(str(error)))
        page.on("request", lambda request, found=problems: found.append(request.url))
        page.goto(f"file://{path}")
        for width in (1200, 390):
            page.set_viewport_size({"width": width, "height": 800})
            if has_scripts:
                assert page.evaluate("document.documentElement.scrollWidth") == width
            boxes = page.locator("svg.chart").evaluate_all(
                "all => all.map(each => each.getBoundingClientRect().toJSON())"
            )
            for box in boxes:
                assert box["left"] >= 0.0
                assert box["right"] <= width
                assert box["height"] > 60.0
        assert page.locator("h1").inner_text()
        assert page.locator(".controls").count() == (has_scripts and name in ("report", "failed"))
        assert problems == [f"file://{path}"]
        context.close()


def chart_of(page: Any, title: str) -> Any:
    """The chart below a heading."""
    figure = page.locator("figure", has=page.locator("h3", has_text=re.compile(f"^{re.escape(title)}$")))
    figure.scroll_into_view_if_needed()
    return figure


def values_in(text: str) -> list[float]:
    """The value in each line of a text that shows some."""
    lines = (re.findall(r" (−?[\d.]+(?:e[−+]?\d+)?)(?= |$)", line) for line in text.splitlines())
    return [float(found[-1].replace("−", "-")) for found in lines]


def test_pointing_shows_recorded_values(report: Any, run: Run) -> None:
    """Time and both torques at an instant, to the six digits that are shown."""
    figure = chart_of(report, "Motor torques")
    box = figure.locator("svg").bounding_box()
    for share in (0.3, 0.5, 0.7):
        report.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        time, *torques = values_in(figure.locator(".tip").inner_text())
        for joint, torque in enumerate(torques, start=1):
            exact = np.interp(time, run.recording.time, run.recording[f"joint{joint}.torque"].values)
            # the instant has six digits too, and a point between communication points is the interpolant's
            assert torque == pytest.approx(exact, rel=2e-3, abs=0.05)
        assert len(torques) == 2


def test_a_finger_shows_values(browser: Any, folder: Path) -> None:
    """They stay after the tap, until the next one."""
    context = browser.new_context(viewport={"width": 390, "height": 800}, has_touch=True)
    page = context.new_page()
    page.goto(f"file://{folder / 'report.html'}")
    figure, other = chart_of(page, "Motor torques"), page.locator("h1")
    box = figure.locator("svg").bounding_box()
    page.touchscreen.tap(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    assert len(values_in(figure.locator(".tip").inner_text())) == 3
    other.scroll_into_view_if_needed()
    other.tap()
    assert not figure.locator(".tip").is_visible()
    context.close()


def test_zooming_and_back(report: Any) -> None:
    """A drag shows less time at the width of the chart; the whole is what Python has drawn, ticks and curves."""
    figure = chart_of(report, "Motor torques")
    texts = "[...document.querySelectorAll('.ticks')].map(each => [...each.children].map(text => text.textContent).join(' '))"
    before, box = report.evaluate(texts), figure.locator("svg").bounding_box()
    curve = figure.locator(".curve").first
    first = curve.get_attribute("d")
    report.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 100)
    report.mouse.down()
    report.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 120, steps=3)
    report.mouse.up()
    assert report.evaluate(texts) != before
    shown = [float(each) for each in figure.locator(".ticks text[text-anchor=middle]").all_text_contents()]
    assert 0.02 < shown[-1] - shown[0] < 0.08
    figure.get_by_role("button", name="reset zoom").click()
    assert report.evaluate(texts) == before
    path = [
        np.array(re.findall(r"[\d.]+", each or ""), dtype=float).reshape(-1, 2)
        for each in (first, curve.get_attribute("d"))
    ]
    again = np.interp(path[0][:, 0], *path[1].T)
    assert np.abs(again - path[0][:, 1]).max() < 0.11


def test_all_ticks_are_python_s(browser: Any, folder: Path) -> None:
    """Logarithmic ones as well: the script has the same rules."""
    texts = "[...document.querySelectorAll('.ticks')].map(each => [...each.children].map(text => text.textContent).join(' '))"
    for name in ("comparison", "workprec"):
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.goto(f"file://{folder / name}.html")
        before = page.evaluate(texts)
        for chart in page.locator("svg.chart").all():
            chart.press("+")
            chart.press("0")
        assert page.evaluate(texts) == before
        page.close()


def test_the_legend_hides_a_curve(report: Any) -> None:
    """And shows it again."""
    figure = chart_of(report, "Tip deflections")
    key, curve = (figure.locator(f".{name}[data-label='link 2']") for name in ("key", "curve"))
    assert curve.is_visible()
    key.click()
    assert not curve.is_visible()
    key.click()
    assert curve.is_visible()


def test_the_mechanism_moves(report: Any, run: Run) -> None:
    """The slider's instant and magnification: the end effector is at the rigid position plus the magnified deviation."""
    figure, robot = chart_of(report, "Scene"), bent_robot(run)
    axes = [float(each) for each in (figure.locator(".panel").get_attribute("data-axes") or "").split()]
    set_to = "(input, value) => { input.value = value; input.dispatchEvent(new Event('input')); }"
    time, deflection = figure.locator("input").all()
    for frame, power in ((0, 0.0), (100, 2.0), (robot.time.size - 1, 1.0)):
        time.evaluate(set_to, frame)
        deflection.evaluate(set_to, power)
        x, y = robot.rigid[frame, -1] + 10.0**power * robot.deviation[frame, -1]
        end = figure.locator("svg g[clip-path] circle")
        left = axes[2] + (x - axes[0]) / (axes[1] - axes[0]) * (axes[3] - axes[2])
        down = axes[7] + (y - axes[5]) / (axes[6] - axes[5]) * (axes[8] - axes[7])
        assert float(end.get_attribute("cx") or 0.0) == pytest.approx(left, abs=0.06)
        assert float(end.get_attribute("cy") or 0.0) == pytest.approx(down, abs=0.06)
        assert f"{1e3 * robot.time[frame]:.0f} ms" in figure.locator("output").first.inner_text()
    # it plays
    time.evaluate(set_to, 0)
    figure.get_by_role("button", name="play").click()
    while int(time.input_value()) == 0:
        report.wait_for_timeout(50.0)
