"""Names, units, values before the first sample, and what is said about wrong input."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.channels import Channel, joint_channels, per_second
from flexfmu.cosim.control.imperfections.delay import Lagrange, Thiran, delay, whole_delay
from flexfmu.cosim.control.imperfections.lag import lag
from flexfmu.cosim.control.imperfections.signal_blocks import (
    encoder,
    gaussian_noise,
    jitter,
    quantisation,
    rate_limit,
    saturation,
    uniform_noise,
)
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3
POSITIONS = joint_channels("position", (0.25, 2.5))
MIXED = (Channel("joint1.position", "rad", 0.3), Channel("joint1.velocity", "rad/s", 0.0))
TORQUE = Channel("joint1.torque", "N.m")

ALL: dict[str, Callable[..., SymbolicBlock]] = {
    "saturation": lambda c, **o: saturation(c, -1.0, 4.0, **o),
    "rate limit": lambda c, **o: rate_limit(c, 2.0, **o),
    "whole delay": lambda c, **o: whole_delay(c, 3, **o),
    "linear": lambda c, **o: delay(c, 1.4 * H, **o),
    "Lagrange": lambda c, **o: delay(c, 2.7 * H, interpolation=Lagrange(3), **o),
    "Thiran": lambda c, **o: delay(c, 3.6 * H, interpolation=Thiran(2), **o),
    "quantisation": lambda c, **o: quantisation(c, 0.125, **o),
    "Gauss": lambda c, **o: gaussian_noise(c, 0.0, 1, **o),
    "uniform": lambda c, **o: uniform_noise(c, 0.0, 1, **o),
    "jitter": lambda c, **o: jitter(c, 0.3 * H, 1, **o),
    "lag": lambda c, **o: lag(c, 2e-3, **o),
}


def test_initial_values_may_be_an_array() -> None:
    """A measured pose is an array: it starts the channels as a list does."""
    assert joint_channels("position", np.array([0.25, 2.5])) == POSITIONS


@pytest.mark.parametrize("initial", [0.5, [0.1, 0.2, 0.3], np.zeros((2, 2)), ["a", "b"]])
def test_initial_values_that_fit_no_joints_are_refused(initial: Any) -> None:
    """One line names the joints and what was given."""
    with pytest.raises(InputError, match="initial must be one number for each of joint1, joint2, got"):
        joint_channels("position", initial)


@pytest.mark.parametrize("make", ALL.values(), ids=ALL.keys())
def test_every_block_has_the_names_and_units_of_its_channels(make: Callable[..., SymbolicBlock]) -> None:
    """A receiver finds its signal under the name it knows; the master refuses to wire different units."""
    block = make(POSITIONS, sample_time=H, offset=2 * H, name="mine")
    assert [(each.name, each.unit) for each in block.inputs] == [
        ("joint1.position.input", "rad"),
        ("joint2.position.input", "rad"),
    ]
    assert [(each.name, each.unit) for each in block.outputs] == [
        ("joint1.position", "rad"),
        ("joint2.position", "rad"),
    ]
    assert (block.name, block.sample_time, block.offset) == ("mine", H, 2 * H)


@pytest.mark.parametrize("make", ALL.values(), ids=ALL.keys())
def test_no_bump_at_the_start(make: Callable[..., SymbolicBlock], run: Any) -> None:
    """A signal that stands still where it is said to start comes out as it is, from initialisation on."""
    at_rest = np.tile([0.25, 2.5], (20, 1))
    block = make(POSITIONS, sample_time=H)
    np.testing.assert_array_equal(run(block, at_rest), at_rest)
    slave = BlockSlave(block)
    slave.initialize(0.0, 1.0, None)
    values = np.empty(2)
    slave.get(np.array([len(slave.variables) - 2, len(slave.variables) - 1]), values)
    np.testing.assert_array_equal(values, [0.25, 2.5])


@pytest.mark.parametrize("key", ["rate limit", "linear", "jitter"])
def test_without_initial_value_the_first_input_is_the_past(key: str, run: Any) -> None:
    """Blocks that pass signals on at once start without a bump by themselves."""
    channels = joint_channels("position")
    at_rest = np.tile([0.25, 2.5], (5, 1))
    block = delay(channels, 0.4 * H, sample_time=H) if key == "linear" else ALL[key](channels, sample_time=H)
    np.testing.assert_array_equal(run(block, at_rest), at_rest)
    assert not [each.name for each in block.parameters if each.name.endswith("initial")]


@pytest.mark.parametrize("key", ["whole delay", "linear", "Lagrange", "Thiran", "lag"])
def test_initial_values_are_parameters(key: str, run: Any) -> None:
    """Whoever imports a block can make it start where his robot starts."""
    initial = {"joint1.position.initial": -4.0, "joint2.position.initial": 5.0}
    y = run(ALL[key](POSITIONS, sample_time=H), np.tile([-4.0, 5.0], (9, 1)), initial)
    np.testing.assert_array_equal(y, np.tile([-4.0, 5.0], (9, 1)))


@pytest.mark.parametrize("key", ["whole delay", "linear", "lag"])
def test_blocks_that_break_algebraic_loops_say_so(key: str) -> None:
    """An output that doesn't depend on the same instant's input is declared so, and only that."""
    block = ALL[key](POSITIONS, sample_time=H)
    assert block.feedthrough == {"joint1.position": (), "joint2.position": ()}


@pytest.mark.parametrize("key", ["saturation", "rate limit", "quantisation", "Gauss", "uniform", "jitter"])
def test_feedthrough_is_by_channel(key: str) -> None:
    """Channels don't depend on each other."""
    assert ALL[key](POSITIONS, sample_time=H).feedthrough == {
        "joint1.position": ("joint1.position.input",),
        "joint2.position": ("joint2.position.input",),
    }


def test_units_of_rates() -> None:
    """A rate's unit is what FMI understands."""
    assert [per_second(unit) for unit in ("rad", "rad/s", "rad/s2", "N.m", "1")] == [
        "rad/s",
        "rad/s2",
        "rad/s3",
        "N.m/s",
        "1/s",
    ]


@pytest.mark.parametrize(("make", "message"), [
    (lambda: Channel(""), "a channel needs a name"),
    (lambda: Channel("a", "turns"), r"channel a: unit 'turns' has the unknown symbol 'turns'; known are"),
    (lambda: Channel("a", "rad", np.nan), r"channel a: the initial value must be finite, got nan rad"),
    (lambda: joint_channels("angle"), r"joints have position, velocity, acceleration, torque; got 'angle'"),
    (lambda: joint_channels("torque", (1.0,)), r"one number for each of joint1, joint2, got \(1\.0,\)"),
    (lambda: saturation([], -1.0, 1.0, sample_time=H), "needs at least one channel"),
    (lambda: saturation([TORQUE, TORQUE], -1.0, 1.0, sample_time=H), "two variables are named 'joint1.torque.input'"),
    (lambda: saturation([TORQUE], 2.0, 1.0, sample_time=H),
     r"the lower limit 2.0 N.m of joint1.torque is above the upper one, 1.0 N.m; swap them"),
    (lambda: saturation([TORQUE], -np.inf, 1.0, sample_time=H),
     r"the lower limit of joint1.torque must be finite, got -inf N.m"),
    (lambda: saturation([TORQUE], -1.0, 1.0, sample_time=0.0), r"the sample time must be positive, got 0.0 s"),
    (lambda: saturation([TORQUE], -1.0, 1.0, sample_time=H, offset=-1.0), r"the offset must be zero or positive, got"),
    (lambda: rate_limit([TORQUE], -1.0, sample_time=H),
     r"the fastest rise of joint1.torque must be at least 0 N.m/s, got -1.0 N.m/s"),
    (lambda: rate_limit([TORQUE], [1.0, 2.0], sample_time=H),
     r"the fastest rise \[N.m/s\] must be one number or one for each of joint1.torque, got shape \(2,\)"),
    (lambda: quantisation([TORQUE], "fine", sample_time=H), r"the resolution \[N.m\] must be a number .* got 'fine'"),
    (lambda: gaussian_noise(MIXED, 1e-3, 1, sample_time=H),
     r"the standard deviation \[rad, rad/s\] can't be one number, 0.001, for different units: give one for each of "
     r"joint1.position, joint1.velocity"),
    (lambda: gaussian_noise([TORQUE], -1e-3, 1, sample_time=H), r"must be at least 0 N.m, got -0.001 N.m"),
    (lambda: gaussian_noise([TORQUE], 1e-3, -1, sample_time=H), r"seed must be a whole number, from 0 to 1048575, got -1"),
    (lambda: uniform_noise([TORQUE], 1e-3, 1.5, sample_time=H), r"seed must be a whole number, .* got 1.5"),
    (lambda: jitter([TORQUE], 2 * H, 1, sample_time=H), r"zero to the sample time, 0.001 s, got 0.002 s"),
    (lambda: jitter([TORQUE], H, 2**20, sample_time=H), r"seed must be a whole number, .* got 1048576"),
    (lambda: lag([TORQUE], 1e-3, sample_time=H),
     r"lag: its first output is the value of joint1.torque \[N.m\] before the first sample; give it, for example "
     r"Channel\('joint1.torque', 'N.m', initial=0.0\)"),
    (lambda: lag(joint_channels("torque", (0.0, 0.0)), -1e-3, sample_time=H),
     r"the time constant of joint1.torque must be at least 0 s, got -0.001 s"),
    (lambda: whole_delay([TORQUE], 1, sample_time=H), r"delay: its first output is the value of joint1.torque"),
    (lambda: whole_delay([TORQUE], 1.5, sample_time=H), r"the delay in samples must be a whole number, at least 0, got 1.5; `delay` takes"),
    (lambda: whole_delay([TORQUE], -1, sample_time=H), r"the delay in samples must be a whole number, at least 0, got -1"),
    (lambda: delay([TORQUE], -H, sample_time=H), r"delay: the delay must be zero or positive, got -0.001 s"),
    (lambda: delay([TORQUE], H, sample_time=np.nan), r"delay: the sample time must be positive, got nan s"),
    (lambda: delay([TORQUE], 0.5 * H, sample_time=H, interpolation=Lagrange(3)),
     r"a delay of 0.5 samples is too short for Lagrange interpolation of order 3, which needs at least 1; take a lower"),
    (lambda: delay([TORQUE], 0.4 * H, sample_time=H, interpolation=Thiran(1)),
     r"a delay of 0.4 samples is too short for Thiran's all-pass of order 1, which needs at least 0.5"),
    (lambda: Lagrange(0), r"the order of Lagrange interpolation must be a whole number, from 1 to 10, got 0"),
    (lambda: Thiran(11), r"the order of Thiran's all-pass must be a whole number, from 1 to 10, got 11"),
    (lambda: encoder(0.5, sample_time=H),
     r"the number of counts per turn of joint1.position must be at least 1, got 0.5$"),
    (lambda: encoder(1e4, sample_time=H, window=0), r"the window in samples must be a whole number, at least 1, got 0"),
])  # fmt: skip
def test_wrong_input(make: Callable[[], object], message: str) -> None:
    """A message gives the value, its unit and what would be right, before anything runs."""
    with pytest.raises(InputError, match=message):
        make()
