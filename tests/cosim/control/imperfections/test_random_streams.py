"""Random streams against whole-number arithmetic, the published generator, and statistics."""

from __future__ import annotations

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.cosim.control.imperfections.signal_blocks import (
    JUMP,
    LARGEST_SEED,
    MODULI,
    MULTIPLIERS,
    draw,
    seeded,
    start_states,
)

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


@settings(max_examples=60)
@given(seed=SEEDS, name=st.text(max_size=20))
def test_seeding_is_exact(seed: int, name: str) -> None:
    """A seed jumps ahead by seed 2^40 numbers: compared with whole numbers of any length, for every seed."""
    expected = tuple(
        pow(a, JUMP * seed, m) * s % m for a, m, s in zip(MULTIPLIERS, MODULI, start_states(name), strict=True)
    )
    assert states(name, seed) == expected


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
