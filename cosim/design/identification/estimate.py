"""Least squares with coloured noise: values, standard errors, intervals, and what can't be told apart.

The unknowns are parameters of the model and of the sensors: a delay for each kind of signal in a log, an offset for each signal in a log, and a
gain for each signal. Residuals are whitened by autoregressive models that are fitted to them in turn (feasible generalised least squares,
W. Greene, *Econometric Analysis*, 2012, section 20.9), so that maximum likelihood is a plain least-squares problem for SciPy. Derivatives
with respect to the model's parameters are central differences of runs that are simulated side by side; those with respect to delays,
offsets and gains are exact.

Standard errors are the larger of those that follow from the model of the noise and those that hold whatever the correlation of the
remaining residuals, also between signals (W. Newey, K. West, Econometrica 55, 1987). Where the sum of squares isn't quadratic, the interval is
that of the profile likelihood (D. Bates, D. Watts, *Nonlinear Regression Analysis*, 1988, chapter 6).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf, sqrt
from typing import Literal

import numpy as np

from flexfmu.cosim.design.identification.measurements import Channel, Experiment
from flexfmu.cosim.design.identification.noise import ColouredNoise, fitted_noise
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray

STEP = 3e-3
"""Step of the differences, relative to a parameter's size."""

ROUNDS, SETTLED = 8, 0.05
"""Most fits with renewed models of the noise, and change of a parameter in terms of its standard error that ends them."""

NEAR = 0.01
"""Distance from the minimum that ends a fit, in terms of standard errors, roughly."""

EXACT = 1e-9
"""Noise of a signal, relative to its range, that counts as none."""

CURVED = 0.1
"""Deviation of the sum of squares from a parabola at the ends of an interval, from which on the interval is profiled."""

PROFILE_STEPS = 5
"""Most steps of a profile to one side."""

UNKNOWN = 1.0
"""Standard error relative to a parameter's size from which on the data don't determine it."""

SHARED = 0.3
"""Part of a direction that counts among what can't be told apart."""

OUTLIER = 6.0
"""Residual in terms of their median from which on it is an outlier for a robust loss: 4 standard deviations."""

DRAWN = 20
"""Draws of the noise of what drives simulations."""

CERTAIN = 10**9
"""Degrees of freedom where the errors are known."""

BLOCKS = 8
"""Parts of the logs of which each is left out once."""

NUISANCES = ("delay", "offset", "gain")
"""What may be unknown of sensors."""


@dataclass(frozen=True)
class FreeParameter:
    """An unknown: a parameter to be estimated, or a delay, an offset or a gain of sensors.

    Attributes:
        name: of the FMU's parameter, or what it is of which sensor.
        unit: in SI.
        start: first value.
        low, high: bounds.
        prior: mean and standard deviation of what is known beforehand; None for nothing.
        drawn: between which other first values are drawn.
        experiment: number of the one that it belongs to alone, as where the robot stands first; None for a parameter of the model.
        scale: what counts as a large change; 0 for what follows from first value and bounds.
    """

    name: str
    unit: str
    start: float
    low: float = -inf
    high: float = inf
    prior: tuple[float, float] | None = None
    drawn: tuple[float, float] = (0.0, 0.0)
    experiment: int | None = None
    scale: float = 0.0

    @property
    def size(self) -> float:
        """What counts as a large change."""
        if self.scale or self.start:
            return self.scale or abs(self.start)
        return self.high - self.low if self.high - self.low < inf else 1.0


@dataclass(frozen=True, eq=False)
class ResidualRow:
    """A signal of an experiment in the vector of residuals: samples that the simulation covers, and places of its nuisances among the
    unknowns, None for none."""

    experiment: int
    channel: Channel
    delay: int | None
    offset: int | None
    gain: int | None


@dataclass(frozen=True, eq=False)
class Solution:
    """A fit.

    Attributes:
        unknowns: values of all unknowns (n,).
        residuals: measured minus simulated values of each signal.
        simulated: simulated values of each signal, as the sensor shows them.
        noises: models of the noise.
        white: whitened residuals of all signals, then of priors (N,).
        jacobian: derivatives of the negative whitened residuals (N, n).
        covariance: of the unknowns (n, n).
        freedom: degrees of freedom.
    """

    unknowns: RealArray
    residuals: tuple[RealArray, ...] = field(repr=False)
    simulated: tuple[RealArray, ...] = field(repr=False)
    noises: tuple[ColouredNoise, ...] = field(repr=False)
    white: RealArray = field(repr=False)
    jacobian: RealArray = field(repr=False)
    covariance: RealArray = field(repr=False)
    freedom: int

    @property
    def cost(self) -> float:
        """Sum of the squared whitened residuals."""
        return float(self.white @ self.white)


class Problem:
    """Unknowns, measurements and simulations of an identification.

    Args:
        experiments: at least one.
        free: the model's parameters, then those of single experiments.
        nuisances: what is unknown of sensors, of `NUISANCES`.
        delays: first delay of each experiment's signals [s].
        loss: ``linear``, or one of SciPy's robust losses.
        show: called with the number of runs so far.
    """

    def __init__(
        self,
        experiments: Sequence[Experiment],
        free: Sequence[FreeParameter],
        nuisances: Collection[str],
        delays: Sequence[float],
        loss: Literal["linear", "soft_l1"] = "linear",
        show: Callable[[int], None] = lambda runs: None,
    ) -> None:
        self.experiments, self.free, self._loss, self._show = tuple(experiments), tuple(free), loss, show
        self.runs = 0
        rows, sensors = list[ResidualRow](), dict[str, FreeParameter]()

        def place(unknown: Collection[str], of: str, unit: str, start: float, size: float, low: float) -> int | None:
            if of.partition(" ")[0] not in unknown:
                return None
            sensors.setdefault(of, FreeParameter(of, unit, start, low, scale=size))
            return len(self.free) + [*sensors].index(of)

        for number, each in enumerate(self.experiments):
            for channel in each.channels:
                unknown = () if each.is_table else {*nuisances} - ({"offset"} if channel.part is not None else set())
                covered = (
                    channel
                    if each.is_table or channel.part is not None
                    else _covered(channel, delays[number], each.stop_time)
                )
                delay = f"delay of {channel.kind}s of {each.name}", "s", delays[number], channel.step, -inf
                spread = float(np.std(channel.values)) or 1.0
                offset = f"offset of {channel.name} of {each.name}", channel.unit, 0.0, spread, -inf
                gain = f"gain of {channel.sensor}", "1", 1.0, 1.0, 0.0
                rows.append(ResidualRow(number, covered, *(place(unknown, *what) for what in (delay, offset, gain))))
        self.rows, self._delays = tuple(rows), tuple(delays)
        self.shared = sum(each.experiment is None for each in self.free)
        self.unknowns = (*self.free, *sensors.values())
        given = self.samples + sum(each.prior is not None for each in self.free)
        if given < (count := len(self.unknowns)) + (not self.is_certain):
            raise InputError(
                f"{given} values can't tell {count} unknowns{'' if self.is_certain else ' and how accurate they are'}: give more, fewer "
                "--free and --sensors, or standard errors of modes"
            )
        self.start, self.sizes = (np.array([getattr(each, key) for each in self.unknowns]) for key in ("start", "size"))
        self._low, self._high = (np.array([getattr(each, key) for each in self.unknowns]) for key in ("low", "high"))
        self._is_together = any(each.is_together for each in self.experiments)
        self._base: tuple[RealArray, list[Recording]] | None = None
        self._varied: tuple[RealArray, tuple[list[Recording], list[list[Recording]], list[float]]] | None = None

    @property
    def labels(self) -> list[str]:
        """Names of all unknowns, with the log of those that belong to one."""
        return [
            f"{p.name} of {self.experiments[p.experiment].name}" if p.experiment is not None else p.name
            for p in self.unknowns
        ]

    @property
    def samples(self) -> int:
        """Number of compared values."""
        return sum(row.channel.time.size for row in self.rows)

    @property
    def parts(self) -> list[slice]:
        """Places of each row's samples among all."""
        ends = np.cumsum([row.channel.time.size for row in self.rows]).tolist()
        return [slice(begin, end) for begin, end in pairwise([0, *ends])]

    @property
    def is_certain(self) -> bool:
        """Whether errors of all values are known, so that residuals needn't tell them."""
        return all(row.channel.least > 0.0 for row in self.rows)

    @property
    def least_variance(self) -> float:
        """Smallest variance of whitened residuals that counts."""
        return 1.0 if self.is_certain else 1e-300

    def recordings(self, points: Sequence[RealArray]) -> list[list[Recording]]:
        """Recordings of all experiments at values of the model's parameters, one list for each of the points."""
        self.runs += len(points) * len(self.experiments)
        self._show(self.runs)
        columns = [
            each.simulate([self.variant(point, number) for point in points])
            for number, each in enumerate(self.experiments)
        ]
        return [list(each) for each in zip(*columns, strict=True)]

    def variant(self, unknowns: RealArray, experiment: int) -> dict[str, float]:
        """Name of a parameter of an experiment → value."""
        pairs = zip(self.free, unknowns.tolist(), strict=False)
        return {each.name: value for each, value in pairs if each.experiment in (None, experiment)}

    def at(self, unknowns: RealArray) -> list[Recording]:
        """Recordings of all experiments; those of the last values are kept, with those around them where these cost hardly more."""
        own = unknowns[: len(self.free)]
        if self._is_together:
            return self._around(own)[0]
        if self._base is None or not np.array_equal(self._base[0], own):
            self._base = own.copy(), self.recordings([own])[0]
        return self._base[1]

    def simulated(
        self, row: ResidualRow, recording: Recording, unknowns: RealArray
    ) -> tuple[RealArray, RealArray, RealArray]:
        """What the sensor of a row shows, the signal without offset and gain, and its time derivative, (M,) each."""
        delay = self._delays[row.experiment] if row.delay is None else float(unknowns[row.delay])
        signal, slope = row.channel.simulated(recording, delay)
        gain = 1.0 if row.gain is None else unknowns[row.gain]
        offset = 0.0 if row.offset is None else unknowns[row.offset]
        return gain * signal + offset, signal, gain * slope

    def residuals(self, unknowns: RealArray, recordings: Sequence[Recording]) -> list[RealArray]:
        """Measured minus simulated values of each row."""
        return [row.channel.values - self.simulated(row, recordings[row.experiment], unknowns)[0] for row in self.rows]

    def whitened(self, parts: Sequence[RealArray], noises: Sequence[ColouredNoise]) -> RealArray:
        """Whiten and join values of all rows."""
        pairs = zip(parts, self.rows, noises, strict=True)
        return np.concatenate([noise.whitened(part, row.channel.pieces) for part, row, noise in pairs])

    def white(self, unknowns: RealArray, residuals: Sequence[RealArray], noises: Sequence[ColouredNoise]) -> RealArray:
        """Whitened residuals of all rows, then of priors."""
        return np.concatenate([self.whitened(residuals, noises), self.priors(unknowns)[0]])

    def derivatives(self, unknowns: RealArray) -> list[RealArray]:
        """Derivatives of what each row's sensor shows by all unknowns (M, n)."""
        (base, varied, widths), found = self._around(unknowns[: len(self.free)]), list[RealArray]()
        for row in self.rows:
            _, signal, slope = self.simulated(row, base[row.experiment], unknowns)
            columns = np.zeros((signal.size, unknowns.size))
            for j, width in enumerate(widths):
                up, down = (
                    self.simulated(row, each[row.experiment], unknowns)[0] for each in varied[2 * j : 2 * j + 2]
                )
                columns[:, j] = (up - down) / width
            for place, values in ((row.delay, -slope), (row.offset, 1.0), (row.gain, signal)):
                if place is not None:
                    columns[:, place] = values
            found.append(columns)
        return found

    def _around(self, own: RealArray) -> tuple[list[Recording], list[list[Recording]], list[float]]:
        """Recordings at values of the model's parameters, with each a little larger, then smaller, and the distances of both."""
        base = None if self._is_together else self.at(own)
        if self._varied is None or not np.array_equal(self._varied[0], own):
            points, widths = [own] if base is None else [], list[float]()
            for j, value in enumerate(own.tolist()):
                step = STEP * max(float(self.sizes[j]), abs(value))
                pair = [own.copy(), own.copy()]
                pair[0][j], pair[1][j] = min(value + step, self._high[j]), max(value - step, self._low[j])
                widths.append(float(pair[0][j] - pair[1][j]))
                points += pair
            found = self.recordings(points)
            if base is None:
                base, *found = found
            self._varied = own.copy(), (base, found, widths)
        return self._varied[1]

    def priors(self, unknowns: RealArray) -> tuple[RealArray, RealArray]:
        """Residuals of what is known beforehand (k,), and their derivatives by the unknowns (k, n), negative as all others."""
        given = [(j, *each.prior) for j, each in enumerate(self.free) if each.prior is not None]
        rows = np.zeros((len(given), unknowns.size))
        for i, (j, _, deviation) in enumerate(given):
            rows[i, j] = 1.0 / deviation
        return np.array([(mean - unknowns[j]) / deviation for j, mean, deviation in given]), rows

    def fit(self, start: RealArray, noises: Sequence[ColouredNoise]) -> Solution:
        """Minimise the whitened residuals for given models of the noise."""
        from scipy.optimize import least_squares

        last: list[tuple[RealArray, RealArray]] = []

        def function(unknowns: RealArray) -> RealArray:
            return self.white(unknowns, self.residuals(unknowns, self.at(unknowns)), noises)

        def jacobian(unknowns: RealArray) -> RealArray:
            found = np.concatenate([self.whitened(self.derivatives(unknowns), noises), self.priors(unknowns)[1]])
            last[:] = [(unknowns.copy(), found)]
            return -found

        found = least_squares(
            function,
            np.clip(start, self._low, self._high),
            jacobian,
            bounds=(self._low, self._high),
            x_scale=self.sizes,
            loss=self._loss,
            ftol=max(1e-7, NEAR**2 / self.samples),
            xtol=1e-7,
            gtol=1e-9,
            max_nfev=40,
        )
        matrix = last[0][1] if last and np.array_equal(last[0][0], found.x) else -jacobian(found.x)
        return self._solution(found.x, matrix, noises)

    def _solution(self, unknowns: RealArray, jacobian: RealArray, noises: Sequence[ColouredNoise]) -> Solution:
        recordings = self.at(unknowns)
        shown = tuple(self.simulated(row, recordings[row.experiment], unknowns)[0] for row in self.rows)
        residuals = tuple(row.channel.values - each for row, each in zip(self.rows, shown, strict=True))
        white = self.white(unknowns, residuals, noises)
        if self._loss != "linear":
            # the weights that the loss gives
            weights = (1.0 + white**2) ** -0.25
            white, jacobian = white * weights, jacobian * weights[:, None]
        freedom = max(self.samples - unknowns.size - sum(each.order for each in noises), 1)
        if self.is_certain:
            freedom = CERTAIN
        covariance = self._covariance(white, jacobian, freedom)
        return Solution(unknowns, residuals, shown, tuple(noises), white, jacobian, covariance, freedom)

    def _covariance(self, white: RealArray, jacobian: RealArray, freedom: int) -> RealArray:
        """Covariance of the unknowns: correlations of the noise's model, standard errors the larger of two."""
        scaled = jacobian * self.sizes
        inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
        own = max(float(white @ white) / freedom, self.least_variance) * inverse
        # whatever the residuals are correlated with: sums over all signals of an experiment at one instant
        total, scores = np.zeros_like(inverse), dict[tuple[int, int], RealArray]()
        for row, place in zip(self.rows, self.parts, strict=True):
            key = row.experiment, row.channel.time.size
            scores[key] = scores.get(key, 0.0) + scaled[place] * white[place, None]
        for part in scores.values():
            lags = round(part.shape[0] ** 0.5)
            total += part.T @ part
            for lag in range(1, lags + 1):
                product = (1.0 - lag / (lags + 1.0)) * (part[lag:].T @ part[:-lag])
                total += product + product.T
        # what is known beforehand doesn't scatter
        given = scaled[self.samples :]
        total += given.T @ given
        robust = inverse @ total @ inverse * (self.samples / freedom)
        variances = np.maximum(np.diag(own), 1e-300)
        factors = np.sqrt(np.maximum(np.diag(robust) / variances, 1.0)) * self.sizes
        return own * np.outer(factors, factors)

    def jackknife(self, found: Solution) -> RealArray:
        """Standard errors of all unknowns from fits without one of `BLOCKS` parts of the logs each, to first order.

        They contain what a wrong model does to the estimates, as far as that differs from part to part (B. Efron, *The Jackknife, the
        Bootstrap and Other Resampling Plans*, 1982, chapter 3).
        """
        scaled = found.jacobian * self.sizes
        block = np.full(found.white.size, -1)  # what is known beforehand is in all
        for row, place in zip(self.rows, self.parts, strict=True):
            block[place] = np.arange(row.channel.time.size) * BLOCKS // row.channel.time.size
        whole, shifts = scaled.T @ scaled, list[RealArray]()
        for number in range(BLOCKS):
            part = scaled[block == number]
            rest = np.linalg.pinv(whole - part.T @ part, hermitian=True)
            shifts.append(rest @ (part.T @ found.white[block == number]))
        return np.asarray(np.sqrt((BLOCKS - 1.0) * np.mean(np.square(shifts), axis=0)) * self.sizes)

    def driven(self, found: Solution, seed: int = 0) -> RealArray:
        """Covariance of all unknowns (n, n) from the noise of what drives the simulations, which it moves along with: draws, to first order."""
        scaled, total = found.jacobian * self.sizes, np.zeros((found.unknowns.size,) * 2)
        inverse = np.linalg.pinv(scaled, rcond=1e-10)
        for number, each in enumerate(self.experiments):
            if each.drive is None or not each.drive.noise.any():
                continue
            variant, recordings, rng = (
                self.variant(found.unknowns, number),
                [*self.at(found.unknowns)],
                np.random.default_rng(seed),
            )
            try:
                for _ in range(DRAWN):
                    each.drive.disturb(rng)
                    recordings[number] = each.simulate([variant])[0]
                    self.runs += 1
                    self._show(self.runs)
                    shown = [self.simulated(row, recordings[row.experiment], found.unknowns)[0] for row in self.rows]
                    parts = [a - b for a, b in zip(shown, found.simulated, strict=True)]
                    shift = self.sizes * (inverse[:, : self.samples] @ self.whitened(parts, found.noises))
                    total += np.outer(shift, shift) / DRAWN
            finally:
                each.drive.disturb(None)
        return total

    def first_noises(self, unknowns: RealArray) -> list[ColouredNoise]:
        """White noise of a tenth of each signal's own deviation, in place of what isn't known yet."""
        none = (np.zeros(0),)
        found = []
        for channel in (row.channel for row in self.rows):
            size = float(np.std(channel.values if channel.errors is None else channel.values / channel.errors))
            found.append(ColouredNoise(none, np.array([0.1 * size or 1.0]), channel.step, channel.errors))
        return found

    def noises(self, solution: Solution) -> list[ColouredNoise]:
        """Models of the noise from the residuals of a fit."""
        taken = solution.residuals
        if self._loss != "linear":
            # outliers aren't noise
            sizes = [OUTLIER * float(np.median(np.abs(each))) for each in taken]
            taken = tuple(np.clip(each, -size, size) for each, size in zip(taken, sizes, strict=True))
        found = list[ColouredNoise]()
        for row, each, fitted in zip(self.rows, taken, self._fitted(solution), strict=True):
            channel = row.channel
            # what is left after the fit is smaller than the noise, which counts where there are few values
            each = each / sqrt(max(1.0 - fitted / each.size, 1.0 / each.size))
            least = (
                EXACT * (float(np.ptp(channel.values)) or 1.0) if channel.errors is None else max(EXACT, channel.least)
            )
            found.append(fitted_noise(each, channel.pieces, channel.step, least, errors=channel.errors))
        return found

    def _fitted(self, found: Solution) -> list[float]:
        """Degrees of freedom that the fit has taken from each row's residuals."""
        basis, sizes, _ = np.linalg.svd(found.jacobian * self.sizes, full_matrices=False)
        leverage = (basis[:, sizes > 1e-10 * sizes[0]] ** 2).sum(axis=1)
        return [float(leverage[each].sum()) for each in self.parts]

    def _freedom(self, found: Solution) -> float:
        """Degrees of freedom of the estimates' variance, of which each row's noise has its share (F. Satterthwaite, Biometrics Bulletin 2, 1946)."""
        if self.is_certain:
            return CERTAIN
        fitted, total = self._fitted(found), 0.0
        for row, each, noise in zip(self.rows, fitted, found.noises, strict=True):
            total += (each / sum(fitted)) ** 2 / max(row.channel.time.size - each - noise.order, 1.0)
        return min(1.0 / total, float(found.freedom))

    def solve(self, start: RealArray | None = None) -> Solution:
        """Fit, model the noise, and fit again until both agree."""
        first = self.start if start is None else start
        found = self.fit(first, self.first_noises(first))
        for _ in range(ROUNDS):
            before = found.unknowns
            found = self.fit(before, self.noises(found))
            errors = np.sqrt(np.diag(found.covariance))
            if np.all(np.abs(found.unknowns - before) <= SETTLED * errors + 1e-12 * self.sizes):
                break
        return found

    def costs(self, points: Sequence[RealArray], noises: Sequence[ColouredNoise]) -> list[tuple[float, RealArray]]:
        """Sum of squares at several values of the unknowns, and the whitened residuals."""
        found = []
        for point, recordings in zip(points, self.recordings(points), strict=True):
            white = self.white(point, self.residuals(point, recordings), noises)
            found.append((float(white @ white), white))
        return found

    def within(self, unknowns: RealArray) -> RealArray:
        """The unknowns within their bounds."""
        return np.clip(unknowns, self._low, self._high)

    def intervals(self, found: Solution) -> tuple[list[tuple[float, float]], list[int]]:
        """Intervals of 95 % of all unknowns, and places of those whose profiles aren't parabolas, which are profiled."""
        from scipy.special import stdtrit

        quantile = float(stdtrit(self._freedom(found), 0.975))
        errors = np.sqrt(np.diag(found.covariance))
        ends = [(x - quantile * e, x + quantile * e) for x, e in zip(found.unknowns, errors, strict=True)]
        curved, count = set[int](), len(self.free)
        # the standard errors contain more than the noise's model: what of the sum of squares they stand for
        scaled = found.jacobian * self.sizes
        inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True) * np.outer(self.sizes, self.sizes)
        sides = [(j, side) for j in range(count) for side in (-1.0, 1.0)]
        directions = {j: inverse[:, j] / max(inverse[j, j], 1e-300) for j in range(count)}
        wanted = {j: (quantile * errors[j]) ** 2 / max(inverse[j, j], 1e-300) for j in range(count)}
        lengths = {(j, side): side * quantile * errors[j] for j, side in sides}
        points = [self.within(found.unknowns + lengths[key] * directions[key[0]]) for key in sides]
        limits = {key: float(point[key[0]]) for key, point in zip(sides, points, strict=True)}
        active = dict(zip(sides, self.costs(points, found.noises), strict=True))
        state = {key: points[i] for i, key in enumerate(sides)}
        off = dict[tuple[int, float], float]()
        for number in range(PROFILE_STEPS + 1):
            off = {}
            for key, (cost, white) in active.items():
                best, _ = self._corrected(found, white, key[0])
                ratio = max(best - found.cost, 1e-9 * wanted[key[0]]) / wanted[key[0]]
                is_bound = limits[key] in (self._low[key[0]], self._high[key[0]]) and ratio < 1.0
                if abs(ratio - 1.0) > CURVED and not is_bound:
                    curved.add(key[0])
                elif cost - best <= CURVED * wanted[key[0]] or is_bound:
                    continue
                if abs(lengths[key]) > 0.0:
                    off[key] = sqrt(1.0 / ratio)
            if not off or number == PROFILE_STEPS:
                break
            points = [self._along(found, state[key], active[key][1], key[0], factor) for key, factor in off.items()]
            for key, point, new in zip(off, points, self.costs(points, found.noises), strict=True):
                active[key], state[key], limits[key] = new, point, float(point[key[0]])
        for j in curved:
            # an end that isn't found is at least as far away as that of the parabola
            low, high = ends[j]
            ends[j] = (
                min(limits[j, -1.0], low) if (j, -1.0) in off else limits[j, -1.0],
                max(limits[j, 1.0], high) if (j, 1.0) in off else limits[j, 1.0],
            )
        low_high = zip(ends, self._low, self._high, strict=True)
        return [(float(max(a, low)), float(min(b, high))) for (a, b), low, high in low_high], sorted(curved)

    def _corrected(self, found: Solution, white: RealArray, place: int, change: float = 0.0) -> tuple[float, RealArray]:
        """Return the least sum of squares for a given step of one unknown, to first order, and the steps of all (n,), relative to their sizes."""
        scaled = found.jacobian * self.sizes
        others = np.delete(np.arange(scaled.shape[1]), place)
        left = white - scaled[:, place] * change
        step = np.full(scaled.shape[1], change)
        step[others] = np.linalg.lstsq(scaled[:, others], left, rcond=1e-10)[0]
        left = left - scaled[:, others] @ step[others]
        return float(left @ left), step

    def _along(self, found: Solution, point: RealArray, white: RealArray, place: int, factor: float) -> RealArray:
        """The next point of a profile: the parameter's distance changed by a factor, the others by a step of Gauss and Newton."""
        distance = point[place] - found.unknowns[place]
        change = (min(max(factor, 0.3), 3.0) - 1.0) * distance / self.sizes[place]
        return self.within(point + self.sizes * self._corrected(found, white, place, change)[1])


def _covered(channel: Channel, delay: float, stop_time: float) -> Channel:
    """The samples of a signal that the simulation covers, with room for other delays.

    Raises:
        InputError: there are hardly any.
    """
    room = 0.02 * stop_time
    known = channel.time - delay <= stop_time - room
    if np.count_nonzero(known) < channel.time.size and not known.any():
        known[:] = False
    if np.count_nonzero(known) < 8:
        raise InputError(
            f"{channel.name}: the log goes from {channel.time[0]:g} to {channel.time[-1]:g} s, the simulation to {stop_time:g} s, so that "
            "hardly any sample can be compared: check the unit of the time"
        )
    if known.all():
        return channel
    last = int(np.flatnonzero(known)[-1]) + 1
    pieces = tuple(slice(p.start, min(p.stop, last)) for p in channel.pieces if p.start < last)
    return replace(channel, time=channel.time[:last], values=channel.values[:last], pieces=pieces)


def information(scaled: RealArray, count: int) -> RealArray:
    """What scaled derivatives (N, n) tell of the first ``count`` unknowns, the others estimated along (count, count)."""
    found = scaled.T @ scaled
    mixed, rest = found[:count, count:], found[count:, count:]
    return np.asarray(found[:count, :count] - mixed @ np.linalg.pinv(rest, hermitian=True) @ mixed.T)


def undetermined(problem: Problem, found: Solution) -> Mapping[int, tuple[int, ...]]:
    """Places of parameters that the data don't determine → those that they can't be told apart from, themselves left out.

    In terms of the parameters' sizes, directions whose standard error exceeds `UNKNOWN` are looked at, the worst first; of each the
    parameter with the largest part is named.
    """
    noise = max(found.cost / found.freedom, problem.least_variance)
    values, vectors = np.linalg.eigh(information(found.jacobian * problem.sizes, problem.shared) / noise)
    result = dict[int, tuple[int, ...]]()
    for value, vector in zip(values, vectors.T, strict=True):
        if value > 1.0 / UNKNOWN**2:
            break
        parts = np.flatnonzero(np.abs(vector) >= SHARED * np.abs(vector).max())
        worst = int(np.argmax(np.abs(vector)))
        if worst not in result:
            result[worst] = tuple(int(each) for each in parts if each != worst)
    return result
