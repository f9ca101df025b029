"""Lifted loops against closed forms, python-control, and recursions written out."""

from __future__ import annotations

from math import pi

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.design.margins.linear_loop import Continuous, LinearLoop
from flexfmu.cosim.design.margins.margins import pose_margins
from flexfmu.trajectories.jets import RealArray

T = 1e-2
KP, KD = 400.0, 20.0


def mass(outputs: int) -> Continuous:
    """A unit mass with its position and velocity as signals, fed by the channel; the blocks have some outputs."""
    a, c = np.array([[0.0, 1.0], [0.0, 0.0]]), np.eye(2)
    nothing = np.zeros((2, outputs))
    return Continuous(a, c, (nothing, nothing), (np.array([[0.0], [1.0]]), np.zeros((2, 1))))


def static(gains: RealArray, sample_time: float = T, offset: float = 0.0) -> LinearBlock:
    """A block without states."""
    return LinearBlock(
        np.zeros((0, 0)), np.zeros((0, gains.shape[1])), np.zeros((len(gains), 0)), gains, sample_time, offset
    )


def pd(kp: float = KP, kd: float = KD) -> LinearLoop:
    """A unit mass with a sampled PD controller."""
    inputs = np.hstack([np.eye(2), np.zeros((2, 1))])
    return LinearLoop(mass(1), (static(np.array([[-kp, -kd]])),), (0,), (inputs,), (0,))


def zero_order_hold(kp: float = KP, kd: float = KD) -> control.StateSpace:
    """The loop transfer function of the same, by python-control."""
    plant = control.ss([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[kp, kd]], [[0.0]])
    return control.sample_system(plant, T, method="zoh")


def margins_of(loop: LinearLoop):  # type: ignore[no-untyped-def]
    return pose_margins(loop, ["force"], 0.0, (0.0, 0.0), (0.0, 0.0)).loops[0]


def test_the_gain_margin_is_that_of_jurys_criterion() -> None:
    # z = -1: 4 - 2 k KD T = 0; |product of the roots| = 1: KD = KP T / 2 at any gain
    assert margins_of(pd()).gain_margin == pytest.approx(2.0 / (KD * T), rel=1e-8)
    assert margins_of(pd()).gain_reduction == 0.0


def test_margins_and_sensitivity_are_those_of_python_control() -> None:
    found, loop = margins_of(pd()), zero_order_hold()
    _, phase, _, crossover = control.margin(loop)
    assert found.phase_margin == pytest.approx(np.radians(phase), rel=1e-6)
    assert found.crossover == pytest.approx(crossover, rel=1e-6)
    # a delay beyond the sample turns the phase and moves the instants of the hold
    assert found.delay_margin == pytest.approx(found.phase_margin / crossover, rel=0.05)
    sensitivity = control.feedback(1, loop)
    values = np.squeeze(control.frequency_response(sensitivity, np.geomspace(0.1, pi / T, 20001)).frdata)
    assert found.sensitivity_peak == pytest.approx(np.abs(values).max(), rel=1e-4)
    bandwidth = brentq(lambda w: abs(sensitivity(np.exp(1j * w * T))) - 0.5**0.5, 1.0, 1e2)
    assert found.bandwidth == pytest.approx(bandwidth, rel=1e-6)
    assert found.disk_margin == pytest.approx(2.0 / np.abs(2.0 * values - 1.0).max(), rel=1e-4)


@pytest.mark.parametrize("delay", [0.0, 0.3 * T, T, 2.4 * T])
def test_a_delay_is_one_of_the_torque_that_reaches_the_robot(delay: float) -> None:
    """The recursion with the torques of the last samples, written out."""
    loop = pd(100.0, 10.0)
    whole, part = divmod(delay / T, 1.0)
    count = round(whole)
    first, second = part * T, (1.0 - part) * T
    flow = lambda t: np.array([[1.0, t], [0.0, 1.0]])  # noqa: E731
    load = lambda t: np.array([t**2 / 2, t])  # noqa: E731
    # state: position, velocity, torques of the last count + 1 samples, the newest first
    size = 2 + count + 1
    step = np.zeros((size, size))
    state = np.eye(size)
    newest = -np.array([[100.0, 10.0]]) @ state[:2]
    torques = np.vstack([newest, state[2:]])
    moved = flow(first) @ state[:2] + np.outer(load(first), torques[count + 1])
    step[:2] = flow(second) @ moved + np.outer(load(second), torques[count])
    step[2:] = torques[:-1]
    found = np.linalg.eigvals(loop.closed([1.0], [delay]))
    expected = np.linalg.eigvals(step)
    assert max(abs(found)) == pytest.approx(max(abs(expected)), rel=1e-9)


def test_two_rates_with_an_offset_are_those_of_the_recursion() -> None:
    """An outer loop every T, an inner one twice as often, a third of a sample later."""
    late = T / 6
    inner = static(np.array([[0.0, -10.0, 1.0]]), T / 2, late)
    outer = static(np.array([[-100.0]]), T)
    # signals x, v; outputs: of the inner block, of the outer one
    inputs = (np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]), np.array([[1.0, 0, 0, 0]]))
    loop = LinearLoop(mass(2), (inner, outer), (1, 0), inputs, (0,))
    flow = lambda t: np.array([[1.0, t, t**2 / 2, 0], [0, 1.0, t, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])  # noqa: E731
    sampled, commanded = np.eye(4), np.eye(4)
    sampled[2] = [0.0, -10.0, 0.0, 1.0]
    commanded[3] = [-100.0, 0.0, 0.0, 0.0]
    expected = flow(T / 2 - late) @ sampled @ flow(T / 2) @ sampled @ flow(late) @ commanded
    found = np.linalg.eigvals(loop.closed([1.0], [0.0]))
    for value in np.linalg.eigvals(expected):
        assert np.abs(np.append(found, 0.0) - value).min() < 1e-10


def test_an_unstable_loop_has_no_margins() -> None:
    found = pose_margins(pd(kd=-1.0), ["force"], 0.0, (0.0, 0.0), (0.0, 0.0))
    assert not found.is_stable
    assert (found.loops[0].gain_margin, found.loops[0].delay_margin) == (1.0, 0.0)
