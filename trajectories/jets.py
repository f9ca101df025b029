"""Jets: truncated Taylor series in one variable, for exact derivatives of any order.

A jet holds the normalised Taylor coefficients c_k = f^(k)/k! of a function at a point, for many points at once. Each
operation propagates the coefficients by a recurrence that costs O(order²), so that derivatives of a composite formula
are as exact as its value: no finite differences, no symbolic expressions.

Source of the recurrences: A. Griewank, A. Walther, *Evaluating Derivatives*, 2nd edition, SIAM 2008, section 13.2,
tables 13.1 (arithmetic, roots and powers) and 13.2 (sine and cosine).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from flexfmu.trajectories.errors import TrajectoryError

RealArray: TypeAlias = NDArray[np.float64]
Indices: TypeAlias = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Jet:
    """Taylor series of a function of one variable, truncated after ``order``, at an array of points.

    Jets combine with jets, numbers and arrays by ``+ - * /``; numbers and arrays are constants. Where the orders
    differ the result has the lower one, since more isn't known.

    Attributes:
        coefficients: normalised Taylor coefficients f^(k)/k!, shape (order + 1, ...); in the function's unit over
            the k-th power of the variable's unit.
    """

    coefficients: RealArray

    # numpy leaves `array * jet` to the jet
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        if np.ndim(self.coefficients) == 0 or len(self.coefficients) == 0:
            raise TrajectoryError("a jet needs at least one coefficient along its first axis, got none")

    @classmethod
    def constant(cls, value: ArrayLike, order: int) -> Jet:
        """The series of a constant ``value``, any shape."""
        value = np.asarray(value, dtype=float)
        coefficients = np.zeros((checked_order(order) + 1, *value.shape))
        coefficients[0] = value
        return cls(coefficients)

    @classmethod
    def variable(cls, value: ArrayLike, order: int) -> Jet:
        """The series of the variable itself at ``value``, any shape: value, 1, 0, 0, ..."""
        jet = cls.constant(value, order)
        jet.coefficients[1:2] = 1.0
        return jet

    @classmethod
    def from_derivatives(cls, derivatives: ArrayLike) -> Jet:
        """The series of a function with this value and these derivatives, shape (order + 1, ...)."""
        derivatives = np.asarray(derivatives, dtype=float)
        return cls(derivatives / _factorials(derivatives))

    def derivatives(self) -> RealArray:
        """Value and derivatives f^(k), shape (order + 1, ...)."""
        return self.coefficients * _factorials(self.coefficients)

    @property
    def order(self) -> int:
        """Order of the highest derivative known."""
        return len(self.coefficients) - 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the array of points."""
        return self.coefficients.shape[1:]

    @property
    def value(self) -> RealArray:
        """The function's value, shape (...)."""
        return np.asarray(self.coefficients[0])

    def differentiate(self) -> Jet:
        """The derivative's series, one order lower."""
        if self.order == 0:
            raise TrajectoryError("a jet of order 0 has no derivative; ask for order 1 or more")
        return Jet(self.coefficients[1:] * _column(np.arange(1.0, self.order + 1), self.coefficients))

    def integrate(self, value: ArrayLike = 0.0) -> Jet:
        """The antiderivative's series that has ``value`` here, one order higher."""
        # coefficients move up by one, each divided by its new order
        first = np.broadcast_to(np.asarray(value, dtype=float), self.shape)
        rest = self.coefficients / _column(np.arange(1.0, self.order + 2), self.coefficients)
        return Jet(np.concatenate([first[None], rest]))

    def rescale(self, factor: float) -> Jet:
        """The series of f(factor · x) as a function of x: the old variable is ``factor`` times the new one."""
        return Jet(self.coefficients * _column(factor ** np.arange(self.order + 1.0), self.coefficients))

    def __neg__(self) -> Jet:
        return Jet(-self.coefficients)

    def __add__(self, other: Jet | ArrayLike) -> Jet:
        if isinstance(other, Jet):
            order = min(self.order, other.order)
            a, b = _aligned(self, other.coefficients.ndim), _aligned(other, self.coefficients.ndim)
            return Jet(a[: order + 1] + b[: order + 1])
        # a constant changes the value alone
        constant = np.asarray(other, dtype=float)
        a = _aligned(self, constant.ndim + 1)
        v = np.empty((self.order + 1, *np.broadcast_shapes(a.shape[1:], constant.shape)))
        v[1:] = a[1:]
        v[0] = a[0] + constant
        return Jet(v)

    __radd__ = __add__

    def __sub__(self, other: Jet | ArrayLike) -> Jet:
        return self + (-other if isinstance(other, Jet) else -np.asarray(other, dtype=float))

    def __rsub__(self, other: ArrayLike) -> Jet:
        return -self + other

    def __mul__(self, other: Jet | ArrayLike) -> Jet:
        if not isinstance(other, Jet):
            factor = np.asarray(other, dtype=float)
            return Jet(_aligned(self, factor.ndim + 1) * factor)
        # Cauchy product, one coefficient of the left factor after the other
        order = min(self.order, other.order)
        a, b = _aligned(self, other.coefficients.ndim), _aligned(other, self.coefficients.ndim)
        v = a[0] * b[: order + 1]
        for k in range(1, order + 1):
            v[k:] += a[k] * b[: order + 1 - k]
        return Jet(v)

    __rmul__ = __mul__

    def __truediv__(self, other: Jet | ArrayLike) -> Jet:
        if not isinstance(other, Jet):
            divisor = np.asarray(other, dtype=float)
            _require(divisor, divisor != 0.0, "division", "other than zero")
            return Jet(_aligned(self, divisor.ndim + 1) / divisor)
        # v w = u solved for the coefficients of v in ascending order
        _require(other.value, other.value != 0.0, "division", "other than zero")
        order = min(self.order, other.order)
        a, b = _aligned(self, other.coefficients.ndim), _aligned(other, self.coefficients.ndim)
        inverse = 1.0 / b[0]
        v = np.empty((order + 1, *np.broadcast_shapes(self.shape, other.shape)))
        for k in range(order + 1):
            v[k] = (a[k] - _convolve(v[:k], b[1 : k + 1])) * inverse
        return Jet(v)

    def __rtruediv__(self, other: ArrayLike) -> Jet:
        return Jet.constant(other, self.order) / self


def sqrt(u: Jet) -> Jet:
    """Square root of a jet with values above zero; a value of zero is valid at order 0 only."""
    # a root of zero has no derivative
    lowest = u.value if u.order == 0 else np.where(u.value > 0.0, u.value, -1.0)
    _require(u.value, lowest >= 0.0, "square root", "above zero")
    v = np.empty_like(u.coefficients)
    # v² = u solved for the coefficients of v in ascending order
    v[0] = np.sqrt(u.value)
    for k in range(1, u.order + 1):
        v[k] = (u.coefficients[k] - _convolve(v[1:k], v[1:k])) / (2.0 * v[0])
    return Jet(v)


def power(u: Jet, exponent: float) -> Jet:
    """Real power of a jet with values above zero."""
    _require(u.value, u.value > 0.0, "real power", "above zero")
    slope = _slopes(u.coefficients)
    v = np.empty_like(u.coefficients)
    v_slope = np.empty_like(v)
    # u v' = exponent v u' solved for the coefficients of v in ascending order
    v[0] = u.value**exponent
    for k in range(1, u.order + 1):
        change = exponent * _convolve(v[:k], slope[1 : k + 1]) - _convolve(u.coefficients[1:k], v_slope[1:k])
        v_slope[k] = change / u.value
        v[k] = v_slope[k] / k
    return Jet(v)


def sincos(u: Jet) -> tuple[Jet, Jet]:
    """Sine and cosine of a jet in radians, which need each other's coefficients."""
    slope = _slopes(u.coefficients)
    s, c = np.empty_like(slope), np.empty_like(slope)
    # s' = c u' and c' = -s u', solved for the coefficients in ascending order
    s[0], c[0] = np.sin(u.value), np.cos(u.value)
    for k in range(1, u.order + 1):
        s[k] = _convolve(c[:k], slope[1 : k + 1]) / k
        c[k] = -_convolve(s[:k], slope[1 : k + 1]) / k
    return Jet(s), Jet(c)


def sin(u: Jet) -> Jet:
    """Sine of a jet in radians."""
    return sincos(u)[0]


def cos(u: Jet) -> Jet:
    """Cosine of a jet in radians."""
    return sincos(u)[1]


def arctan2(y: Jet, x: Jet) -> Jet:
    """Angle of the point (x, y) [rad], principal value in (-π, π]; the point must not be the origin.

    Its derivative is (x y' - y x') / (x² + y²).
    """
    angle = np.arctan2(y.value, x.value)
    if min(x.order, y.order) == 0:
        return Jet(angle[None])
    # derivative by the quotient, value by the angle itself
    rate = (x * y.differentiate() - y * x.differentiate()) / (x * x + y * y)
    return rate.integrate(angle)


def compose(outer: Jet, inner: Jet) -> Jet:
    """The series of outer(inner(t)) in t; ``outer`` is a series about the value of ``inner``.

    ``outer`` may have leading axes that ``inner`` lacks, as in shapes (order + 1, 2, N) and (order + 1, N).
    """
    order = min(outer.order, inner.order)
    terms, increment = outer.coefficients, _aligned(inner, outer.coefficients.ndim)
    shape = np.broadcast_shapes(terms.shape[1:], increment.shape[1:])
    # Horner's scheme from the highest term that isn't zero; the increment has no constant, so each round adds an order
    highest = next((k for k in range(order, 0, -1) if terms[k].any()), 0)
    result = np.zeros((order + 1, *shape))
    result[0] = terms[highest]
    for k in range(highest - 1, -1, -1):
        # the product with the increment, to the order that is complete after this round
        rows = order + 1 - k
        raised = np.zeros((order + 1, *shape))
        for j in range(1, rows):
            raised[j:rows] += increment[j] * result[: rows - j]
        raised[0] = terms[k]
        result = raised
    return Jet(result)


def revert(series: Jet) -> Jet:
    """The inverse function's series without its constant: from s(u) about u₀ to u - u₀ as a function of s about s₀.

    The first derivative must not be zero. By Lagrange's inversion formula the k-th coefficient is (1/k) times the
    (k-1)-th coefficient of ((u - u₀) / (s - s₀))^k.
    """
    if series.order == 0:
        return Jet(np.zeros_like(series.coefficients))
    # (u - u₀) / (s - s₀) as a series in u, and its powers
    quotient = 1.0 / Jet(series.coefficients[1:])
    inverse = np.zeros_like(series.coefficients)
    term = quotient
    for k in range(1, series.order + 1):
        inverse[k] = term.coefficients[k - 1] / k
        term = term * quotient
    return Jet(inverse)


def stack(jets: tuple[Jet, ...]) -> Jet:
    """One jet of shape (len(jets), ...) from jets of the same shape, cut to their lowest order."""
    order = min(jet.order for jet in jets)
    return Jet(np.stack([jet.coefficients[: order + 1] for jet in jets], axis=1))


def joined(jets: Sequence[Jet]) -> Jet:
    """One jet of shape (N,) from jets of the same order and shapes (N₁,), (N₂,), ..."""
    return Jet(np.concatenate([jet.coefficients for jet in jets], axis=1))


def unstack(pair: Jet) -> tuple[Jet, Jet]:
    """The two jets that `stack` made one of shape (2, ...) from."""
    return Jet(pair.coefficients[:, 0]), Jet(pair.coefficients[:, 1])


def checked_order(order: int) -> int:
    """``order`` if it is a whole number of zero or more; TrajectoryError otherwise."""
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 0:
        raise TrajectoryError(f"the order of a derivative must be a whole number of at least 0, got {order!r}")
    return int(order)


def _convolve(a: RealArray, b: RealArray) -> RealArray | float:
    """Σ a_j b_(n-1-j) over the first axis of two arrays of n rows; 0 where there are no rows."""
    if len(a) == 0:
        return 0.0
    return np.asarray((a * b[::-1]).sum(axis=0))


def _slopes(coefficients: RealArray) -> RealArray:
    """k c_k, shape of the coefficients."""
    return coefficients * _column(np.arange(float(len(coefficients))), coefficients)


def _factorials(coefficients: RealArray) -> RealArray:
    return _column(np.array([float(math.factorial(k)) for k in range(len(coefficients))]), coefficients)


def _column(values: RealArray, like: RealArray) -> RealArray:
    """``values`` along the first axis, shaped to multiply ``like``."""
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def _aligned(jet: Jet, ndim: int) -> RealArray:
    """Coefficients with at least ``ndim`` axes: axes of length 1 behind the first, as points broadcast from the last."""
    # points broadcast from the last axis, as numpy does, and coefficients stay first
    missing = max(0, ndim - jet.coefficients.ndim)
    return jet.coefficients.reshape(len(jet.coefficients), *(1,) * missing, *jet.shape)


def _require(value: RealArray, valid: NDArray[np.bool_], operation: str, requirement: str) -> None:
    """Refuse an operation where a value isn't ``valid`` (NaN never is), naming the first such value."""
    if np.all(valid):
        return
    # the first of the values that are wrong
    index = np.unravel_index(int(np.argmin(valid)), value.shape)
    where = f" at index {', '.join(map(str, index))}" if value.ndim else ""
    raise TrajectoryError(f"{operation} of a jet needs values {requirement}, got {value[index]}{where}")
