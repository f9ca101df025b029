"""The moving mechanism and the magnified path: points where the recording and the shapes put them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.reports.chart import unpacked
from flexfmu.cosim.reports.page import Plot
from flexfmu.cosim.reports.plots import LONGEST, _to_scale, bent_robot, path_panel, scene_panel
from flexfmu.model.beams import scene_shapes
from flexfmu.model.scene.assembly import bases, elbows

MakeRun = Callable[..., Run]


def still(run: Run, extra: dict[str, Column] | None = None) -> Run:
    """The run of a robot that follows the rigid one: no signal of a deflection, the end effector on its path."""
    time = run.recording.time
    rigid = run.plan.task.evaluate(time, 0)[0]
    columns = {f"end_effector.position.{axis}": Column("m", rigid[:, i]) for i, axis in enumerate("xy")}
    kept = run.recording.only(lambda name: name.startswith("joint"))
    return replace(run, recording=kept.with_columns({**columns, **(extra or {})}))


def test_a_rigid_robot_deviates_nowhere(make_run: MakeRun) -> None:
    """Elbows and links are those of the inverse kinematics."""
    run = still(make_run())
    robot = bent_robot(run)
    np.testing.assert_allclose(robot.deviation, 0.0, atol=1e-12)
    middle = robot.time.size // 2
    end = tuple(run.plan.task.evaluate(robot.time[middle : middle + 1], 0)[0, 0].tolist())
    for leg, (base, elbow) in enumerate(zip(bases(run.scene.mechanism), elbows(run.scene.mechanism, end), strict=True)):
        proximal, distal = robot.links[2 * leg], robot.links[2 * leg + 1]
        corners = robot.rigid[middle, [proximal[0], proximal[-1], distal[0], distal[-1]]]
        np.testing.assert_allclose(corners, [base, elbow, elbow, end], atol=1e-12)


def test_a_link_bends_by_its_shapes(make_run: MakeRun) -> None:
    """Bending coordinates displace the points of a proximal link normal to it, an elongation along it; a pinned link bends in between."""
    run = make_run(changes={"effects.distal_bending": 1})
    size = run.recording.time.size
    names = [*(f"link11.bending[{mode}]" for mode in (1, 2, 3)), "link12.bending[1]", "link21.elongation"]
    values = dict(zip(names, (1e-3, -4e-4, 2e-4, 5e-4, 3e-4), strict=True))
    run = still(run, {name: Column("m", np.full(size, value)) for name, value in values.items()})
    robot, shapes = bent_robot(run), scene_shapes(run.scene)
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
        np.testing.assert_allclose(deviation[first] @ [-unit[1], unit[0]], expected, atol=1e-12)
        np.testing.assert_allclose(deviation[first] @ unit, 0.0, atol=1e-12)
        # proximal link 2 is longer
        second = list(robot.links[2])
        assert np.linalg.norm(deviation[second[-1]]) == pytest.approx(3e-4)
        # distal link 1 from the bent elbow to the end effector: the middle has half the elbow's deviation and the sine's amplitude
        distal = list(robot.links[1])
        moved = points[distal] + deviation[distal]
        chord = moved[-1] - moved[0]
        normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        assert (moved[len(distal) // 2] - 0.5 * (moved[0] + moved[-1])) @ normal == pytest.approx(5e-4)


def test_frames_are_recorded_instants(make_run: MakeRun) -> None:
    """The end effector is drawn where it was recorded; the page's numbers are these."""
    run = make_run()
    robot = bent_robot(run, 50)
    assert robot.time.size == 50
    index = np.searchsorted(run.recording.time, robot.time)
    recorded = np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"], axis=1)
    np.testing.assert_allclose((robot.rigid + robot.deviation)[:, -1], recorded[index], rtol=1e-14)
    count = 4 * robot.rigid.shape[1] + 1
    numbers = unpacked(robot.data()["points"], 1)[0]
    assert numbers.size == 50 * count
    np.testing.assert_allclose(numbers[-2:], robot.deviation[-1, -1], rtol=1e-6)


@pytest.mark.parametrize(("largest", "times"), [(2.4e-4, 100.0), (2.5e-4, 50.0), (1.0, 1.0), (3e-12, 1.0), (0.0, 1.0)])
def test_magnification_is_a_round_number(make_run: MakeRun, largest: float, times: float) -> None:
    """A tenth of a proximal link of 0.24 m at most, 1, 2 or 5 times a power of ten, and never a reduction."""
    robot = bent_robot(still(make_run()))
    deviation = np.zeros_like(robot.deviation)
    deviation[7, -1, 0] = largest * (1.0 - 1e-9)
    assert replace(robot, deviation=deviation).magnification == times


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


def test_of_a_long_run_the_end_is_shown(make_run: MakeRun) -> None:
    """Of many cycles, in instants that are close enough for a vibration."""
    run = make_run(changes={"trajectory.dwell": 3.0})
    robot, (rigid, _) = bent_robot(run), path_panel(run, 1.0).curves
    assert robot.time[0] == pytest.approx(3.43 - LONGEST, abs=2e-3)
    assert robot.time[-1] == 3.43
    assert np.diff(robot.time).max() < 5e-3
    assert rigid.x.size == np.count_nonzero(run.recording.time >= 3.43 - LONGEST)


def drawn_axes(plot: Plot) -> tuple[float, ...]:
    """What a drawn plot's axes are: lowest and highest x, left and right end; the same of y, bottom and top."""
    found = re.search(r'data-axes="([^"]+)"', plot.svg)
    assert found is not None
    numbers = [float(each) for each in found[1].split()]
    return (*numbers[:4], *numbers[5:9])


@pytest.mark.parametrize("seed", range(4))
def test_all_links_stay_within_the_axes(make_run: MakeRun, seed: int) -> None:
    """Every point of every link, magnified, at every instant of the animation, however it bends."""
    run, random = make_run(), np.random.default_rng(seed)
    robot = bent_robot(run)
    robot = replace(robot, deviation=robot.deviation + 1e-4 * seed * random.standard_normal(robot.deviation.shape))
    x0, x1, *_, y0, y1, _, _ = drawn_axes(_to_scale("k", "Scene", "", scene_panel(run.plan, robot)))
    points = robot.rigid + robot.magnification * robot.deviation
    assert x0 < points[..., 0].min() < points[..., 0].max() < x1
    assert y0 < points[..., 1].min() < points[..., 1].max() < y1
    # they are about it: no more than 5 % of free space at a side, the bases, the path and equal scales aside
    assert min(points[..., 0].min() - x0, points[..., 1].min() - y0) < 0.06 * (x1 - x0)


def test_a_robot_that_runs_away_leaves_the_axes(make_run: MakeRun) -> None:
    """Of an unstable run the mechanism stays visible."""
    run = make_run()
    robot = bent_robot(run)
    deviation = robot.deviation.copy()
    deviation[200:] = 1e6
    deviation[-1] = np.nan
    x0, x1, *_ = drawn_axes(_to_scale("k", "Scene", "", scene_panel(run.plan, replace(robot, deviation=deviation))))
    assert x1 - x0 < 3.0


@pytest.mark.parametrize(
    ("changes", "is_to_scale"),
    [
        ({}, False),  # 350 mm wide and 25 mm high
        ({"trajectory.height": 0.12, "trajectory.width": 0.12, "trajectory.start": [-0.06, 0.40]}, True),
        ({"trajectory.lift": [1.0, 0.0], "trajectory.width": 0.2, "trajectory.start": [0.0, 0.3]}, False),
    ],
)
def test_a_path_has_a_shape_that_shows_it(make_run: MakeRun, changes: dict[str, Any], is_to_scale: bool) -> None:
    """The height of its axes is between a third of their width and twice and a half of it; unequal scales are told."""
    run = make_run(changes=changes)
    plot = _to_scale("k", "Path", "", path_panel(still(run), 1.0))
    x0, x1, left, right, y0, y1, bottom, top = drawn_axes(plot)
    assert 1.0 / 3.0 < (bottom - top) / (right - left) < 2.5
    equal = (right - left) / (x1 - x0) == pytest.approx((bottom - top) / (y1 - y0), rel=1e-3)
    assert equal == is_to_scale == ("different scales" not in plot.caption)
