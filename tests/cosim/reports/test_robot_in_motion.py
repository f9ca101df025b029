"""The robot as a page's script bends and moves it, against inverse kinematics, shape functions and the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.reports.page import Page
from flexfmu.cosim.reports.plots import robot_motion, scene_plot
from flexfmu.model.beams import scene_shapes
from flexfmu.model.scene.assembly import bases, elbows

pytestmark = pytest.mark.slow

MakeRun = Callable[..., Run]
Show = Callable[[Run], "Shown"]

ROUNDED = 1e-7
"""Of what a page has as 32-bit numbers [m]."""

MOTION = """() => { const { motion } = page.charts[0].panels[0], lists = (all) => [...all];
  return [motion.count, lists(motion.time), lists(motion.rigid), lists(motion.deviation), motion.chains.map((each) => each.points), [motion.extent("x"), motion.extent("y")], motion.times]; }"""


@dataclass
class Shown:
    """The motion of a page: instants (F,), points (F, P, 2) of the rigid robot and deviations from them, points of links, what the axes
    hold, and the magnification."""

    time: Any
    rigid: Any
    deviation: Any
    links: list[list[int]]
    extent: Any
    magnification: float


@pytest.fixture
def show(browser: Any, tmp_path: Path) -> Show:
    """Opens a page with a run's robot in Chromium."""

    def shown(run: Run) -> Shown:
        plot = scene_plot(run.plan, robot_motion(run.plan, run.recording, run.robot))
        path = tmp_path / "page.html"
        path.write_text(Page("page", ["A robot."], [plot]).html, encoding="utf-8")
        page = browser.new_page()
        page.goto(f"file://{path}")
        count, time, *points, links, extent, magnification = page.evaluate(MOTION)
        page.close()
        rigid, deviation = (np.array(each, dtype=float).reshape(len(time), count, 2) for each in points)
        return Shown(np.array(time), rigid, deviation, links, np.array(extent), magnification)

    return shown


def still(run: Run, extra: dict[str, Column] | None = None) -> Run:
    """The run of a robot that follows the rigid one: no signal of a deflection, the end effector on its path."""
    time = run.recording.time
    rigid = run.plan.task.evaluate(time, 0)[0]
    columns = {f"end_effector.position.{axis}": Column("m", rigid[:, i]) for i, axis in enumerate("xy")}
    kept = run.recording.only(lambda name: name.startswith("joint"))
    return replace(run, recording=kept.with_columns({**columns, **(extra or {})}))


def test_a_rigid_robot_deviates_nowhere(make_run: MakeRun, show: Show) -> None:
    """Elbows and links are those of the inverse kinematics."""
    run = still(make_run())
    robot = show(run)
    np.testing.assert_allclose(robot.deviation, 0.0, atol=ROUNDED)
    middle = robot.time.size // 2
    end = tuple(run.plan.task.evaluate(robot.time[middle : middle + 1], 0)[0, 0].tolist())
    for leg, (base, elbow) in enumerate(zip(bases(run.scene.mechanism), elbows(run.scene.mechanism, end), strict=True)):
        proximal, distal = robot.links[2 * leg], robot.links[2 * leg + 1]
        corners = robot.rigid[middle, [proximal[0], proximal[-1], distal[0], distal[-1]]]
        np.testing.assert_allclose(corners, [base, elbow, elbow, end], atol=ROUNDED)


def test_a_link_bends_by_its_shapes(make_run: MakeRun, show: Show) -> None:
    """Bending coordinates displace the points of a proximal link normal to it, an elongation along it; a pinned link bends in between."""
    run = make_run(changes={"effects.distal_bending": 1})
    size = run.recording.time.size
    names = [*(f"link11.bending[{mode}]" for mode in (1, 2, 3)), "link12.bending[1]", "link21.elongation"]
    values = dict(zip(names, (1e-3, -4e-4, 2e-4, 5e-4, 3e-4), strict=True))
    run = still(run, {name: Column("m", np.full(size, value)) for name, value in values.items()})
    robot, shapes = show(run), scene_shapes(run.scene)
    for frame in (0, robot.time.size // 3):
        deviation, points = robot.deviation[frame], robot.rigid[frame]
        # proximal link 1
        first = list(robot.links[0])
        along = points[first[-1]] - points[first[0]]
        unit = along / np.linalg.norm(along)
        xi = (points[first] - points[first[0]]) @ unit / np.linalg.norm(along)
        expected = sum(
            values[f"link11.bending[{k + 1}]"] * s.value(xi) for k, s in enumerate(shapes["proximal", "bending"])
        )
        np.testing.assert_allclose(deviation[first] @ [-unit[1], unit[0]], expected, atol=ROUNDED)
        np.testing.assert_allclose(deviation[first] @ unit, 0.0, atol=ROUNDED)
        # proximal link 2 is longer
        second = list(robot.links[2])
        assert np.linalg.norm(deviation[second[-1]]) == pytest.approx(3e-4)
        # distal link 1 from the bent elbow to the end effector: the middle has half the elbow's deviation and the sine's amplitude
        distal = list(robot.links[1])
        moved = points[distal] + deviation[distal]
        chord = moved[-1] - moved[0]
        normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        assert (moved[len(distal) // 2] - 0.5 * (moved[0] + moved[-1])) @ normal == pytest.approx(5e-4)


def test_frames_are_recorded_instants(make_run: MakeRun, show: Show) -> None:
    """The end effector is drawn where it was recorded."""
    run = make_run()
    robot = show(run)
    assert robot.time.size == 301
    index = np.searchsorted(run.recording.time, robot.time - 1e-6)
    recorded = np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"], axis=1)
    np.testing.assert_allclose((robot.rigid + robot.deviation)[:, -1], recorded[index], atol=ROUNDED)
    # deviations have more digits than positions
    rigid = run.plan.task.evaluate(np.minimum(run.recording.time[index], run.plan.duration), 0)[0]
    np.testing.assert_allclose(robot.deviation[:, -1], recorded[index] - rigid, rtol=1e-6, atol=1e-15)


def test_a_robot_that_runs_away_leaves_the_axes(make_run: MakeRun, show: Show) -> None:
    """Of an unstable run the mechanism stays visible; otherwise every point of every link is within the axes."""
    run = make_run()
    robot = show(run)
    points = robot.rigid + robot.magnification * robot.deviation
    for axis, (low, high) in enumerate(robot.extent):
        assert low <= points[..., axis].min() < points[..., axis].max() <= high
    columns = dict(run.recording.columns)
    for axis in "xy":
        name = f"end_effector.position.{axis}"
        values = columns[name].values.copy()
        values[values.size // 2 :] = 1e6
        values[-1] = np.nan
        columns[name] = replace(columns[name], values=values)
    away = show(replace(run, recording=run.recording.with_columns(columns)))
    assert np.ptp(away.extent[0]) < 3.0
