"""Uniform random numbers that are the same in Python and in exported C to the last bit: their integers are exact.

The generator combines two multiplicative congruential generators with moduli below 2^31; its period is 2.3e18: P.
L'Ecuyer, Efficient and portable combined random number generators, Communications of the ACM 31(6), 1988, pp. 742-751.
Products stay below 2^48, so doubles hold them exactly.

Every stream has a name, whose hash is its start state, and a seed, which skips seed * 2^40 numbers (P. L'Ecuyer,
S. Côté, Implementing a random number package with splitting facilities, ACM Transactions on Mathematical Software
17(1), 1991, pp. 98-111). So a signal's random numbers don't depend on the other signals of its block, different seeds
use disjoint parts of a stream, and differently named streams start at unrelated states.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector, split
from flexfmu.model.symbolic import Variable

MODULI = (2147483563, 2147483399)
MULTIPLIERS = (40014, 40692)

JUMP = 2**40
"""Uniform random numbers from one seed to the next: 127 days at 100 kHz."""

SEED_BITS = 20
LARGEST_SEED = 2**SEED_BITS - 1

_HALF = 2**16


def start_states(name: str) -> tuple[int, int]:
    """Return the start states of a named stream with seed 0."""
    digest = sha256(name.encode()).digest()
    first, second = (
        1 + int.from_bytes(digest[8 * i : 8 * i + 8], "big") % (modulus - 1) for i, modulus in enumerate(MODULI)
    )
    return first, second


def seeded(names: Sequence[str], seed: Vector) -> Vector:
    """Return the states of n named streams for a seed (scalar), a whole number from 0 to `LARGEST_SEED`.

    They are whole numbers (2 n,): first those of all first congruential generators, then those of all second ones.
    """
    starts = np.array([start_states(name) for name in names], dtype=float).T
    return casadi.vertcat(
        *(
            _long_product(_jump(seed, multiplier, modulus), casadi.DM(start), modulus)
            for start, multiplier, modulus in zip(starts, MULTIPLIERS, MODULI, strict=True)
        )
    )


def draw(states: Vector) -> tuple[Vector, Vector]:
    """Draw one number of each stream, uniform in (0, 1); return the numbers (n,) and the next states (2 n,)."""
    first, second = (
        _remainder(multiplier * state, modulus)
        for state, multiplier, modulus in zip(split(states, states.numel() // 2), MULTIPLIERS, MODULI, strict=True)
    )
    difference = first - second
    whole = casadi.if_else(difference < 1.0, difference + (MODULI[0] - 1), difference)
    return whole / MODULI[0], casadi.vertcat(first, second)


def seed_parameter(seed: int) -> Variable:
    """Return the fixed parameter ``seed``."""
    return Variable("seed", "1", "Number of the random experiment", "parameter", float(seed), 0.0, float(LARGEST_SEED))


def _jump(seed: Vector, multiplier: int, modulus: int) -> Vector:
    """Return multiplier^(JUMP seed) modulo the modulus, by the seed's binary digits."""
    result: Any = 1.0
    rest = casadi.floor(seed)
    # square-and-multiply: the powers are constants, the digits select among them
    for bit in range(SEED_BITS):
        factor = pow(multiplier, JUMP << bit, modulus)
        half = casadi.floor(rest / 2.0)
        digit = rest - 2.0 * half
        result = _long_product(1.0 + digit * (factor - 1.0), result, modulus)
        rest = half
    return result


def _long_product(a: Vector, b: Vector, modulus: int) -> Vector:
    """Return a b modulo the modulus for whole a and b below it; b is split in two, so that no product exceeds 2^48."""
    upper = casadi.floor(b / _HALF)
    lower = b - _HALF * upper
    return _remainder(_HALF * _remainder(a * upper, modulus) + a * lower, modulus)


def _remainder(value: Vector, modulus: int) -> Vector:
    """Return the exact remainder of whole numbers below 2^48 divided by a modulus between 2^30 and 2^31.

    The quotient is below 2^18, so its rounding error is below 2^-35. Unless it is whole, it is more than 2^-31 away
    from a whole number, so `floor` finds the right one.
    """
    return value - modulus * casadi.floor(value / modulus)
