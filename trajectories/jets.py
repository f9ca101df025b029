"""Jets: truncated Taylor series in one variable, for exact derivatives of any order.

A jet consists of the normalised Taylor coefficients c_k = f^(k)/k! of a function, at many points at once. Every operation is a
recurrence for the coefficients of its result, at a cost of O(order²) (composition and reversion O(order³)). Derivatives of a
formula are as exact as its value, without finite differences or symbolic expressions.

Source of the recurrences: A. Griewank, A. Walther, *Evaluating Derivatives*, 2nd edition, SIAM 2008, section 13.2,
tables 13.1 (arithmetic, roots and powers) and 13.2 (sine and cosine).
"""

from __future__ import annotations

import math
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

    The operators ``+ - * /`` take jets, numbers and arrays; numbers and arrays are constants. The result has the lower order of
    the two operands.

    Attributes:
        coefficients: normalised Taylor coefficients f^(k)/k!, shape (order + 1, ...), the k-th in the function's unit divided
            by the k-th power of the variable's unit.

    Raises:
        TrajectoryError: there is no coefficient, or a jet is divided by zero.
    """

    coefficients: RealArray

    # makes numpy delegate `array * jet` to `Jet.__rmul__`
    __array_ufunc__ = None

    def __post_init__(self) -> None:
        if np.ndim(self.coefficients) == 0 or len(self.coefficients) == 0:
            raise TrajectoryError("a jet needs at least one coefficient along its first axis, got none")

    @classmethod
    def constant(cls, value: ArrayLike, order: int) -> Jet:
        """Return the series of a constant ``value`` of any shape."""
        value = np.asarray(value, dtype=float)
        coefficients = np.zeros((checked_order(order) + 1, *value.shape))
        coefficients[0] = value
        return cls(coefficients)

    @classmethod
    def variable(cls, value: ArrayLike, order: int) -> Jet:
        """Return the series of the variable itself at ``value`` of any shape: value, 1, 0, 0, ..."""
        jet = cls.constant(value, order)
        jet.coefficients[1:2] = 1.0
        return jet

    @classmethod
    def from_derivatives(cls, derivatives: ArrayLike) -> Jet:
        """Return the series of a function from its value and derivatives f^(k), shape (order + 1, ...)."""
        derivatives = np.asarray(derivatives, dtype=float)
        return cls(derivatives / _factorials(derivatives))

    def derivatives(self) -> RealArray:
        """Return value and derivatives f^(k), shape (order + 1, ...)."""
        return self.coefficients * _factorials(self.coefficients)

    @property
    def order(self) -> int:
        """Order of the highest derivative."""
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
        """Return the series of the derivative, one order lower; raise TrajectoryError for a jet of order 0."""
        if self.order == 0:
            raise TrajectoryError("a jet of order 0 has no derivative; ask for order 1 or more")
        return Jet(self.coefficients[1:] * _column(np.arange(1.0, self.order + 1), self.coefficients))

    def integrate(self, value: ArrayLike = 0.0) -> Jet:
        """Return the series of the antiderivative that is ``value`` at the point, one order higher."""
        # each coefficient moves up by one order and is divided by it
        first = np.broadcast_to(np.asarray(value, dtype=float), self.shape)
        rest = self.coefficients / _column(np.arange(1.0, self.order + 2), self.coefficients)
        return Jet(np.concatenate([first[None], rest]))

    def rescale(self, factor: float) -> Jet:
        """Return the series of f(factor · x) in x: the old variable is ``factor`` times the new one."""
        return Jet(self.coefficients * _column(factor ** np.arange(self.order + 1.0), self.coefficients))

    def __neg__(self) -> Jet:
        return Jet(-self.coefficients)

    def __add__(self, other: Jet | ArrayLike) -> Jet:
        if isinstance(other, Jet):
            order = min(self.order, other.order)
            a, b = _aligned(self, other.coefficients.ndim), _aligned(other, self.coefficients.ndim)
            return Jet(a[: order + 1] + b[: order + 1])
        # a constant changes only the value
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
            rest = v[k:]
            rest += a[k] * b[: order + 1 - k]
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
    """Return the square root of a jet with values above zero, at order 0 also zero; TrajectoryError for others."""
    # the root has no derivative at zero
    lowest = u.value if u.order == 0 else np.where(u.value > 0.0, u.value, -1.0)
    _require(u.value, lowest >= 0.0, "square root", "above zero")
    v = np.empty_like(u.coefficients)
    # v² = u solved for the coefficients of v in ascending order
    v[0] = np.sqrt(u.value)
    for k in range(1, u.order + 1):
        v[k] = (u.coefficients[k] - _convolve(v[1:k], v[1:k])) / (2.0 * v[0])
    return Jet(v)


def power(u: Jet, exponent: float) -> Jet:
    """Return a real power of a jet with values above zero; TrajectoryError for others."""
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
    """Return sine and cosine of a jet in radians; one recurrence yields both."""
    slope = _slopes(u.coefficients)
    s, c = np.empty_like(slope), np.empty_like(slope)
    # s' = c u' and c' = -s u', solved for the coefficients in ascending order
    s[0], c[0] = np.sin(u.value), np.cos(u.value)
    for k in range(1, u.order + 1):
        s[k] = _convolve(c[:k], slope[1 : k + 1]) / k
        c[k] = -_convolve(s[:k], slope[1 : k + 1]) / k
    return Jet(s), Jet(c)


def arctan2(y: Jet, x: Jet) -> Jet:
    """Return the angle of the point (x, y) [rad], in [-π, π]; TrajectoryError at the origin for orders above 0.

    Its derivative is (x y' - y x') / (x² + y²).
    """
    angle = np.arctan2(y.value, x.value)
    if min(x.order, y.order) == 0:
        return Jet(angle[None])
    # integrate the derivative from the angle
    rate = (x * y.differentiate() - y * x.differentiate()) / (x * x + y * y)
    return rate.integrate(angle)


def compose(outer: Jet, inner: Jet) -> Jet:
    """Return the series of outer(inner(t)) in t; ``outer`` is a series about the value of ``inner``.

    ``outer`` may have more axes than ``inner``, for example coefficients (order + 1, 2, N) and (order + 1, N).
    """
    order = min(outer.order, inner.order)
    terms, increment = outer.coefficients, _aligned(inner, outer.coefficients.ndim)
    shape = np.broadcast_shapes(terms.shape[1:], increment.shape[1:])
    # Horner's scheme from the highest nonzero term; the increment has no constant term, so that each round adds one order
    highest = next((k for k in range(order, 0, -1) if terms[k].any()), 0)
    result = np.zeros((order + 1, *shape))
    result[0] = terms[highest]
    for k in range(highest - 1, -1, -1):
        # multiply by the increment, up to the order reached in this round
        rows = order + 1 - k
        raised = np.zeros((order + 1, *shape))
        for j in range(1, rows):
            raised[j:rows] += increment[j] * result[: rows - j]
        raised[0] = terms[k]
        result = raised
    return Jet(result)


def revert(series: Jet) -> Jet:
    """Return the series of the inverse function without its constant: u - u₀ in s - s₀, from s in u - u₀.

    By Lagrange's inversion formula its k-th coefficient is 1/k times the (k-1)-th coefficient of ((u - u₀) / (s - s₀))^k. A first
    derivative of zero is a TrajectoryError.
    """
    if series.order == 0:
        return Jet(np.zeros_like(series.coefficients))
    # (u - u₀) / (s - s₀) as a series in u, and its powers
    quotient = 1.0 / Jet(series.coefficients[1:])
    inverse = np.zeros_like(series.coefficients)
    term = quotient
    for k in range(1, series.order + 1):
        inverse[k] = term.coefficients[k - 1] / k
        if k < series.order:
            term = term * quotient
    return Jet(inverse)


def stack(jets: tuple[Jet, ...]) -> Jet:
    """Stack jets of the same shape (...) to one jet of shape (len(jets), ...), truncated to their lowest order."""
    order = min(jet.order for jet in jets)
    return Jet(np.stack([jet.coefficients[: order + 1] for jet in jets], axis=1))


def unstack(pair: Jet) -> tuple[Jet, Jet]:
    """Split a jet of shape (2, ...) into two jets of shape (...); the inverse of `stack`."""
    return Jet(pair.coefficients[:, 0]), Jet(pair.coefficients[:, 1])


def checked_order(order: int) -> int:
    """Return ``order``; raise TrajectoryError unless it is an integer of at least 0."""
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 0:
        raise TrajectoryError(f"the order of a derivative must be a whole number of at least 0, got {order!r}")
    return int(order)


def _convolve(a: RealArray, b: RealArray) -> RealArray | float:
    """Return Σ a_j b_(n-1-j) over the first axis of two arrays with n rows; 0 for n = 0."""
    if len(a) == 0:
        return 0.0
    return np.asarray((a * b[::-1]).sum(axis=0))


def _slopes(coefficients: RealArray) -> RealArray:
    """Return k c_k in the shape of the coefficients."""
    return coefficients * _column(np.arange(float(len(coefficients))), coefficients)


def _factorials(coefficients: RealArray) -> RealArray:
    return _column(np.array([float(math.factorial(k)) for k in range(len(coefficients))]), coefficients)


def _column(values: RealArray, like: RealArray) -> RealArray:
    """Return ``values`` (n,) with trailing axes of length 1, so that they broadcast with ``like`` (n, ...)."""
    return values.reshape(-1, *(1,) * (like.ndim - 1))


def _aligned(jet: Jet, ndim: int) -> RealArray:
    """Return the coefficients with at least ``ndim`` axes; axes of length 1 are inserted after the first."""
    # the axes of points broadcast from the last one, as in numpy; the axis of coefficients stays the first
    missing = max(0, ndim - jet.coefficients.ndim)
    return jet.coefficients.reshape(len(jet.coefficients), *(1,) * missing, *jet.shape)


def _require(value: RealArray, valid: NDArray[np.bool_], operation: str, requirement: str) -> None:
    """Raise TrajectoryError unless all values are ``valid`` (NaN never is); the message has the first invalid one."""
    if np.all(valid):
        return
    # the first invalid value
    index = np.unravel_index(int(np.argmin(valid)), value.shape)
    where = f" at index {', '.join(map(str, index))}" if value.ndim else ""
    raise TrajectoryError(f"{operation} of a jet needs values {requirement}, got {value[index]}{where}")
