"""Names, units, values before the first sample, and what is said about wrong input."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from blocks import delay, jitter, lag, noise, quantisation, rate_limit, sampled, saturation

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3
POSITIONS = (0.25, 2.5)
LAGRANGE, THIRAN = {"kind": "lagrange", "order": 3}, {"kind": "thiran", "order": 2}

ALL: dict[str, Callable[..., SymbolicBlock]] = {
    "saturation": partial(saturation, lower=-1.0, upper=4.0, signal="position"),
    "rate limit": partial(rate_limit, 2.0, signal="position"),
    "whole delay": partial(delay, 3 * H, signal="position"),
    "linear": partial(delay, 1.4 * H, signal="position"),
    "Lagrange": partial(delay, 2.7 * H, LAGRANGE, signal="position"),
    "Thiran": partial(delay, 3.6 * H, THIRAN, signal="position"),
    "quantisation": partial(quantisation, 0.125),
    "Gauss": partial(noise, 0.0, seed=1),
    "uniform": partial(noise, half_width=0.0, seed=1),
    "jitter": partial(jitter, 0.3 * H, 1),
    "lag": partial(lag, 2e-3, signal="position"),
}


@pytest.mark.parametrize("make", ALL.values(), ids=ALL.keys())
def test_every_block_has_the_names_and_units_of_its_channels(make: Callable[..., SymbolicBlock]) -> None:
    """A receiver finds its signal under the name it knows; the master refuses to wire different units."""
    block = make(initial=POSITIONS, sample_time=H, offset=2 * H, name="mine")
    for side, ending in ((block.inputs, ".input"), (block.outputs, "")):
        assert [(each.name, each.unit) for each in side] == [(f"joint{i}.position{ending}", "rad") for i in (1, 2)]
    assert (block.name, block.sample_time, block.offset) == ("mine", H, 2 * H)


@pytest.mark.parametrize("make", ALL.values(), ids=ALL.keys())
def test_no_bump_at_the_start(make: Callable[..., SymbolicBlock]) -> None:
    """A signal that stands still where it is said to start comes out as it is, from initialisation on."""
    at_rest = np.tile([0.25, 2.5], (20, 1))
    block = make(initial=POSITIONS, sample_time=H)
    np.testing.assert_array_equal(sampled(block, at_rest), at_rest)
    slave = BlockSlave(block)
    slave.initialize(0.0, 1.0, None)
    values = np.empty(2)
    slave.get(np.array([len(slave.variables) - 2, len(slave.variables) - 1]), values)
    np.testing.assert_array_equal(values, [0.25, 2.5])


@pytest.mark.parametrize("key", ["rate limit", "linear", "jitter"])
def test_without_initial_value_the_first_input_is_the_past(key: str) -> None:
    """Blocks that pass signals on at once start without a bump by themselves."""
    at_rest = np.tile([0.25, 2.5], (5, 1))
    block = delay(0.4 * H, signal="position", sample_time=H) if key == "linear" else ALL[key](sample_time=H)
    np.testing.assert_array_equal(sampled(block, at_rest), at_rest)
    assert not [each.name for each in block.parameters if each.name.endswith("initial")]


@pytest.mark.parametrize("key", ["whole delay", "linear", "Lagrange", "Thiran", "lag"])
def test_initial_values_are_parameters(key: str) -> None:
    """Whoever imports a block can make it start where his robot starts."""
    initial = {"joint1.position.initial": -4.0, "joint2.position.initial": 5.0}
    y = sampled(ALL[key](initial=POSITIONS, sample_time=H), np.tile([-4.0, 5.0], (9, 1)), initial)
    np.testing.assert_array_equal(y, np.tile([-4.0, 5.0], (9, 1)))


BREAKING = ("whole delay", "linear", "lag")


@pytest.mark.parametrize("key", ["saturation", "rate limit", "quantisation", "Gauss", "uniform", "jitter", *BREAKING])
def test_feedthrough_is_by_channel(key: str) -> None:
    """Channels don't depend on each other; blocks that break algebraic loops say so, and only these."""
    expected = {f"joint{i}.position": () if key in BREAKING else (f"joint{i}.position.input",) for i in (1, 2)}
    assert ALL[key](initial=POSITIONS, sample_time=H).feedthrough == expected


@pytest.mark.parametrize(("make", "message"), [
    (lambda: jitter(2 * H, 1, sample_time=H), r"zero to the sample time, 0.001 s, got 0.002 s"),
    (lambda: delay(0.5 * H, LAGRANGE, sample_time=H),
     r"a delay of 0.5 samples is too short for Lagrange interpolation of order 3, which needs at least 1; take a lower"),
    (lambda: delay(1.4 * H, THIRAN, sample_time=H),
     r"a delay of 1.4 samples is too short for Thiran's all-pass of order 2, which needs at least 1.5"),
])  # fmt: skip
def test_wrong_input(make: Callable[[], object], message: str) -> None:
    """What a section can't know is said before anything runs: the value, its unit and what would be right."""
    with pytest.raises(InputError, match=message):
        make()
