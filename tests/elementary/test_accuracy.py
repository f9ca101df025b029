"""The elementary functions of the C runtime, called through a small program: within one unit of the last place of mpmath's 60 digits,
everywhere; C99's annex F at the ends; the same bits in lanes; tables as their generator gives them."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

Array = NDArray[np.float64]
Call = tuple[str, float, float]
Evaluate = Callable[[Sequence[Call]], Array]

ROOT = Path(__file__).parents[2]
RUNTIME = ROOT / "fmu_build" / "c-runtime" / "math"
SOURCES = [Path(__file__).with_name("probe.c"), *sorted(RUNTIME.glob("elementary_*.c"))]
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-fno-math-errno")
COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def digits(calls: Sequence[Call]) -> str:
    """What the program reads: one call a line, numbers as the digits of their bits."""
    bits = np.array([call[1:] for call in calls], dtype=float).view(np.uint64)
    return "\n".join(f"{name} {x:016x} {y:016x}" for (name, _, _), (x, y) in zip(calls, bits.tolist(), strict=True))


def results_of(program: Path, calls: Sequence[Call], emulator: Sequence[str] = ()) -> Array:
    """Result of each call, one after the other."""
    outcome = subprocess.run([*emulator, program], input=digits(calls), capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr
    return np.array([int(word, 16) for word in outcome.stdout.split()], dtype=np.uint64).view(float)


def build_probe(folder: Path, flags: Sequence[str]) -> Path:
    """The program."""
    if COMPILER is None:
        pytest.skip("no C compiler")
    program = folder / "probe"
    subprocess.run(
        [COMPILER, *FLAGS, *flags, f"-I{RUNTIME}", f"-I{RUNTIME.parent / 'lanes'}", *SOURCES, "-o", program, "-lm"],
        check=True,
    )
    return program


TINY, HUGE = 5e-324, float(np.finfo(float).max)
SPECIAL = (0.0, -0.0, TINY, -TINY, 2.2250738585072014e-308, 1.0, -1.0, 0.5, 2.0, -3.0, 1e22, HUGE, -HUGE)
WORST_ANGLE = 6381956970095103 * 2.0**797
"""The double that is nearest to a multiple of pi/2, relative to what is left: Muller, Elementary Functions, table 11.1."""

RANGES = {
    **dict.fromkeys(("sin", "cos", "tan"), (-10.0, 10.0)),
    **dict.fromkeys(("asin", "acos", "atanh"), (-1.0, 1.0)),
    **dict.fromkeys(("atan", "sinh", "cosh"), (-5.0, 5.0)),
    **dict.fromkeys(("expm1", "tanh"), (-3.0, 3.0)),
    **dict.fromkeys(("erf", "asinh"), (-4.0, 4.0)),
    **dict.fromkeys(("floor", "ceil"), (-9.0, 9.0)),
    "exp": (-745.0, 709.7),
    "log": (0.0, 4.0),
    "log1p": (-1.0, 3.0),
    "acosh": (1.0, 6.0),
}
"""Function of one argument → where it is used."""

PAIR_RANGES = {
    "atan2": ((-1.0, 1.0), (-1.0, 1.0)),
    "pow": ((0.0, 10.0), (-300.0, 300.0)),
    "hypot": ((-3.0, 3.0), (-3.0, 3.0)),
    "fmod": ((-300.0, 300.0), (-3.0, 3.0)),
    "remainder": ((-300.0, 300.0), (-3.0, 3.0)),
}


NAMES = [*RANGES, *PAIR_RANGES]
"""All functions."""


def calls_of(name: str, count: int, seed: int) -> list[Call]:
    """Finite arguments of a function: where it is used, near zero, of any size, and near multiples of pi/2."""
    random = np.random.default_rng(seed)
    if name in PAIR_RANGES:
        (a, b), (c, d) = PAIR_RANGES[name]
        pairs = np.column_stack([random.uniform(a, b, count), random.uniform(c, d, count)])
        wide = np.column_stack([_of_any_size(random, count // 2), _of_any_size(random, count // 2)])
        return [(name, float(x), float(y)) for x, y in np.vstack([pairs, wide])]
    arguments = [
        random.uniform(*RANGES[name], count),
        _of_any_size(random, count // 2),
        _near_quarters(random, count // 4),
    ]
    small = random.uniform(-1.0, 1.0, count // 4) * 2.0 ** random.uniform(-60.0, 0.0, count // 4)
    start = 1.0 if name == "acosh" else 0.0
    return [(name, float(x), 0.0) for x in np.concatenate([*arguments, start + small, [WORST_ANGLE]])]


def special_calls(names: Sequence[str]) -> list[Call]:
    """Zeros, ones, numbers beyond the normal ones and infinities, in all combinations; NaN too."""
    values = (*SPECIAL, math.inf, -math.inf, math.nan)
    return [(name, x, y) for name in names for x in values for y in (values if name in PAIR_RANGES else (0.0,))]


def _of_any_size(random: np.random.Generator, count: int) -> Array:
    """Of any exponent, numbers below the normal ones included."""
    bits = random.integers(0, 2**64, 2 * count, dtype=np.uint64).view(float)
    return bits[np.isfinite(bits)][:count]


def _near_quarters(random: np.random.Generator, count: int) -> Array:
    """Doubles around k pi/2, k up to a billion."""
    multiples = np.floor(2.0 ** random.uniform(0.0, 30.0, count)) * (math.pi / 2.0)
    return multiples * (1.0 + random.integers(-2, 3, count) * 2.0**-53)


@pytest.fixture(scope="session")
def evaluate(tmp_path_factory: pytest.TempPathFactory) -> Evaluate:
    """Function that gives the result of each call."""
    program = build_probe(tmp_path_factory.mktemp("plain"), ("-O2",))
    return lambda calls: results_of(program, calls)


@pytest.fixture(scope="session")
def evaluate_sanitized(tmp_path_factory: pytest.TempPathFactory) -> Evaluate:
    """The same under the address and undefined-behaviour sanitizers."""
    flags = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    program = build_probe(tmp_path_factory.mktemp("sanitized"), flags)
    return lambda calls: results_of(program, calls)


COUNT = int(os.environ.get("FLEXFMU_ELEMENTARY", "300"))
"""Arguments drawn for each function: a thousand times as many were tried."""

MOST_ULPS = {"sin": 0.85, "cos": 0.85, "tan": 0.99, "floor": 0.0, "ceil": 0.0, "fmod": 0.0, "remainder": 0.0}
"""The largest error that the error analysis of each function admits; of all the others it is this:"""
OTHERS = 0.54
DIGITS = 60
EXACT = {"fmod": math.fmod, "remainder": math.remainder, "floor": math.floor, "ceil": math.ceil}


def _exact(call: Call) -> object:
    """The value in many digits; None where it isn't a real number."""
    name, x, y = call
    if name in EXACT:
        return EXACT[name](x, y) if name in ("fmod", "remainder") else mpmath.mpf(EXACT[name](x))
    if name == "pow" and abs(y * math.log(abs(x))) > 800.0 and (x > 0.0 or y % 2.0 == 0.0):
        return mpmath.mpf(2) ** (2000 if (y > 0) == (abs(x) > 1) else -2000)
    if name == "pow" and x < 0.0 and y % 1.0 != 0.0:
        return None
    if name in ("exp", "expm1", "sinh", "cosh") and abs(x) > 800.0:
        large = mpmath.exp(800)
        return {"exp": large if x > 0 else 1 / large, "expm1": large if x > 0 else -1, "cosh": large}.get(
            name, math.copysign(1.0, x) * large
        )
    function = {"pow": mpmath.power}.get(name) or getattr(mpmath, name)
    value = function(x, y) if name in PAIR_RANGES else function(x)
    return value if isinstance(value, mpmath.mpf) else None


def _ulps(got: float, exact: object) -> float:
    """Difference in units of the last place of the exact value."""
    if exact is None:
        return 0.0 if math.isnan(got) else math.inf
    nearest = float(exact)  # type: ignore[arg-type]
    if math.isinf(nearest) or math.isinf(got) or math.isnan(got):
        return 0.0 if got == nearest else math.inf
    return float(abs(mpmath.mpf(got) - exact) / mpmath.mpf(math.ulp(nearest)))


def _errors(calls: list[Call], results: Array) -> list[float]:
    # numbers below the normal ones need 1074 binary digits behind the point, differences from 1 as many
    with mpmath.workdps(DIGITS):
        return [_ulps(float(got), _exact(call)) for call, got in zip(calls, results, strict=True)]


@pytest.mark.parametrize("name", NAMES)
def test_error_is_below_one_unit_of_the_last_place(name: str, evaluate: Evaluate) -> None:
    """Numbers that agree everywhere must be right too."""
    calls = calls_of(name, COUNT, seed=2)
    errors = _errors(calls, evaluate(calls))
    worst = int(np.argmax(errors))
    assert errors[worst] <= MOST_ULPS.get(name, OTHERS), calls[worst]


@pytest.mark.parametrize("name", NAMES)
def test_special_values_are_those_of_the_standard(name: str, evaluate: Evaluate) -> None:
    """Zeros with their signs, infinities and NaN, as Python's and numpy's functions give them."""
    calls = special_calls([name])
    if name in ("sin", "cos", "tan"):
        calls = [call for call in calls if abs(call[1]) != 1e22]
    function = {"erf": np.vectorize(math.erf), "atan2": np.arctan2, "pow": np.vectorize(_power)}.get(name)
    function = function or _numpy_function(name)
    columns = np.array([call[1:] for call in calls])
    with np.errstate(all="ignore"):
        expected = function(*columns.T) if name in PAIR_RANGES else function(columns[:, 0])
    results = evaluate(calls)
    np.testing.assert_allclose(results, expected, rtol=1e-14, atol=0.0, equal_nan=True)
    is_number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(results[is_number]), np.signbit(expected[is_number]))


def _power(x: float, y: float) -> float:
    """numpy's takes a square root for y = 1/2, which is something else at minus infinity."""
    try:
        return math.pow(x, y)
    except OverflowError:
        return math.copysign(math.inf, x) if y % 2.0 == 1.0 else math.inf
    except ValueError:
        return math.nan if x else math.copysign(math.inf, x) if y % 2.0 == 1.0 else math.inf


def _numpy_function(name: str) -> object:
    if name == "remainder":
        return np.vectorize(lambda x, y: math.remainder(x, y) if math.isfinite(x) and y and y == y else math.nan)
    return getattr(np, name.replace("a", "arc", 1) if name.startswith("a") else name)


def test_sanitizers_find_nothing(evaluate: Evaluate, evaluate_sanitized: Evaluate) -> None:
    """An index beyond a table or an overflowing integer gives right results on one machine and wrong ones on another."""
    calls = [call for name in NAMES for call in calls_of(name, 100, seed=3)] + special_calls(NAMES)
    np.testing.assert_array_equal(evaluate_sanitized(calls), evaluate(calls))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_lanes_give_the_same_bits(name: str, evaluate: Evaluate) -> None:
    """A step's stages are evaluated side by side on some processors: these must get the numbers of all others."""
    calls = [*calls_of(name, 20 * COUNT, seed=4), *special_calls([name])]
    lanes = evaluate([(f"lanes_{name}", x, y) for _, x, y in calls])
    np.testing.assert_array_equal(lanes.view(np.uint64), evaluate(calls).view(np.uint64))


def test_minimum_and_maximum_tell_zeros_apart(evaluate: Evaluate) -> None:
    """C leaves the order of zeros open, and libraries differ; NaN gives way to a number."""
    calls = [("fmin", 0.0, -0.0), ("fmin", -0.0, 0.0), ("fmax", -0.0, 0.0), ("fmax", 0.0, -0.0)]
    assert [math.copysign(1.0, result) for result in evaluate(calls)] == [-1.0, -1.0, 1.0, 1.0]
    calls = [("fmin", math.nan, 2.0), ("fmin", 2.0, math.nan), ("fmax", math.nan, 2.0), ("fmax", 2.0, math.nan)]
    np.testing.assert_array_equal(evaluate(calls), 2.0)


@pytest.mark.parametrize("exponent", [-2200, -1100, -1074, -1022, -1, 0, 1, 1023, 1100, 2200])
def test_ldexp_rounds_once(exponent: int, evaluate: Evaluate) -> None:
    """Below the normal numbers a second rounding would show."""
    mantissas = [1.0, 1.5, 1.0 + 2.0**-52, -1.9999999, 3.1e-310, 1e300]

    def exact(x: float) -> float:
        try:
            return math.ldexp(x, exponent)
        except OverflowError:
            return math.copysign(math.inf, x)

    np.testing.assert_array_equal(evaluate([("ldexp", x, exponent) for x in mantissas]), [exact(x) for x in mantissas])


@pytest.mark.slow
def test_headers_are_generated(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number that nobody can derive again is a number that nobody can trust."""
    monkeypatch.syspath_prepend(str(ROOT / "generators"))
    from elementary_constants import headers

    kept = (ROOT / "fmu_build" / "c-runtime" / "math").glob("elementary_*_constants.h")
    assert {path.name: path.read_text() for path in kept} == headers()
