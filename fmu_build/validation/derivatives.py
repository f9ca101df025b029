"""Checks of the FMU's derivatives by finite differences.

Each difference quotient is taken with two step sizes and trusted only where both agree; otherwise a kink, a vibration or an
inner iteration disturbs it. Directional derivatives are checked by central differences of second order, output derivatives
by central differences of fourth order along the run (Fornberg, Generation of finite difference formulas on arbitrarily
spaced grids, Mathematics of Computation 51 (1988)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from flexfmu.fmu_build.validation.dependencies import slope
from flexfmu.fmu_build.validation.finding import Finding
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.steps import initialize_perturbed
from flexfmu.fmu_build.validation.variables import size_of

DIFFERENCES = (1e-5, 1e-4)
"""Steps of the difference quotients, relative to a variable's size; rounding and truncation errors are about equal."""

DIRECTIONAL_TOLERANCE = 1e-4
"""Tolerance of directional derivatives, relative to the largest one of the unknown; differences err by about 1e-6."""

SEED_TOLERANCE = 1e-3
"""Tolerance of derivatives along several knowns, relative to the sum of all magnitudes; some FMUs use differences."""

NEGLIGIBLE = 1e-4
"""Change of an unknown, relative to its size, below which difference quotients are rounding errors."""

MOST_POINTS = 60
"""Most communication points at which output derivatives are compared."""

PARTS = (1, 8, 64, 512, 4096)
"""Numbers of parts of a communication step; the finer ones resolve fast vibrations."""

RESOLVED = 0.1
"""Largest relative difference of the quotients over one and two steps for which the step resolves the derivative."""

OUTPUT_TOLERANCE = 0.02
"""Tolerance of output derivatives, relative to the differences."""

SMALL = 1e-9
"""Uncertainty of values due to a solver's absolute tolerance, relative to the variable's size."""

BEGIN = 10
"""Communication steps before the comparison."""

LEAST_POINTS = 8
"""Smallest number of resolved points for a finding."""

STAYS = 0.5
"""Share of a discrepancy that must remain with smaller steps to rule out the solver."""


def directional_derivatives_are_right(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check fmi2GetDirectionalDerivative by central differences with two steps, for each input and state."""
    if not fmu.element.providesDirectionalDerivative:
        return
    with fmu.instance("directional") as instance:
        if fmu.kind is InterfaceType.COSIMULATION:
            instance.enter_initialization()
        else:
            instance.initialize()
            instance.advance(0, 1)
        # the FMU's Jacobian, and differences with two steps
        is_exchange = fmu.kind is InterfaceType.EXCHANGE
        states = fmu.states if is_exchange else []
        rates = [unknown.variable for unknown in fmu.description.derivatives or () if is_exchange]
        unknowns, knowns = [*rates, *fmu.smooth_outputs], [*fmu.inputs, *states]
        if not unknowns or not knowns or instance.finished:
            return
        # differences don't resolve less, whatever the size that is declared
        floor = NEGLIGIBLE * np.maximum([size_of(unknown) for unknown in unknowns], np.abs(instance.get(unknowns)))
        matrix = np.column_stack([instance.directional(unknowns, [known], np.ones(1)) for known in knowns])
        # along all knowns and along every second one, with seeds other than 1
        places = np.arange(len(knowns))
        seeds = (seed := 1.5 + np.cos(places), -0.5 * seed, np.where(places % 2, 0.0, -2.5))
        seeded = [(each, instance.directional(unknowns, knowns, each)) for each in seeds]
        fine, coarse = (
            np.column_stack([slope(instance, unknowns, known, share, states) for known in knowns])
            for share in DIFFERENCES
        )
    # ignore outputs that are aliases of states: some tools omit these derivatives
    same = [[unknown.valueReference == known.valueReference for known in knowns] for unknown in unknowns]
    wrong = list(_compare(unknowns, knowns, floor, np.where(same, fine, matrix), (fine, coarse)))
    yield from wrong or _not_linear(unknowns, knowns, floor, matrix, seeded)


def _not_linear(
    unknowns: Sequence[Any], knowns: Sequence[Any], floor: RealArray, matrix: RealArray, seeded: Sequence[Any]
) -> Iterator[Finding]:
    """Yield a finding if a derivative along several knowns differs from the sum of single ones times their seeds."""
    sizes = np.array([size_of(known) for known in knowns])
    for seed, given in seeded:
        # compare with the product of Jacobian and seed; a negligible derivative may be a rounding error
        expected, scale = matrix @ seed, np.abs(matrix) @ np.abs(seed)
        apart = np.abs(given - expected)
        apart = np.where(np.isfinite(apart), apart, np.inf) / np.maximum(scale, floor * np.abs(seed / sizes).max())
        row = int(np.argmax(apart))
        if apart[row] > SEED_TOLERANCE:
            along = ", ".join(
                f"{known.name} ({value:.3g})" for known, value in islice(zip(knowns, seed, strict=True), 4)
            )
            more = ", ..." * (len(knowns) > 4)
            message = f"the derivative of {unknowns[row].name} along {along}{more} is {given[row]:.6g}, the sum of those along "
            yield Finding(f"{message}each is {expected[row]:.6g}", "multiply by dvKnown and add up")
            return


def _compare(
    unknowns: Sequence[Any], knowns: Sequence[Any], floor: RealArray, matrix: RealArray, slopes: Sequence[RealArray]
) -> Iterator[Finding]:
    """Yield a finding about the worst entry of the Jacobian.

    Errors are relative to the largest entry of the row, scaled by the sizes of the knowns. They are reduced by the
    disagreement of the two differences, which is large at kinks and with inner iterations.

    Args:
        unknowns, knowns: variables of rows and columns.
        floor: change of each unknown that is a rounding error, shape (unknowns,).
        matrix: Jacobian from the FMU, shape (unknowns, knowns).
        slopes: the same by differences with the smaller and the larger step.
    """
    differences, coarse = slopes
    # scaled by the known's size, relative to the largest entry of the row
    sizes = np.array([size_of(known) for known in knowns])
    apart, unsure = np.abs(matrix - differences) * sizes, np.abs(coarse - differences) * sizes
    scale = np.maximum((np.abs(differences) * sizes).max(axis=1, keepdims=True), floor[:, None])
    # subtract the uncertainty of the differences
    apart = np.where(np.isfinite(apart), np.maximum(apart - 2.0 * unsure, 0.0) / scale, np.inf)
    # the worst entry
    row, column = map(int, np.unravel_index(int(np.argmax(apart)), apart.shape))
    if apart[row, column] > DIRECTIONAL_TOLERANCE:
        yield Finding(
            f"d {unknowns[row].name} / d {knowns[column].name} is {matrix[row, column]:.6g}, differences give "
            f"{differences[row, column]:.6g}",
            "correct fmi2GetDirectionalDerivative, or don't claim providesDirectionalDerivative",
        )


def output_derivatives_are_right(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check each order of the output derivatives by differences of the next lower order."""
    most = int(fmu.element.maxOutputDerivativeOrder or 0)
    if not most or not fmu.smooth_outputs:
        return
    references = [variable.valueReference for variable in fmu.smooth_outputs]
    yield from _no_number_at_start(fmu, references, most)

    def jet(instance: Any) -> list[Any]:
        orders = ([order] * len(references) for order in range(1, most + 1))
        given = [instance.library.getRealOutputDerivatives(references, order) for order in orders]
        return [instance.get(fmu.smooth_outputs), *given]

    # all orders along the run
    found = _contradiction(fmu, jet, np.array([size_of(variable) for variable in fmu.smooth_outputs]))
    if found is not None:
        name = fmu.smooth_outputs[found.column].name
        is_number = bool(np.isfinite(found.given))
        against = f", differences give {found.differences:.5g}" if is_number else ""
        remedy = "correct fmi2GetRealOutputDerivatives" if is_number else "return fmi2Error where there is none"
        yield Finding(
            f"derivative {found.order} of {name} is {found.given:.5g} at {found.time:.6g} s{against}",
            f"{remedy}, or claim a lower maxOutputDerivativeOrder",
        )


def _no_number_at_start(fmu: FmuUnderTest, references: list[int], most: int) -> Iterator[Finding]:
    """Yield a finding for each derivative that is not finite right after initialisation; an error status is legal there."""
    with fmu.initialized("first_derivatives") as instance:
        for order in range(1, most + 1):
            try:
                given = instance.library.getRealOutputDerivatives(references, [order] * len(references))
            except FMICallException:
                return
            for variable, value in zip(fmu.smooth_outputs, given, strict=True):
                if not np.isfinite(value):
                    yield Finding(
                        f"derivative {order} of {variable.name} is {value:.5g} right after the initialisation",
                        "return fmi2Error where there is none, or claim a lower maxOutputDerivativeOrder",
                        subject=variable.name,
                    )


def states_follow_their_derivatives(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check, in co-simulation, that each variable changes at the rate of its declared derivative."""
    pairs = [(v.derivative, v) for v in fmu.description.modelVariables if v.derivative is not None and v.type == "Real"]
    if not pairs:
        return
    with suppress(FMICallException):  # the FMU may refuse to return derivatives
        found = _contradiction(
            fmu,
            lambda instance: [instance.get([pair[which] for pair in pairs]) for which in (0, 1)],
            np.array([size_of(state) for state, _ in pairs]),
        )
        # report the first contradiction only
        if found is not None and np.isfinite(found.given):
            state, rate = pairs[found.column]
            yield Finding(
                f"{state.name} changes by {found.differences:.5g} a second at {found.time:.6g} s, its derivative {rate.name} is "
                f"{found.given:.5g}",
                "integrate over the whole step, or correct the derivative",
            )


class _Contradiction(NamedTuple):
    """A derivative that contradicts the differences of the next lower order.

    Its order, the column of the variable, the instant [s], the value from the FMU, and that by differences (NaN if the FMU's isn't
    finite).
    """

    order: int
    column: int
    time: float
    given: float
    differences: float


def _contradiction(fmu: FmuUnderTest, jet: Callable[[Any], list[Any]], size: RealArray) -> _Contradiction | None:
    """The first derivative that contradicts the differences with two successive steps; None if there is none.

    A single step is not enough, since vibrations may alias. The step is refined until the differences resolve the motion.

    Args:
        fmu: the FMU, for co-simulation.
        jet: function that returns an instance's values and derivatives, orders from 0, each of shape (columns,).
        size: order of magnitude of each column.
    """
    suspect = np.zeros(0)  # discrepancies with the coarser step
    for parts in PARTS if fmu.has_variable_step else PARTS[:1]:
        step = fmu.step / parts
        jets = _jets(fmu, jet, parts)
        if len(jets) < LEAST_POINTS + 4:
            return None
        if not np.isfinite(jets).all():
            point, order, column = map(int, np.argwhere(~np.isfinite(jets))[0])
            time = fmu.start + _begin(fmu) * fmu.step + (point + 1) * step
            return _Contradiction(order, column, time, jets[point, order, column], np.nan)
        given, differences, clear = _comparison(jets, step, fmu.accuracy, size)
        lag = 0.0
        if not fmu.has_variable_step:
            # a first-order method uses the derivative at the step's beginning; allow for this lag
            lag = 0.5 * np.abs(given[2:] - given[:-2]).max(axis=0) / np.abs(differences).max(axis=0).clip(1e-300)
            # exclude aliased vibrations: derivatives much larger than the differences
            clear = clear & (np.abs(given).max(axis=0) <= 3.0 * np.abs(differences).max(axis=0))
        by = _discrepancy(given, differences, clear, lag)
        if not fmu.has_variable_step:
            suspect = by
        # a discrepancy that shrinks with the step is due to the solver
        if suspect.size and (stays := (by > 0.0) & (suspect > 0.0) & (by >= STAYS * suspect)).any():
            order, column = map(int, np.argwhere(stays)[0])
            n = int(np.argmax(np.where(clear, np.abs(differences), -1.0)[:, order, column]))
            time = fmu.start + _begin(fmu) * fmu.step + (n + 3) * step
            return _Contradiction(order + 1, column, time, given[n, order, column], differences[n, order, column])
        suspect = by
    return None


def _comparison(
    jets: RealArray, step: float, accuracy: float, size: RealArray
) -> tuple[RealArray, RealArray, NDArray[np.bool_]]:
    """Derivatives from the FMU, differences of fourth order, and a mask of the entries that the differences resolve.

    All have the shape (points - 4, orders, columns).

    Args:
        jets: values and derivatives, shape (points, orders + 1, columns).
        step: distance of the points [s].
        accuracy: relative accuracy of the values.
        size: order of magnitude of each column, shape (columns,).
    """
    lower, given = jets[:, :-1], jets[2:-2, 1:]
    near = (lower[3:-1] - lower[1:-3]) / (2.0 * step)
    wide = (lower[4:] - lower[:-4]) / (4.0 * step)
    differences = (4.0 * near - wide) / 3.0
    # a motion with derivatives that are all 0 is no solver's error, however small beside the values
    unsure = np.where((given == 0.0).all(axis=0), SMALL, accuracy)
    noise = (unsure * np.abs(lower).max(axis=0) + SMALL * size) / step
    scale = np.maximum(np.abs(differences), np.abs(differences).max(axis=0) * 1e-2)
    # an FMU with a larger internal step is constant at times
    moves = (np.diff(lower, axis=0) != 0.0).mean(axis=0) > 0.9
    return given, differences, moves & (np.abs(near - wide) <= RESOLVED * scale) & (noise <= RESOLVED * scale)


def _discrepancy(given: RealArray, differences: RealArray, clear: NDArray[np.bool_], slack: Any) -> RealArray:
    """Relative error of derivatives, by factor or mean, shape (orders, columns); 0 where not significant.

    Noise from a solver's tolerance in higher derivatives hardly affects factor and mean.

    Args:
        given: derivatives from the FMU, shape (points, orders, columns).
        differences: derivatives by differences, same shape.
        clear: mask of the entries to compare, same shape.
        slack: tolerance in addition to `OUTPUT_TOLERANCE`, shape (orders, columns) or a number.
    """
    # use the resolved entries only, if there are enough
    count = clear.sum(axis=0)
    enough = (count >= LEAST_POINTS) & (clear.mean(axis=0) >= 0.5)
    given, differences = (np.where(clear, each, 0.0) for each in (given, differences))
    # factor between them by least squares, with three standard errors
    power = (differences**2).sum(axis=0).clip(1e-300)
    largest = np.abs(differences).max(axis=0).clip(1e-150)
    factor = (given * differences).sum(axis=0) / power
    chance = 3.0 / np.sqrt(count.clip(1))
    rest = np.sqrt(((given - factor * differences) ** 2).sum(axis=0) / power)
    # mean error, with three standard errors
    mean = (given - differences).sum(axis=0) / count.clip(1) / largest
    spread = np.sqrt(((given - differences) ** 2).sum(axis=0) / count.clip(1)) / largest
    # errors beyond tolerance and three standard errors
    wrong = np.where(np.abs(factor - 1.0) > OUTPUT_TOLERANCE + slack + chance * rest, np.abs(factor - 1.0), 0.0)
    shifted = np.where(np.abs(mean) > 2.0 * OUTPUT_TOLERANCE + slack + chance * spread, np.abs(mean), 0.0)
    return np.where(enough, np.maximum(wrong, shifted), 0.0)


def _begin(fmu: FmuUnderTest) -> int:
    """Number of communication steps before the first point; right after a start from rest derivatives are small."""
    return min(BEGIN, fmu.steps // 4)


def _jets(fmu: FmuUnderTest, jet: Callable[[Any], list[Any]], parts: int) -> RealArray:
    """Values and derivatives after each step of a perturbed run, shape (points, orders + 1, columns).

    Inputs are constant, so that no output jumps. Steps have 1/``parts`` of a communication step.
    """
    jets: list[list[Any]] = []
    begin = _begin(fmu)
    # perturbed start, then short steps
    with fmu.instance("derivatives") as instance:
        initialize_perturbed(instance)
        if not all(instance.step(n) for n in range(begin)):
            return np.array(jets)
        # no further than the stop time
        within = (fmu.all_steps - begin) * parts if fmu.has_variable_step else fmu.steps - begin
        for n in range(min(within, MOST_POINTS)):
            if not instance.step(begin + n / parts, parts):
                break
            jets.append(jet(instance))
    return np.array(jets)
