"""The numbers of the elementary functions in `fmu_build/c-runtime/math`: minimax polynomials, tables, parts of pi and ln 2.

    python generators/elementary_constants.py    # writes fmu_build/c-runtime/math/elementary_*_constants.h

Needs mpmath; a test compares the headers with what this writes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from mpmath import atan, cos, exp, floor, ldexp, log, mp, mpf, nint, pi, sin, sqrt
from remez import Function, minimax

mp.prec = 1400  # the table of 2/pi alone has 1184 bits
RUNTIME = Path(__file__).parents[1] / "fmu_build" / "c-runtime" / "math"

LINE = 136
"""Longest line of a table, without its indentation."""

PI_PART_BITS = 33
"""The number of quarter turns, of up to 20 bits, times a part of pi/2 is exact."""
EXPONENTIAL_STEPS = 32
"""Tabulated powers of two between 1 and 2."""
LOGARITHM_STEPS = 128
"""Tabulated logarithms are those of multiples of 1/128."""
LOGARITHM_BITS = 42
"""Multiples of 2^-42 add up exactly with ln 2 times any exponent of a double."""
ARCTANGENT_STEPS = 64


def headers() -> dict[str, str]:
    """File name → text."""
    parts = {"sine": _sine(), "exponential": _exponential(), "logarithm": _logarithm(), "arctangent": _arctangent()}
    return {f"elementary_{name}_constants.h": _header(name, lines) for name, lines in parts.items()}


def _sine() -> list[str]:
    """(sin x / x - 1) / x² and (cos x - 1 + x²/2) / x⁴ as polynomials in z = x², pi/2 in parts, 2/pi in words."""
    end = (pi / 4 * mpf("1.0001")) ** 2
    sine = _polynomial("sine_series", lambda z: (sin(sqrt(z)) / sqrt(z) - 1) / z, lambda z: z, mpf("1e-6"), end, 5)
    cosine = _polynomial(
        "cosine_series", lambda z: (cos(sqrt(z)) - 1 + z / 2) / z**2, lambda z: z**2, mpf("1e-6"), end, 5
    )
    parts = _parts(pi / 2, (PI_PART_BITS, PI_PART_BITS, 53))
    lines = [f"#define HALF_PI_{i} {part}" for i, part in enumerate(parts)]
    lines += [f"#define HALF_PI_{end} {part}" for end, part in zip(("HI", "LO"), _parts(pi / 2, (53, 53)), strict=True)]
    lines += [f"#define TWO_OVER_PI {_double(2 / pi)}", f"#define QUARTER_PI {_double(pi / 4)}"]
    words = [f"0x{int(floor(ldexp(2 / pi, 32 * (i + 1)))) % 2**32:08x}u" for i in range(37)]
    return [*sine, *cosine, *lines, *_array("uint32_t", "two_over_pi", len(words), words)]


def _exponential() -> list[str]:
    """(e^t - 1 - t) / t² for |t| up to ln 2 / 64, 2^(j/32) as double-doubles, ln 2 / 32 in parts."""
    end = log(2) / (2 * EXPONENTIAL_STEPS) * mpf("1.001")
    polynomial = _polynomial(
        "exponential_series", lambda t: (exp(t) - 1 - t) / t**2, lambda t: t**2, -end, end, 5, skip=True
    )
    table = [_pair(mpf(2) ** (mpf(j) / EXPONENTIAL_STEPS)) for j in range(EXPONENTIAL_STEPS)]
    step = _parts(log(2) / EXPONENTIAL_STEPS, (PI_PART_BITS, 53))
    lines = [f"#define LN2_STEP_{i} {part}" for i, part in enumerate(step)]
    lines += [f"#define STEPS_PER_LN2 {_double(EXPONENTIAL_STEPS / log(2))}"]
    return [*polynomial, *lines, *_array("double", "roots_of_two", f"{EXPONENTIAL_STEPS}][2", table)]


def _logarithm() -> list[str]:
    """(ln(1 + r) - r + r²/2) / r³ for |r| up to 1/180, ln(1 + j/128), ln 2, all in parts that add exactly."""
    end = mpf(1) / (2 * LOGARITHM_STEPS) / mpf("0.7")
    polynomial = _polynomial(
        "logarithm_series", lambda r: (log(1 + r) - r + r**2 / 2) / r**3, lambda r: r**2, -end, end, 6, skip=True
    )
    first = int(floor((sqrt(mpf(1) / 2) - 1) * LOGARITHM_STEPS)) - 1
    last = int(floor((sqrt(mpf(2)) - 1) * LOGARITHM_STEPS)) + 2
    table = [_fixed(log(1 + mpf(j) / LOGARITHM_STEPS)) for j in range(first, last + 1)]
    hi, lo = _fixed(log(2)).split(", ")
    lines = [f"#define LN2_HI {hi.strip('{}')}", f"#define LN2_LO {lo.strip('{}')}", f"#define FIRST_LOGARITHM {first}"]
    return [*polynomial, *lines, *_array("double", "logarithms", f"{len(table)}][2", table)]


def _arctangent() -> list[str]:
    """(atan t / t - 1) / t² in z = t² for t up to 1/128, atan(j/64) and pi as double-doubles."""
    end = (mpf(1) / (2 * ARCTANGENT_STEPS) * mpf("1.01")) ** 2
    polynomial = _polynomial(
        "arctangent_series", lambda z: (atan(sqrt(z)) / sqrt(z) - 1) / z, lambda z: z, end / 10**6, end, 3
    )
    table = [_pair(atan(mpf(j) / ARCTANGENT_STEPS)) for j in range(ARCTANGENT_STEPS + 1)]
    lines = [f"#define PI_{end} {part}" for end, part in zip(("HI", "LO"), _parts(pi, (53, 53)), strict=True)]
    return [*polynomial, *lines, *_array("double", "arctangents", f"{ARCTANGENT_STEPS + 1}][2", table)]


def _polynomial(
    name: str, function: Function, weight: Function, low: mpf, high: mpf, degree: int, *, skip: bool = False
) -> list[str]:
    """An inline function and its expression as a macro, for lanes; ``skip`` where the interval contains 0, at which the
    function is a limit."""
    precision, mp.prec = mp.prec, 400
    tiny = high * mpf(2) ** -40

    def smooth(x: mpf) -> mpf:
        return function(x if abs(x) > tiny else tiny) if skip else function(x)

    def positive_weight(x: mpf) -> mpf:
        return weight(x if abs(x) > high / 100 else high / 100)

    coefficients, error = minimax(smooth, positive_weight, low, high, degree)
    mp.prec = precision
    comment = f"/* degree {degree}, weighted error {float(error):.1e} */"
    macro = f"{name.upper()}(z, z2)"
    body = f"  double z2 = z * z;\n  return {macro};"
    expression = f"#define {macro} {_by_pairs([_double(c) for c in coefficients])}"
    return [comment, expression, f"static inline double {name}(double z) {{", body, "}"]


def _by_pairs(numbers: Sequence[str]) -> str:
    """Horner's form in z² of pairs, which a processor calculates side by side."""
    pair = f"({numbers[0]} + (z) * {numbers[1]})" if len(numbers) > 1 else numbers[0]
    return f"({pair} + (z2) * {_by_pairs(numbers[2:])})" if len(numbers) > 2 else pair


def _double(x: mpf) -> str:
    """Nearest double, in hexadecimal, so that every compiler reads the same one."""
    return float(x).hex()


def _parts(x: mpf, bits: Sequence[int]) -> list[str]:
    """Doubles of so many bits whose sum is x."""
    parts = []
    for count in bits:
        scale = count - 1 - int(floor(log(abs(x), 2)))
        part = ldexp(nint(ldexp(x, scale)), -scale)
        parts.append(_double(part))
        x -= part
    return parts


def _pair(x: mpf) -> str:
    return f"{{{_double(x)}, {_double(x - mpf(float(x)))}}}"


def _fixed(x: mpf) -> str:
    """A multiple of 2^-42 and the rest."""
    hi = ldexp(nint(ldexp(x, LOGARITHM_BITS)), -LOGARITHM_BITS)
    return f"{{{_double(hi)}, {_double(x - hi)}}}"


def _array(kind: str, name: str, size: object, values: Iterable[str]) -> list[str]:
    texts = [f"{value}," for value in values]
    count = LINE // (len(max(texts, key=len)) + 1)
    rows = [f"    {' '.join(texts[k : k + count])}" for k in range(0, len(texts), count)]
    return [f"static const {kind} {name}[{size}] = {{", *rows, "};"]


def _header(name: str, lines: list[str]) -> str:
    guard = f"FLEXFMU_ELEMENTARY_{name.upper()}_CONSTANTS_H"
    origin = "/* Written by generators/elementary_constants.py; don't edit. */"
    return "\n".join([origin, f"#ifndef {guard}", f"#define {guard}", "", *lines, "", "#endif", ""])


if __name__ == "__main__":
    for file_name, text in headers().items():
        (RUNTIME / file_name).write_text(text, encoding="utf-8", newline="\n")
