"""Splines through rows of a table, and tables from files and into them: orders, continuity, exactness, digits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flexfmu.cosim.engine.trajectory_slave import TabulatedTrajectory, TrajectorySlave
from flexfmu.cosim.experiment.cycles import ThereAndBack
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.path import LameBlend, PickAndPlacePath
from flexfmu.trajectories.piecewise import DEGREES, PiecewisePolynomial, spline
from flexfmu.trajectories.profiles import bang_bang
from flexfmu.trajectories.table import read_table, smoothed, write_table
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

PATH = PickAndPlacePath((-0.175, 0.32), (0.0, -1.0), 0.025, 0.35, LameBlend(0.025, 0.025))


@pytest.fixture(scope="module")
def trajectory() -> Trajectory:
    """A motion whose acceleration jumps."""
    return TaskTrajectory(PATH, bang_bang(), 0.43)


@pytest.fixture(scope="module")
def table(trajectory: Trajectory) -> TabulatedTrajectory:
    """The same by look-up."""
    return TabulatedTrajectory(trajectory)


@pytest.mark.parametrize("side", ["left", "right"])
def test_it_is_the_trajectory(trajectory: Trajectory, table: TabulatedTrajectory, side: str) -> None:
    """Position, velocity and acceleration to rounding, on both sides of breakpoints and at rest before and after; higher
    derivatives nearly."""
    random = np.random.default_rng(3).uniform(-0.1, 0.6, 300)
    times = np.concatenate([random, trajectory.breakpoints])
    exact, found = trajectory.evaluate(times, 6, side), table.evaluate(times, 6, side)  # type: ignore[arg-type]
    error = abs(found - exact).max(axis=(1, 2)) / abs(exact).max(axis=(1, 2))
    assert (error < [1e-13, 1e-13, 1e-13, 1e-10, 1e-8, 1e-6, 1e-4]).all(), error


def test_repeated_motions_too(trajectory: Trajectory) -> None:
    """There and back, with breakpoints that two motions share."""
    motion = ThereAndBack(trajectory, 0.0, 2)
    times = np.array(motion.breakpoints)
    table = TabulatedTrajectory(motion)
    for side in ("left", "right"):
        np.testing.assert_allclose(
            table.evaluate(times, 2, side), motion.evaluate(times, 2, side), rtol=0.0, atol=1e-11
        )


def streamed(trajectory: Trajectory, times: np.ndarray) -> TrajectorySlave:
    """A slave that has been asked for points before, and is now asked for these."""
    slave = TrajectorySlave(trajectory, ("x", "y"), "m")
    slave.prepare(np.linspace(0.0, 0.43, 20))
    slave.prepare(times)
    return slave


@pytest.mark.parametrize("width", [2e-4, 4e-3, 2e-2])
def test_a_chosen_step_gets_the_same_polynomial(trajectory: Trajectory, width: float) -> None:
    """Whether points are few or many: the same references throughout the step, on long ones as exactly as the polynomial
    itself follows the trajectory."""
    begin = 0.0712
    few = begin + width * np.array([0.0, 0.5, 1.0])
    many = np.concatenate([few, np.linspace(0.3, 0.4, 20)])
    within = np.linspace(0.0, 0.5 * width, 20)
    found, exact = (streamed(trajectory, times).announced[0] for times in (few, many))
    powers = np.array([within**j for j in range(10)]) / np.cumprod([1.0, *range(1, 10)])[:, None]
    values = [np.einsum("jn,jv->vn", powers, polynomial) for polynomial in (found, exact)]
    truth = trajectory.evaluate(begin + within, 2).swapaxes(1, 2).reshape(6, -1)
    own = abs(values[1] - truth).max(axis=1)
    scale = np.repeat(abs(trajectory.evaluate(np.linspace(0.0, 0.43, 200), 2)).max(axis=(1, 2)), 2)
    assert (abs(values[0] - values[1]).max(axis=1) < 3e-13 * scale + 0.01 * own).all()


def test_choosing_steps_is_cheap(
    trajectory: Trajectory, table: TabulatedTrajectory, count_calls: Callable[..., int]
) -> None:
    """Three points take a fraction of the calls that the trajectory's series need."""
    times = np.array([0.1, 0.101, 0.102])
    exact, looked_up = (count_calls(lambda each=each: each.evaluate(times, 6)) for each in (trajectory, table))
    assert looked_up < 0.25 * exact


SPLINES = [(degree, order) for degree in DEGREES for order in range(degree // 2 + 1)]
"""Degree, and highest order of given derivatives."""


def rest_to_rest(order: int) -> np.polynomial.Polynomial:
    """The polynomial of degree 2 order + 1 from 0 to 1 whose derivatives up to ``order`` vanish at both ends."""
    rate = np.polynomial.Polynomial([0.0, 1.0, -1.0]) ** order
    return rate.integ() / rate.integ()(1.0)


def derivatives(polynomial: np.polynomial.Polynomial, time: np.ndarray, order: int) -> np.ndarray:
    """The polynomial p and -3 p + 1 with derivatives, (order + 1, N, 2)."""
    rows = np.array([polynomial.deriv(k)(time) for k in range(order + 1)])
    second = -3.0 * rows
    second[0] += 1.0
    return np.stack([rows, second], axis=-1)


def uneven(count: int, seed: int = 1) -> np.ndarray:
    """Times from 0 to 1 whose steps differ by up to a factor of three."""
    steps = np.random.default_rng(seed).uniform(0.5, 1.5, count - 1)
    return np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()


@pytest.mark.parametrize(("degree", "order"), SPLINES)
def test_a_polynomial_of_its_degree_is_reproduced(degree: int, order: int) -> None:
    """With all derivatives, and through the end conditions of rest also without them."""
    polynomial, time = rest_to_rest(degree // 2), uneven(12)
    found = spline(time, derivatives(polynomial, time, order), degree)
    instants = np.linspace(0.0, 1.0, 301)[1:-1]
    expected = derivatives(polynomial, instants, degree)
    np.testing.assert_allclose(found.evaluate(instants, 2), expected[:3], atol=1e-10)
    assert abs(found.evaluate(instants, degree + 2)[degree + 1 :]).max() == 0.0


@pytest.mark.parametrize(("degree", "order"), SPLINES)
def test_as_often_differentiable_as_stated(degree: int, order: int) -> None:
    """``degree`` - 1 - m derivatives are continuous at each knot, the next one jumps there."""
    time = uneven(9)
    values = derivatives(np.polynomial.Polynomial([0.0]), time, order)
    values[0, :, 0] = np.sin(7.0 * time)
    values[1:, 1:-1, 0] = np.random.default_rng(3).normal(size=(order, 7))
    found, continuity = spline(time, values, degree), degree - 1 - order
    left, right = (found.evaluate(time[1:-1], degree, side) for side in ("left", "right"))
    jumps = abs(left - right)[:, :, 0].max(axis=1) / abs(right[:, :, 0]).max(axis=1)
    assert jumps[: continuity + 1].max() < 1e-9 < 1e-3 < jumps[continuity + 1]
    assert found.breakpoints == pytest.approx(tuple(time))


@pytest.mark.parametrize("degree", DEGREES)
def test_converges_with_its_degree_plus_one(degree: int) -> None:
    """Position alone, through a motion with so many derivatives zero at its ends that the end conditions hold."""
    instants, errors = np.linspace(0.0, 1.0, 500), []
    for count in (33, 65):
        time = np.linspace(0.0, 1.0, count)
        there_and_back = np.sin(np.pi * time) ** 10
        found = spline(time, np.column_stack([there_and_back, there_and_back])[np.newaxis], degree)
        errors.append(abs(found.evaluate(instants, 0)[0, :, 0] - np.sin(np.pi * instants) ** 10).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(degree + 1, abs=0.6)


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=8), st.floats(0.1, 10.0))
def test_scaled_in_time(values: list[float], duration: float) -> None:
    """A motion that takes c times as long has derivatives that are smaller by powers of c."""
    positions = np.column_stack([values, values[::-1]])[np.newaxis]
    motion = spline(np.arange(len(values)), positions)
    slower, pace = motion.with_duration(duration), motion.duration / duration
    instants = np.linspace(0.0, duration, 23)
    assert slower.duration == duration
    for order, row in enumerate(slower.evaluate(instants, 3, "left")):
        expected = motion.evaluate(instants * pace, 3, "left")[order] * pace**order
        np.testing.assert_allclose(row, expected, rtol=1e-9, atol=1e-9 * max(1.0, pace**order) * 10.0)


def test_stands_still_before_and_after() -> None:
    """Also at the outer limits of start and end, with a velocity that would run on."""
    motion = PiecewisePolynomial(np.array([0.0, 2.0]), np.array([[[1.0, 0.0]], [[0.5, 0.0]], [[1.0, 1.0]]]))
    before, after = motion.evaluate([-1.0], 2)[:, 0], motion.evaluate([3.0], 2)[:, 0]
    np.testing.assert_array_equal(before, [[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(after, [[6.0, 4.0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(motion.evaluate([0.0], 2, "left")[1:], 0.0)
    np.testing.assert_array_equal(motion.evaluate([2.0], 2, "right")[:, 0], after)
    assert motion.evaluate([2.0], 1, "left")[1, 0] == pytest.approx([4.5, 4.0])


def test_no_breakpoint_where_nothing_jumps() -> None:
    """A knot within a polynomial, or within standstill, is none."""
    taylor = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 2.0]])
    later = np.array([[0.25, 0.5], [1.0, 2.0], [1.0, 2.0]])
    still = np.array([[1.0, 2.0], [0.0, 0.0], [0.0, 0.0]])
    coefficients = np.stack([taylor, later, still, still], axis=1)
    motion = PiecewisePolynomial(np.array([0.0, 0.5, 1.0, 2.0, 3.0]), coefficients)
    assert motion.breakpoints == (0.0, 1.0, 3.0)


Write = Callable[[str], Path]

ROWS = "0,0.1,0.3\n0.1,0.2,0.3\n0.2,0.3,0.3\n"


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a file."""

    def written(text: str) -> Path:
        path = tmp_path / "motion.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return written


@pytest.mark.parametrize(
    "text",
    [
        "time,x,y\n" + ROWS,
        "\ufeff# from the controller\n\ntime [s];x [m];y (m)\n" + ROWS.replace(",", ";"),
        "y\ttorque\ttime\tx\n0.3\t-\t0\t0.1\n0.3\tnan\t0.1\t0.2\r\n0.3\t\t0.2\t0.3\n",
        '"time","end_effector.position.x","end_effector.position.y"\n' + ROWS,
        "time,x,y\n7.5,0.1,0.3\n7.6,0.2,0.3\n7.7,0.3,0.3\n",
    ],
    ids=["plain", "semicolons", "tabs", "results", "later"],
)
def test_forms_of_files(write: Write, text: str) -> None:
    """Separators, order of columns, units, comments, names of results, and times that don't begin at 0."""
    table = read_table(write(text))
    assert table.time == pytest.approx([0.0, 0.1, 0.2])
    np.testing.assert_array_equal(table.derivatives, [[[0.1, 0.3], [0.2, 0.3], [0.3, 0.3]]])
    assert table.coordinates == "end-effector"


def test_what_of_both_coordinates(write: Write) -> None:
    """Results of a run have joints and end effector: the reader says which."""
    path = write("time,joint1.position,joint2.position,x,y\n0,1,2,3,4\n1,5,6,7,8\n")
    assert read_table(path, "joints").derivatives[0, 1].tolist() == [5.0, 6.0]
    assert read_table(path, "end-effector").derivatives[0, 1].tolist() == [7.0, 8.0]
    with pytest.raises(TrajectoryError, match="are both there"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no column time"),
        ("when,x,y\n" + ROWS, r"line 1: there is no column time \[s\]; columns: when, x, y"),
        ("time,x,y\n1,0,0\n1,0,0\n", "needs 2 or more rows of different times, got 1"),
        ("time,x,z\n" + ROWS, "line 1: column y is missing; columns: time, x, z"),
        ("time,a,b\n" + ROWS, "line 1: there are no columns x and y"),
        ("time,x,y,x\n0,1,2,3\n", "column x is there twice"),
        ("time,x,y,ax,ay\n0,1,2,3,4\n", "column vx is missing"),
        ("time,x [mm],y\n" + ROWS, "column x is in mm; convert it to m"),
        ("time,x,y\n", "needs 2 or more rows of different times, got 0"),
        ("time,x,y\n0,0,0\n\n# pause\n1,zero,0\n", "line 5, column x: 'zero' is not a finite number"),
        ("time,x,y\n0,0,0\n1,0,nan\n", "line 3, column y: 'nan' is not a finite number"),
        ("time,x,y\n0,0,0\n1,0\n", "line 3: 2 values for 3 columns"),
        ("time,x,y\n0,0,0\n1,1,0\n0.5,2,0\n", "line 4, column time: 0.5 s comes after 1.0 s"),
        ("time,x,y\n0,0,0\n1,1,0\n1,1,0\n2,2,0\n", "line 4, column time: 1.0 s is there twice; .* accelerations must be given"),
        ("time,x,y,vx,vy,ax,ay\n0,0,0,0,0,0,0\n0,0,0,0,0,1,0\n0,0,0,0,0,2,0\n1,1,0,0,0,0,0\n", "line 4, .* there more than twice"),
        (
            "time,x,y,vx,vy,ax,ay\n0,0,0,0,0,0,0\n1,1,0,1,0,0,0\n1,1,0,2,0,1,0\n2,2,0,0,0,0,0\n",
            "line 4, column vx: 2.0 is another value than 1.0 at the same time 1.0 s",
        ),
        ("time,x,y,vx,vy\n0,0,0,0.5,0\n1,1,0,0,0\n", "line 2, column vx: the motion has to start at rest, but is 0.5 m/s there"),
        (
            "time,q11,q21\n" + "".join(f"{k},{k},0\n" for k in range(9)),
            "line 2, column q11: the motion has to start at rest, but suggests 1 rad/s there",
        ),
    ],
)  # fmt: skip
def test_wrong_files(write: Write, text: str, said: str) -> None:
    """File, line, column and value of what is wrong."""
    path = write(text)
    with pytest.raises(TrajectoryError, match=said) as caught:
        read_table(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """A missing file, a folder, bytes that are no text."""
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"time,x,y\n\xff\xfe")
    for path, said in ((tmp_path / "no.csv", "No such file"), (tmp_path, "directory"), (binary, "not UTF-8")):
        with pytest.raises(TrajectoryError, match=said):
            read_table(path)


def test_a_changed_file_is_read_again(write: Write) -> None:
    """What is read before is kept only as long as the file is the same."""
    first = read_table(write("time,x,y\n" + ROWS))
    assert read_table(write("time,x,y\n" + ROWS)) == first
    assert read_table(write("time,x,y\n" + ROWS.replace("0.3\n", "0.4\n"))) != first


def test_written_as_it_is_read(tmp_path: Path) -> None:
    """A spline of degree 5 by its knots, exactly; a bang-bang motion on a curved path to a millionth of its acceleration."""
    exact = spline([0.0, 0.3, 0.5, 1.1], np.array([[[0.0, 1.0], [0.4, 1.1], [0.5, 1.0], [1.0, 0.7]]]))
    write_table(tmp_path / "a.csv", exact, "joints")
    table = read_table(tmp_path / "a.csv")
    instants = np.linspace(0.0, 1.1, 57)
    assert (table.coordinates, len(table.time)) == ("joints", 4)
    np.testing.assert_allclose(table.trajectory().evaluate(instants, 4), exact.evaluate(instants, 4), atol=1e-10)
    # a motion that is no polynomial, with jumps of the acceleration
    path = PickAndPlacePath((-0.175, 0.32), (0.0, -1.0), 0.025, 0.35, LameBlend(0.025, 0.025))
    motion = TaskTrajectory(path, bang_bang(), 0.43)
    write_table(tmp_path / "b.csv", motion)
    found = read_table(tmp_path / "b.csv").trajectory()
    instants = np.linspace(0.0, 0.43, 500)
    for order, scale in enumerate((1e-12, 1e-9, 1e-4)):
        np.testing.assert_allclose(found.evaluate(instants, 2)[order], motion.evaluate(instants, 2)[order], atol=scale)
    assert set(np.round(motion.breakpoints, 12)) <= set(np.round(found.breakpoints, 12))


TIME = np.linspace(0.0, 0.5, 501)


def exact(time: np.ndarray, order: int) -> np.ndarray:
    """Seventh-degree polynomials from rest to rest, 1 and -2 far."""
    motion = np.polynomial.Polynomial([0.0, 0.0, 0.0, 0.0, 35.0, -84.0, 70.0, -20.0])
    values = motion.deriv(order)(time / 0.5) / 0.5**order if order else motion(time / 0.5)
    return np.stack([values, -2.0 * values], axis=-1)


@pytest.mark.parametrize(("noise", "accuracy"), [(1e-6, 0.005), (1e-5, 0.012), (1e-4, 0.08)])
def test_acceleration_of_noisy_positions(noise: float, accuracy: float) -> None:
    """RMS of the error relative to that of the acceleration; a spline through the rows is no acceleration at all at 1e-4."""
    rows = exact(TIME, 0) + noise * np.random.default_rng(0).normal(size=(501, 2))
    motion = smoothed(TIME, rows, noise)
    instants = np.linspace(0.0, 0.5, 999)[1:-1]
    scale = np.sqrt(np.mean(exact(instants, 2) ** 2, axis=0))
    error = np.sqrt(np.mean((motion.evaluate(instants, 2)[2] - exact(instants, 2)) ** 2, axis=0)) / scale
    assert error.max() < accuracy
    through = (
        np.sqrt(np.mean((spline(TIME, rows[None]).evaluate(instants, 2)[2] - exact(instants, 2)) ** 2, axis=0)) / scale
    )
    assert through.max() > 5.0 * error.max()
    # distances are those of the noise, and the motion is much simpler than its rows
    distance = np.sqrt(np.mean((motion.evaluate(TIME, 0)[0] - rows) ** 2, axis=0))
    assert distance == pytest.approx([noise, noise], rel=0.1)
    assert len(motion.breakpoints) < 200


def test_at_rest_and_continuous() -> None:
    """Zero velocity and acceleration at the ends, at the first and last position; four continuous derivatives between."""
    rows = exact(TIME, 0) + 1e-4 * np.random.default_rng(1).normal(size=(501, 2))
    motion = smoothed(TIME, rows, 1e-4)
    np.testing.assert_array_equal(motion.evaluate([0.0], 2, "right")[:, 0], [rows[0], [0.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(motion.evaluate([0.5], 2, "left")[:, 0], [rows[-1], [0.0, 0.0], [0.0, 0.0]], atol=1e-9)
    inner = motion.knots[2:-2]
    left, right = (motion.evaluate(inner, 4, side) for side in ("left", "right"))
    for order in range(5):
        assert abs(left - right)[order].max() < 1e-8 * abs(right[order]).max()
