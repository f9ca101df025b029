"""Laws of imperfections of sampled signals against NumPy: limits, quantisation, encoders, noise, jitter, and payload errors; known delays; random
streams against whole-number arithmetic and the published generator."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import pi, sqrt
from typing import Any

import casadi
import numpy as np
import pytest
from blocks import delay, encoder, jitter, lag, looped, noise, quantisation, rate_limit, sampled, saturation
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.signal_blocks import (
    JUMP,
    LARGEST_SEED,
    MODULI,
    MULTIPLIERS,
    draw,
    seeded,
    start_states,
)
from flexfmu.cosim.control.sections import with_payload_error
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

H = 1e-3
SIX_SIGMA = 6.0
PID = {"kind": "pid", "proportional": 4e3, "integral": 1e4, "derivative": 40.0, "sample_time": H}


def test_limits_for_each_channel_are_parameters() -> None:
    """Each channel has limits of its own, which can be tuned."""
    block = saturation(lower=[-1.0, -2.0], upper=[3.0, 4.0], sample_time=H)
    u = np.outer([-9.0, 0.5, 9.0], [1.0, 1.0])
    np.testing.assert_array_equal(sampled(block, u), [[-1.0, -2.0], [0.5, 0.5], [3.0, 4.0]])
    changed = {"joint1.torque.minimum": -0.1, "joint2.torque.maximum": 0.1}
    np.testing.assert_array_equal(sampled(block, u, changed), [[-0.1, -2.0], [0.5, 0.1], [3.0, 0.1]])


@pytest.mark.parametrize("falling", [None, 7.0])
def test_rates_are_parameters_with_units(falling: float | None) -> None:
    """The rates can be tuned; one number counts for both directions."""
    block = rate_limit(5.0, falling, signal="velocity", sample_time=H)
    assert [(each.name, each.unit, each.start, each.tunable) for each in block.parameters[::2]] == [
        ("joint1.velocity.rising_rate", "rad/s2", 5.0, True),
        ("joint1.velocity.falling_rate", "rad/s2", falling or 5.0, True),
    ]


def test_zero_resolution_switches_it_off() -> None:
    """A perfect sensor is a value of the parameter, with a finite result."""
    u = np.random.default_rng(3).normal(size=(30, 2))
    block = quantisation(1e-2, sample_time=H)
    y = sampled(block, u, {"joint2.position.resolution": 0.0})
    np.testing.assert_array_equal(y[:, 1], u[:, 1])
    assert (y[:, 0] != u[:, 0]).all()


@settings(max_examples=40)
@given(counts=st.floats(1.0, 1e6), window=st.integers(1, 6), seed=st.integers(0, 99))
def test_encoder_law(counts: float, window: int, seed: int) -> None:
    """Counts, angle and difference quotient as in plain NumPy, for any window."""
    u = np.random.default_rng(seed).normal(size=(25, 2))
    y = sampled(encoder(counts, sample_time=H, window=window), u)
    q = 2 * pi / counts
    c = np.floor(u / q + 0.5)
    past = np.vstack([np.tile(c[0], (window, 1)), c])[:25]
    np.testing.assert_array_equal(y[:, :2], q * c)
    np.testing.assert_allclose(y[:, 2:], (c - past) * q / (window * H), rtol=1e-14, atol=0)


def test_encoder_variables_fit_a_controller() -> None:
    """Angle and rate have the names and units that joint controllers measure."""
    block = encoder(40_000, sample_time=H)
    kinds = (("position", "rad"), ("velocity", "rad/s"))
    assert [(each.name, each.unit) for each in block.outputs] == [
        (f"joint{i}.{n}", u) for n, u in kinds for i in (1, 2)
    ]
    counts = [(f"joint{i}.position.counts_per_turn", 40_000.0, True) for i in (1, 2)]
    assert [(each.name, each.start, each.tunable) for each in block.parameters] == counts


def delays(count: int, **options: Any) -> np.ndarray:
    """Delays of a ramp's samples [s]."""
    t = H * np.arange(count)
    block = jitter(4e-4, options.pop("seed", 1), sample_time=H, initial=(-H, -H), **options)
    return t - sampled(block, t)[:, 0]


def test_delays_are_uniform() -> None:
    """A signal that is the time itself shows the delays: uniform from zero to the largest, white."""
    late = delays(50_000)
    assert kstest(late, "uniform", args=(0.0, 4e-4)).pvalue > 1e-6
    assert abs(late.mean() - 2e-4) < SIX_SIGMA * 4e-4 / sqrt(12 * 50_000)
    assert abs(np.corrcoef(late[1:], late[:-1])[0, 1]) < SIX_SIGMA / sqrt(50_000)


def test_law() -> None:
    """Each output lies between this sample and the last one, at the place that the ramp's delay tells."""
    part = delays(400)[:, None] / H
    u = np.random.default_rng(1).normal(size=(400, 2))
    y = sampled(jitter(1e-4, 1, sample_time=H, initial=(0.5, -0.5)), u, {"largest_delay": 4e-4})
    last = np.vstack([[0.5, -0.5], u[:-1]])
    np.testing.assert_allclose(y, u - part * (u - last), rtol=0, atol=1e-12)


def test_channels_of_a_block_share_the_clock_and_blocks_do_not() -> None:
    """One converter samples all its channels at the same instant; another name or seed is another clock."""
    t = np.tile(H * np.arange(300)[:, None], 2)
    y = sampled(jitter(4e-4, 1, sample_time=H), t)
    np.testing.assert_array_equal(y[:, 0], y[:, 1])
    assert abs(np.corrcoef(delays(300), delays(300, name="other"))[0, 1]) < SIX_SIGMA / sqrt(300)
    assert abs(np.corrcoef(delays(300), delays(300, seed=2))[0, 1]) < SIX_SIGMA / sqrt(300)


SEEDS = st.integers(0, LARGEST_SEED)


def published(s1: int, s2: int, count: int) -> list[float]:
    """L'Ecuyer's generator of 1988 for 32-bit machines, its products by Schrage's decomposition."""
    numbers = []
    for _ in range(count):
        k = s1 // 53668
        s1 = 40014 * (s1 - k * 53668) - k * 12211
        s1 += 2147483563 if s1 < 0 else 0
        k = s2 // 52774
        s2 = 40692 * (s2 - k * 52774) - k * 3791
        s2 += 2147483399 if s2 < 0 else 0
        z = s1 - s2
        numbers.append((z + 2147483562 if z < 1 else z) / 2147483563)
    return numbers


def jumped(name: str, seed: int) -> tuple[int, ...]:
    """The stream of a name after seed 2^40 numbers, by whole numbers of any length."""
    return tuple(
        pow(a, JUMP * seed, m) * s % m for a, m, s in zip(MULTIPLIERS, MODULI, start_states(name), strict=True)
    )


def states(name: str, seed: int) -> tuple[int, int]:
    """The stream of a name and a seed, as CasADi calculates it."""
    symbol = casadi.SX.sym("seed")
    values = np.array(casadi.Function("seeded", [symbol], [seeded([name], symbol)])(seed)).ravel()
    return int(values[0]), int(values[1])


def numbers(names: list[str], seed: int, count: int) -> np.ndarray:
    """Random numbers (count, names)."""
    x, n = casadi.SX.sym("x", 2 * len(names)), len(names)
    values, following = draw(x)
    step = casadi.Function("draw", [x, casadi.SX.sym("none", 0)], [following, values])
    start = casadi.Function("seeded", [], [seeded(names, casadi.SX(seed))])()["o0"]
    return np.array(step.mapaccum(count)(start, casadi.DM(0, count))[1]).T.reshape(count, n)


def uniform_numbers(name: str, seed: int, count: int) -> np.ndarray:
    """The stream by the published program, from where a seed jumps to."""
    return np.array(published(*jumped(name, seed), count))


def test_gaussian_law() -> None:
    """y = u + sigma sqrt(-2 ln U) cos(2 pi V) with the streams' numbers in pairs, in plain NumPy."""
    u = np.random.default_rng(1).normal(size=(500, 2))
    y = sampled(noise([0.1, 0.2], seed=99, sample_time=H), u)
    for i, scale in enumerate((0.1, 0.2)):
        radius, angle = uniform_numbers(f"noise/joint{i + 1}.position", 99, 1000).reshape(-1, 2).T
        expected = u[:, i] + scale * np.sqrt(-2 * np.log(radius)) * np.cos(2 * pi * angle)
        np.testing.assert_allclose(y[:, i], expected, rtol=0, atol=2e-15)


def test_uniform_law() -> None:
    """y = u + half_width (2 U - 1), in plain NumPy."""
    y = sampled(noise(half_width=0.25, seed=4, signal="torque", sample_time=H, name="ripple"), np.full(500, 3.0))[:, 0]
    np.testing.assert_allclose(
        y, 3.0 + 0.25 * (2 * uniform_numbers("ripple/joint1.torque", 4, 500) - 1), rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("key", ["standard_deviation", "half_width"])
def test_seed_is_a_parameter(key: str) -> None:
    """The same seed gives the same noise, another one another; an importer can choose it."""
    silence = np.zeros((50, 2))
    first, other = (sampled(noise(**{key: 1.0}, seed=seed, sample_time=H), silence) for seed in (1, 2))
    again = noise(**{key: 1.0}, seed=1, sample_time=H)
    np.testing.assert_array_equal(sampled(again, silence), first)
    np.testing.assert_array_equal(sampled(again, silence, {"seed": 2.0}), other)
    assert not np.isin(first, other).any()


def test_seeds_out_of_range_are_refused_at_run_time() -> None:
    """A parameter set later is checked like an argument."""
    slave = BlockSlave(noise(1.0, seed=3, sample_time=H))
    with pytest.raises(InputError, match=r"seed must be at most 1048575.0 1, got 2000000.0"):
        slave.set(np.array([4]), np.array([2e6]))


def test_a_payload_error_changes_the_mass_alone() -> None:
    """So that nothing else explains a difference; a mass is zero or positive and finite, and a part of nothing is nothing: saying
    nothing would hide that."""
    scene = load_scene("barnard2012-6kg")
    for relative in (-1.0, -0.3, 0.0, 0.3):
        wrong = with_payload_error(scene, relative)
        assert wrong.payload.mass == 6.0 * (1.0 + relative)
        assert wrong.replace({"payload.mass": 6.0}) == scene
    for relative in (-1.1, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"at least -1 \(no payload\), got"):
            with_payload_error(scene, relative)
    empty = scene.replace({"payload.mass": 0.0})
    assert with_payload_error(empty, 0.0) == empty
    with pytest.raises(InputError, match=r"has no payload, so -30% of it changes nothing"):
        with_payload_error(empty, -0.3)


@settings(max_examples=60)
@given(seed=SEEDS, name=st.text(max_size=20))
def test_seeding_is_exact(seed: int, name: str) -> None:
    """A seed jumps ahead by seed 2^40 numbers: compared with whole numbers of any length, for every seed."""
    assert states(name, seed) == jumped(name, seed)


@pytest.mark.parametrize("seed", [0, 1, LARGEST_SEED])
def test_numbers_are_those_of_the_published_generator(seed: int) -> None:
    """Twenty thousand numbers equal those of the published program, bit by bit."""
    got = numbers(["a"], seed, 20_000)[:, 0]
    np.testing.assert_array_equal(got, published(*states("a", seed), 20_000))


def test_extreme_states() -> None:
    """The largest and smallest states keep products exact and numbers inside (0, 1)."""
    x = casadi.SX.sym("x", 2)
    value, following = draw(x)
    step = casadi.Function("draw", [x], [value, following])
    for s1 in (1, 2, MODULI[0] - 1):
        for s2 in (1, 2, MODULI[1] - 1):
            u, after = step([s1, s2])
            assert 0.0 < float(u) < 1.0
            expected = [a * s % m for a, s, m in zip(MULTIPLIERS, (s1, s2), MODULI, strict=True)]
            assert [int(each) for each in np.array(after).ravel()] == expected
            assert float(u) == published(s1, s2, 1)[0]


def test_equal_states_give_the_largest_number() -> None:
    """Where both generators meet, their difference is zero: it becomes the largest number, not zero, whose logarithm is infinite."""
    before = [pow(a, -1, m) * 1234567 % m for a, m in zip(MULTIPLIERS, MODULI, strict=True)]
    x = casadi.SX.sym("x", 2)
    u = casadi.Function("draw", [x], [draw(x)[0]])(before)
    assert float(u) == (MODULI[0] - 1) / MODULI[0]


def test_numbers_never_change() -> None:
    """Whoever repeats an experiment years later gets the same numbers: name and seed mean the same in all versions."""
    assert JUMP == 2**40
    assert start_states("noise/joint1.position") == (510063222, 1608203664)
    assert states("noise/joint1.position", 1) == (100566748, 2131566761)


@pytest.mark.filterwarnings("ignore::flexfmu.cosim.engine.errors.LoopWarning")
def test_references_of_a_known_delay_are_as_late_as_the_measurement() -> None:
    run = flexfmu.run(looped(PID, {"kind": "delay", "signal": "position", "time": 2e-3, "known": True}))
    time, joints = run.recording.time, run.plan.joints
    at_samples = np.flatnonzero(np.abs(time / H - np.round(time / H)) < 1e-9)[20:400]
    found = run.recording["delay.joint1.reference.position"].values[at_samples]
    # the right limit of an instant that is there twice
    last = np.append(np.diff(time[at_samples]) > 0.0, True)
    expected = joints.evaluate(time[at_samples] - 2e-3, 0)[0, :, 0]
    np.testing.assert_allclose(found[last], expected[last], atol=1e-12)


def test_a_known_delay_is_one_of_a_measurement() -> None:
    with pytest.raises(SceneError, match='a `known` delay is one of `signal = "position"` or "velocity", got "torque"'):
        looped(PID, {"kind": "delay", "time": 2e-3, "known": True})


def test_margins_are_those_of_large_signals() -> None:
    plain = scene_margins(looped(PID), poses=1).worst.gain_margin
    rough = [{"kind": "dead-zone", "half_width": 0.5}, {"kind": "backlash", "gap": 1e-4}]
    assert scene_margins(looped(PID, *rough), poses=1).worst.gain_margin == pytest.approx(plain, rel=1e-6)


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
