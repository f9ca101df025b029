"""Measured signals: read from a log, a CSV file with a header, whose columns are given the names and units of simulated signals; their
delay to the simulation, and what differs once it is removed.

The delay is the lag of the largest cross-correlation of all signals together, each without its mean and in units of its standard
deviation (C. Knapp, G. Carter, The generalized correlation method for estimation of time delay, IEEE Trans. ASSP 24, 1976). Around
it the sum of the squared differences is minimised over a continuous delay, which is the maximum-likelihood estimate for white noise
and resolves far less than a sample.
"""

from __future__ import annotations

import csv
import math
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np

from flexfmu.cosim.engine.errors import DataWarning, InputError, SignalFileError, suggestion
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.showing import UNITS, cell_text
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.errors import read_text

if TYPE_CHECKING:
    import pandas

Log = Union[str, Path, Recording, "pandas.DataFrame"]
"""A file, or signals in memory; the time of a data frame is its column `time` or its index."""


@dataclass(frozen=True)
class Mapped:
    """What a column of a log is.

    Attributes:
        signal: name of the simulated signal, or ``time``.
        factor, offset: the signal is factor * column + offset, in SI units; factor None for that of the unit in the header.
    """

    signal: str
    factor: float | None = None
    offset: float = 0.0


def parse_mapping(text: str) -> tuple[str, Mapped]:
    """Return column and meaning of ``column=signal*factor+offset``; the factor is a number or a unit, ``deg`` for example.

    Raises:
        InputError: the text has another form.
    """
    column, equals, meaning = text.rpartition("=")
    if not equals or not column.strip():
        raise InputError(f"--map takes MEASURED=SIGNAL, tau1=joint1.torque*1e-3 for example, got {text!r}")
    return column.strip(), as_mapped(meaning)


def parse_interval(option: str, text: str) -> tuple[float, float]:
    """Return both ends of an option's ``FROM:TO``.

    Raises:
        InputError: the text has another form, or they don't ascend.
    """
    try:
        begin, end = map(float, text.split(":"))
    except ValueError:
        begin = end = math.nan
    if not -math.inf < begin < end < math.inf:
        raise InputError(f"{option} takes FROM:TO, two ascending numbers, 0.1:0.6 for example, got {text!r}")
    return begin, end


def as_mapped(text: str) -> Mapped:
    """Return the meaning of a column from ``signal*factor+offset``, of which factor and offset may be left out.

    Raises:
        InputError: factor or offset is neither a number nor a unit.
    """
    found = re.fullmatch(r"\s*([^*+]+?)\s*(?:\*\s*([^+\s]+(?:[eE]\+\d+)?))?\s*(?:\+\s*(\S+))?\s*", text)
    if found is None:
        raise InputError(
            f"a measured column is mapped to SIGNAL*FACTOR+OFFSET, joint1.torque*1e-3 for example, got {text!r}"
        )
    signal, factor, offset = found.groups()
    return Mapped(signal, None if factor is None else _number(factor, text), _number(offset or "0", text))


def _number(word: str, text: str) -> float:
    try:
        value = UNITS[word][1] if word in UNITS else float(word)
    except ValueError:
        raise InputError(
            f"{word!r} in {text!r} is neither a number nor a known unit; units: {', '.join(UNITS)}"
        ) from None
    if not math.isfinite(value):
        raise InputError(f"{word!r} in {text!r} must be finite")
    return value


def tell_odd(source: object, odd: Sequence[tuple[int, str, str]], *, strict: bool) -> None:
    """Warn of values that are no finite numbers and are left out, or refuse them.

    Args:
        source: where they are.
        odd: line, column and cell of each.
        strict: whether they are refused.

    Raises:
        InputError: there is one, and they are refused.
    """
    if not odd:
        return
    line, name, cell = min(odd)
    what = f"{source}: {len(odd)} values are no finite numbers{'' if strict else ' and are left out'}"
    text = f"{what}; the first is {cell[:20]!r} in line {line}, column {name[:40]!r}"
    if strict:
        raise InputError(f"{text}; without --strict they are left out")
    warnings.warn(text, DataWarning, stacklevel=3)


def read_log(log: Log, mapping: Mapping[str, Mapped], signals: Mapping[str, str], *, strict: bool = False) -> Recording:
    """Read the columns of a log that are signals of a simulation.

    The separator is a comma, semicolon or tab; with semicolons or tabs numbers may have a decimal comma. Lines before the header
    that begin with ``#`` are skipped. A name may have a unit in brackets, ``torque [mN.m]``, which is converted to the SI unit.
    Empty cells are missing values. Column `time` or `t` is the time, whatever its case, unless one is mapped to ``time``.

    Args:
        log: the CSV file; a ``.parquet`` or ``.mat`` file, or what is in memory, in SI units where the mapping has no factor.
        mapping: name of a column → its meaning; others are taken where their name is that of a signal.
        signals: name of a simulated signal → its unit.
        strict: whether a value that is no finite number is an error instead of left out.

    Raises:
        SignalFileError: the file can't be read.
        InputError: it has no time, no signal, a column or signal doesn't exist, the time decreases, or a unit is unknown.
    """
    source = Path(log) if isinstance(log, str | Path) else "the measurement"
    found = table_of(Path(log)) if isinstance(log, str | Path) else _in_memory(log)
    table, units = found.table, found.units
    meaning = _meaning(source, table, mapping, signals)
    if twice := next((name for name in meaning if name in found.repeated), None):
        raise InputError(f"{source}: column {twice!r} is there twice; give one of them another name")
    # the time first, which every signal needs
    (time_name,) = (name for name, each in meaning.items() if each.signal == "time")
    time = _converted(table, units, time_name, meaning[time_name])
    known = np.isfinite(time)
    places, time = np.flatnonzero(known), time[known]
    if time.size == 0:
        raise InputError(f"{source}: the time in column {time_name!r} has no number")
    if np.any(back := np.diff(time) < 0.0):
        line = found.places[places[int(np.argmax(back)) + 1]]
        raise InputError(
            f"{source}, line {line}: the time in column {time_name!r} must not decrease, but it does there"
        )
    # what is left out
    tell_odd(source, [(line, name, cell) for name in meaning for line, cell in found.odd.get(name, ())], strict=strict)
    columns = {
        each.signal: Column(signals[each.signal], _converted(table, units, name, each)[known])
        for name, each in meaning.items()
        if each.signal != "time"
    }
    return Recording(time, columns)


@dataclass(frozen=True)
class LogTable:
    """The columns of a log by name without their units, these units, the lines of the rows, and column → lines and cells of what is
    no finite number though it isn't empty."""

    table: dict[str, np.ndarray]
    units: dict[str, str] = field(default_factory=dict)
    places: Sequence[int] = range(1, sys.maxsize)
    odd: dict[str, list[tuple[int, str]]] = field(default_factory=dict)
    repeated: frozenset[str] = frozenset()


def _in_memory(log: Recording | pandas.DataFrame) -> LogTable:
    """Return the columns of signals in memory, the time among them; NaN is a missing value there."""
    if isinstance(log, Recording):
        columns = {"time": log.time, **{name: each.values for name, each in log.columns.items()}}
    else:
        columns = {str(name): log[name].to_numpy() for name in log.columns}
        if not any(name.lower() in ("time", "t") for name in columns):
            columns = {"time": np.asarray(log.index, dtype=np.float64), **columns}
    real = {name: each for name, each in columns.items() if each.dtype.kind == "f"}
    odd = {
        name: [(i + 1, f"{each[i]:g}") for i in np.flatnonzero(np.isinf(each)).tolist()] for name, each in real.items()
    }
    return LogTable(columns, odd=odd)


def table_of(path: Path) -> LogTable:
    """Return the columns of a file."""
    if path.suffix in (".parquet", ".mat"):
        return _in_memory(Recording.read(path))
    try:
        text = read_text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it isn't UTF-8 text, as CSV files are"
        raise SignalFileError(f"can't read {path}: {reason}") from error
    numbered = [each for each in enumerate(text.splitlines(), 1) if each[1].strip() and not each[1].startswith("#")]
    lines = [line for _, line in numbered]
    separator = max(",;\t", key="".join(lines[:1]).count)
    header, *rows = csv.reader(lines, delimiter=separator) if lines else [[]]
    # a second line of units
    has_units = bool(rows) and all(math.isnan(_number_in(cell.replace(",", "."))) for cell in rows[0])
    own = [cell.strip().strip("[]") for cell in rows.pop(0)] if has_units else []
    if not rows or not any(cell.strip() for cell in header):
        raise SignalFileError(f"{path} has no rows: it must have a header and at least one row of numbers")
    places = [number for number, _ in numbered[-len(rows) :]]
    names, units = list[str](), dict[str, str]()
    for i, cell in enumerate(header):
        # brackets with a number belong to the name: link11.bending[1]
        found = re.fullmatch(r"(.*?)\s*[\[(](?!\s*\d+\s*[\])])([^\])]*)[\])]\s*", cell.strip())
        name, unit = found.groups() if found else (cell.strip(), own[i] if i < len(own) else "")
        names.append(cell_text(name.replace(";", ",")))  # as `Recording.write_csv` has it
        units[names[-1]] = unit.strip()
    for number, row in zip(places, rows, strict=False):
        if len(row) != len(header):
            raise SignalFileError(
                f"{path}, line {number}: {len(row)} cells for the {len(header)} columns of the header"
            )
    # NaN for empty cells and texts
    values = [[_number_in(cell if separator == "," else cell.replace(",", ".")) for cell in row] for row in rows]
    table = np.array(values, dtype=np.float64)
    # cells that aren't empty and yet no finite numbers
    odd = dict[str, list[tuple[int, str]]]()
    for i, j in np.argwhere(~np.isfinite(table)):
        if cell := rows[i][j].strip():
            odd.setdefault(names[j], []).append((places[i], cell))
    repeated = frozenset(name for name in names if name and names.count(name) > 1)
    return LogTable(dict(zip(names, table.T, strict=True)), units, places, odd, repeated)


def _number_in(cell: str) -> float:
    """The number in a cell, NaN for none."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _meaning(
    path: Path | str, table: Mapping[str, object], mapping: Mapping[str, Mapped], signals: Mapping[str, str]
) -> dict[str, Mapped]:
    """Return what the columns are that are used: mapped ones, and those named like a signal that no other is mapped to.

    Raises:
        InputError: a column or signal doesn't exist, or there is no time or no signal.
    """
    found = dict[str, Mapped]()
    for column, each in mapping.items():
        if column not in table:
            raise InputError(f"{path} has no column {column!r}; {suggestion(column, table)}")
        if each.signal != "time" and each.signal not in signals:
            raise InputError(
                f"column {column!r} can't be {each.signal!r}: there is no such signal; {suggestion(each.signal, signals)}"
            )
        found[column] = each
    taken = [each.signal for each in found.values()]
    twice = next((name for name in taken if taken.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"two columns of {path} are mapped to {twice!r}")
    # the time by its usual names, then equal names
    if "time" not in taken:
        usual = next((name for name in table if name.lower() in ("time", "t")), None)
        if usual is None:
            raise InputError(f'{path} has no column `time`; map one, --map "{next(iter(table))}=time" for example')
        found[usual] = Mapped("time")
    found |= {name: Mapped(name) for name in table if name in signals and name not in found and name not in taken}
    if len(found) < 2:
        example = f'--map "{next((name for name in table if name not in found), "column")}=joint1.torque"'
        raise InputError(
            f"no column of {path} is a signal; map one, {example} for example; columns: {', '.join(table)}"
        )
    return found


def _converted(table: Mapping[str, np.ndarray], units: Mapping[str, str], name: str, each: Mapped) -> np.ndarray:
    """Return a column in SI units.

    Raises:
        InputError: the unit in the header is unknown, and no factor is given.
    """
    factor, unit = each.factor, units.get(name, "")
    if factor is None:
        if unit and unit not in UNITS:
            raise InputError(
                f'column {name!r} has the unknown unit {unit!r}; give the factor to the SI unit, --map "{name}={each.signal}*1e-3" '
                "for example"
            )
        factor = UNITS[unit][1] if unit else 1.0
    return np.asarray(factor * table[name] + each.offset, dtype=np.float64)


MOST = 1 << 21
"""Largest number of equally spaced samples of a signal that is correlated."""

LEAST = 8
"""Smallest number of common samples."""

REFINED, PARTS = 0.05, 20
"""Interval around the correlation's peak that is searched again, relative to the simulation's length; its parts at each level."""


@dataclass(frozen=True)
class TimedValues:
    """A signal at instants.

    Attributes:
        time: (N,) instants [s], not decreasing.
        values: (N,) finite values.
    """

    time: RealArray = field(repr=False)
    values: RealArray = field(repr=False)

    def at(self, time: RealArray) -> RealArray:
        """Return the values at other instants, interpolated linearly."""
        return np.interp(time, self.time, self.values)


Pair = tuple[TimedValues, TimedValues]
"""A measured signal, and the simulated one that it belongs to."""


@dataclass(frozen=True)
class Delay:
    """Time of an event in the measurement minus its time in the simulation.

    Attributes:
        seconds: the delay [s].
        error: its standard error [s] from the differences that remain, be they correlated in time or not; it doesn't contain a
            shift that a wrong model causes. 0 for a delay that was given.
        correlation: correlation coefficient of all signals after alignment, -1 to 1.
    """

    seconds: float
    error: float
    correlation: float


@dataclass(frozen=True, repr=False)
class Difference:
    """Measured minus simulated signal, over the time that both have.

    Attributes:
        time: (N,) instants of the measurement in the simulation's time [s].
        measured, simulated: (N,) values.
    """

    time: RealArray
    measured: RealArray
    simulated: RealArray

    def __repr__(self) -> str:
        """Return a line with RMS, mean and largest magnitude."""
        figures = f"{self.root_mean_square:.6g} RMS, {self.mean:.6g} mean, {self.largest:.6g} largest"
        return f"Difference at {self.time.size} instants: {figures}"

    @property
    def values(self) -> RealArray:
        """Measured minus simulated values (N,)."""
        return self.measured - self.simulated

    @property
    def root_mean_square(self) -> float:
        """Root mean square over time of the difference, by the trapezoidal rule."""
        return float(np.sqrt(self._mean(self.values**2)))

    @property
    def mean(self) -> float:
        """Mean over time of the difference."""
        return self._mean(self.values)

    @property
    def largest(self) -> float:
        """Largest magnitude of the difference."""
        return float(np.abs(self.values).max())

    @property
    def relative(self) -> float | None:
        """Root mean square relative to the range of the measured values; None for a constant."""
        span = float(np.ptp(self.measured))
        return self.root_mean_square / span if span else None

    def _mean(self, values: RealArray) -> float:
        return float(np.trapezoid(values, self.time) / (self.time[-1] - self.time[0]))


def difference(measured: TimedValues, simulated: TimedValues, delay: float) -> Difference:
    """Return the difference of signals at the measured instants that the simulation covers.

    Raises:
        InputError: there are fewer than `LEAST` of them.
    """
    time = measured.time - delay
    inside = (time >= simulated.time[0]) & (time <= simulated.time[-1])
    if np.count_nonzero(inside) < LEAST:
        raise InputError(
            f"measurement and simulation overlap in {np.count_nonzero(inside)} samples only: with a delay of {delay:g} s the "
            f"measurement goes from {time[0]:g} to {time[-1]:g} s of the simulation, which goes from {simulated.time[0]:g} to "
            f"{simulated.time[-1]:g} s; check the delay and the unit of the time"
        )
    return Difference(time[inside], measured.values[inside], simulated.at(time[inside]))


def estimate_delay(pairs: Sequence[Pair]) -> Delay:
    """Return the delay of measured signals, from all of them together.

    Args:
        pairs: at least one; signals of which one side is constant are ignored.

    Raises:
        InputError: no signal changes in both, or measurement and simulation hardly overlap.
    """
    moving = [pair for pair in pairs if all(np.ptp(each.values) > 0.0 and np.ptp(each.time) > 0.0 for each in pair)]
    if not moving:
        raise InputError("the delay can't be estimated: no signal changes in both measurement and simulation; give it")
    centre, step = _correlated(moving)
    length = min(float(np.ptp(simulated.time)) for _, simulated in moving)
    # ever narrower intervals around the least difference, as long as a part is longer than a sample
    sample = min(float(np.ptp(measured.time)) / measured.time.size for measured, _ in moving)
    width = max(REFINED * length, 2.0 * step)
    while width > sample:
        lags = centre + np.linspace(-width, width, 2 * PARTS + 1)
        costs = _Cost(moving, centre, width)
        centre = float(min(lags, key=costs))
        width *= 2.0 / PARTS
    # then over a continuous delay
    from scipy.optimize import minimize_scalar

    cost = _Cost(moving, centre, sample)
    bounds = centre - sample, centre + sample
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-6 * sample})
    seconds = float(found.x)
    return Delay(seconds, cost.standard_error(seconds), correlation(moving, seconds))


def correlation(pairs: Sequence[Pair], delay: float) -> float:
    """Return the correlation coefficient of signals, each without its mean and in units of its own size, after alignment."""
    products = squares = others = 0.0
    for measured, simulated in pairs:
        found = difference(measured, simulated, delay)
        one, other = (each - each.mean() for each in (found.measured, found.simulated))
        weight = 1.0 / max(float(other @ other), np.finfo(float).tiny)
        products, squares = products + weight * float(one @ other), squares + weight * float(one @ one)
        others += weight * float(other @ other)
    return products / np.sqrt(squares * others) if squares * others > 0.0 else 0.0


def _correlated(pairs: Sequence[Pair]) -> tuple[float, float]:
    """Return the lag of the largest cross-correlation and its resolution [s]."""
    start, end = (min(float(pair[side].time[0]) for pair in pairs) for side in (0, 1))
    spans = [float(np.ptp(each.time)) for pair in pairs for each in pair]
    steps = [float(np.median(taken[taken > 0.0])) for measured, _ in pairs for taken in [np.diff(measured.time)]]
    step = max(min(steps), max(spans) / MOST)
    series = [
        [_standardised(each, begin, step) for each, begin in zip(pair, (start, end), strict=True)] for pair in pairs
    ]
    # by Fourier transforms, of all signals as long as the longest with zeros behind
    m, n = (max(pair[side].size for pair in series) for side in (0, 1))
    size = 1 << (m + n - 1).bit_length()
    products = sum(np.fft.rfft(one, size) * np.fft.rfft(other, size).conj() for one, other in series)
    total = np.fft.irfft(products, size)
    lags = np.arange(-(n - 1), m)
    return float(start - end + step * lags[np.argmax(total[lags])]), step


def _standardised(signal: TimedValues, begin: float, step: float) -> RealArray:
    """Return a signal at equal steps from a time on, without its mean and in units of its standard deviation."""
    grid = begin + step * np.arange(int((signal.time[-1] - begin) / step) + 1, dtype=np.float64)
    values = signal.at(grid)
    spread = float(values.std())
    return np.asarray((values - values.mean()) / (spread or 1.0))


class _Cost:
    """Sum of the squared differences without their means over the delay, at those samples that all delays of an interval share.

    Args:
        pairs: the signals.
        centre, width: delays from centre - width to centre + width [s].

    Raises:
        InputError: there are fewer than `LEAST` such samples.
    """

    def __init__(self, pairs: Sequence[Pair], centre: float, width: float) -> None:
        self._pairs: list[Pair] = []
        for measured, simulated in pairs:
            inside = measured.time - centre - width >= simulated.time[0]
            inside &= measured.time - centre + width <= simulated.time[-1]
            if np.count_nonzero(inside) < LEAST:
                difference(measured, simulated, centre)  # its error has the figures
                raise InputError("measurement and simulation hardly overlap where they agree best; give the delay")
            self._pairs.append((TimedValues(measured.time[inside], measured.values[inside]), simulated))
        self._weights = [1.0 / float(simulated.values.var()) for _, simulated in self._pairs]

    def __call__(self, delay: float) -> float:
        """Return the sum of the squared differences, each signal in units of its standard deviation."""
        parts = (
            weight * (measured.values - simulated.at(measured.time - delay)).var() * measured.time.size
            for weight, (measured, simulated) in zip(self._weights, self._pairs, strict=True)
        )
        return float(sum(parts))

    def standard_error(self, delay: float) -> float:
        """Return the standard error of the delay [s] that follows from the differences and the signals' slopes."""
        information = noise = 0.0
        for weight, (measured, simulated) in zip(self._weights, self._pairs, strict=True):
            shift = 0.5 * float(np.ptp(measured.time)) / measured.time.size
            ends = (simulated.at(measured.time - delay + side * shift) for side in (1.0, -1.0))
            slope = np.subtract(*ends) / (2.0 * shift)
            slope -= slope.mean()
            remaining = measured.values - simulated.at(measured.time - delay)
            information += weight * float(slope @ slope)
            noise += weight**2 * _variance_of_sum(slope * (remaining - remaining.mean()))
        return float(np.sqrt(noise) / information) if information else float("inf")


def _variance_of_sum(terms: RealArray) -> float:
    """Return the variance of a sum of terms (N,) of mean zero that are correlated over at most the root of N of them, not negatively.

    W. Newey, K. West, A simple, positive semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix,
    Econometrica 55, 1987.
    """
    most = int(np.sqrt(terms.size))
    lags = (2.0 * (1.0 - lag / (most + 1.0)) * float(terms[lag:] @ terms[:-lag]) for lag in range(1, most + 1))
    return float(terms @ terms) + max(sum(lags), 0.0)
