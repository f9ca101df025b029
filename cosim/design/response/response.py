"""Measured frequency responses: read and written, with their modes, the margins of a loop that they are of, and their picture."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle, product
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from flexfmu.cosim.design.margins.loci import loop_figures, margins_with_errors, refined
from flexfmu.cosim.design.margins.margins import LoopMargins
from flexfmu.cosim.design.response.modal_fit import MeasuredMode, fitted_modes
from flexfmu.cosim.engine.errors import InputError, SignalFileError
from flexfmu.cosim.engine.files import replacing
from flexfmu.cosim.engine.measured import table_of
from flexfmu.cosim.engine.showing import UNITS, Rows
from flexfmu.cosim.reports.chart import PALETTE, Curve, Panel
from flexfmu.cosim.reports.page import Plot
from flexfmu.errors import read_text
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

ComplexArray = NDArray[np.complex128]

DRAWS = 32
"""Responses that are drawn within their standard errors, for those of margins."""

FINER = 4
"""Frequencies between two measured ones at which a loop's margins are looked for."""

PARTS: Mapping[str, tuple[str, ...]] = {
    "frequency": ("frequency", "freq", "f", "omega", "w"),
    "magnitude": ("magnitude", "mag", "gain", "amplitude", "abs"),
    "phase": ("phase", "angle", "arg"),
    "real": ("real", "re"),
    "imaginary": ("imaginary", "imag", "im"),
    "standard error": ("standard error", "standard_error"),
    "coherence": ("coherence", "coh"),
}
"""Column of a file → its names, whatever their case."""

PER_SECOND: Mapping[str, float] = {
    "Hz": 1.0, "kHz": 1e3, "rad/s": 0.5 / pi, "rad/TimeUnit": 0.5 / pi, "rad/second": 0.5 / pi, "rpm": 1.0 / 60.0,
}  # fmt: skip
"""Unit of a frequency → Hz."""


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Rows):
    """A frequency response, measured or estimated, between frequencies by splines.

        plant = flexfmu.FrequencyResponse.read("plant.csv")
        plant.modes(), plant.plot(), flexfmu.margins("scene.toml", response=plant)

    Attributes:
        frequency: (N,) ascending, above 0 [Hz].
        response: complex, (N, outputs, inputs); (N,) is taken for one of each.
        inputs, outputs: names of the signals, of the robot's FMU for example.
        units: name of a signal → unit; those that aren't known are left out.
        standard_error: of the real part and of the imaginary part of each value, in its unit; None where it isn't known.
        coherence: share of each output's power that the inputs explain, (N, outputs); None where it isn't known.
        sample_time: [s] of a response from an input that is held between samples to an output at the samples, as a log at the
            rate of a controller shows it; None for one of continuous signals.

    Raises:
        InputError: frequencies don't ascend from above 0, sizes differ, or a value isn't finite.
    """

    frequency: RealArray
    response: ComplexArray
    inputs: tuple[str, ...] = ("input",)
    outputs: tuple[str, ...] = ("output",)
    units: Mapping[str, str] = field(default_factory=dict)
    standard_error: RealArray | None = None
    coherence: RealArray | None = None
    sample_time: float | None = None

    row_name = "frequency [Hz]"

    def __post_init__(self) -> None:
        n, shape = len(self.frequency), (len(self.frequency), len(self.outputs), len(self.inputs))
        if n < 2 or (np.diff(self.frequency) <= 0.0).any() or not self.frequency[0] > 0.0:
            raise InputError("a frequency response has at least 2 frequencies in Hz that ascend from above 0")
        for name, wanted in (("response", shape), ("standard_error", shape), ("coherence", shape[:2])):
            if (values := getattr(self, name)) is None:
                continue
            if np.size(values) != np.prod(wanted):
                raise InputError(
                    f"{name} has {np.size(values)} values, for {n} frequencies, {shape[1]} outputs and {shape[2]} inputs"
                )
            if not np.isfinite(values).all():
                at = self.frequency[np.argwhere(~np.isfinite(np.reshape(values, wanted)))[0, 0]]
                raise InputError(f"{name} isn't finite at {at:g} Hz")
            object.__setattr__(self, name, np.reshape(values, wanted))

    def __repr__(self) -> str:
        """Return a line: what leads where, over which frequencies."""
        held = "" if self.sample_time is None else f", inputs held for {1e3 * self.sample_time:g} ms"
        names = ", ".join(self.outputs), ", ".join(self.inputs)
        return f"Frequency response of {names[0]} to {names[1]}, {len(self.frequency)} from {self.frequency[0]:g} to {self.frequency[-1]:g} Hz{held}"

    @classmethod
    def of(cls, system: Any, frequency: ArrayLike) -> FrequencyResponse:
        """The response of a system of python-control, from `flexfmu.linearize` for example, at frequencies (N,) [Hz]."""
        f = np.asarray(frequency, float)
        values = np.asarray(system.frequency_response(2.0 * pi * f, squeeze=False).frdata)
        step = system.dt if system.isdtime(strict=True) else None
        return cls(f, np.moveaxis(values, 2, 0), (*system.input_labels,), (*system.output_labels,), sample_time=step)

    @classmethod
    def read(
        cls, path: str | Path, inputs: Sequence[str] = (), outputs: Sequence[str] = (), sample_time: float | None = None
    ) -> FrequencyResponse:
        """Read a response.

        A CSV file has a column ``frequency [Hz]`` (or ``[rad/s]``) and ``magnitude`` (or ``[dB]``) with ``phase [deg]`` (or ``[rad]``),
        or ``real`` and ``imaginary``; with several outputs or inputs ``OUTPUT/INPUT real`` and so on. A ``.mat`` file has the arrays
        of MATLAB's idfrd, ``ResponseData`` (outputs, inputs, N), ``Frequency`` with ``FrequencyUnit`` and ``Ts``, or python-control's,
        ``fresp`` or ``frdata`` with ``omega`` [rad/s], in the file or in a struct in it.

        Args:
            path: the file.
            inputs, outputs: names of the signals where the file has none, or others.
            sample_time: see `FrequencyResponse`, where the file doesn't say.

        Raises:
            SignalFileError: the file can't be read, or has no response.
            InputError: a unit is unknown, or values and names don't fit.
        """
        path = Path(path)
        known = _from_mat(path) if path.suffix.lower() == ".mat" else _from_csv(path)
        known |= {key: tuple(each) for key, each in (("inputs", inputs), ("outputs", outputs)) if each}
        known |= {} if sample_time is None else {"sample_time": sample_time}
        try:
            return cls(**known)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    def write(self, path: str | Path) -> Path:
        """Write the response to a ``.csv`` or ``.mat`` file that `read` reads, the latter with the names of MATLAB's idfrd.

        Raises:
            InputError: the file has another suffix.
            ResultsError: it can't be written.
        """
        path = Path(path)
        if path.suffix.lower() not in (".csv", ".mat"):
            raise InputError(f"a frequency response is written to a .csv or .mat file, not to {path.name}")
        arrays = {
            "ResponseData": np.moveaxis(self.response, 0, 2), "Frequency": self.frequency, "FrequencyUnit": "Hz",
            "Ts": self.sample_time or 0.0, "InputName": np.array(self.inputs, object),
            "OutputName": np.array(self.outputs, object), "standard_error": self.standard_error, "coherence": self.coherence,
        }  # fmt: skip
        with replacing(path) as file:
            if path.suffix.lower() == ".mat":
                from scipy.io import savemat

                savemat(file, {name: each for name, each in arrays.items() if each is not None}, appendmat=False)
            else:
                note = "" if self.sample_time is None else f"# sample time {self.sample_time!r} s\n"
                file.write_text(note + self.to_csv(), encoding="utf-8")
        return path

    def rows(self) -> list[dict[str, Any]]:
        """A row for each frequency: of each pair magnitude and phase, and what is known of their errors."""
        columns = {"frequency [Hz]": self.frequency}
        for (o, output), (i, name) in product(enumerate(self.outputs), enumerate(self.inputs)):
            value = self.response[:, o, i]
            columns |= {f"{output}/{name} magnitude": np.abs(value), f"{output}/{name} phase [rad]": np.angle(value)}
            if self.standard_error is not None:
                columns[f"{output}/{name} standard error"] = self.standard_error[:, o, i]
            if self.coherence is not None:
                columns[f"{output}/{name} coherence"] = self.coherence[:, o]
        return [dict(zip(columns, row, strict=True)) for row in np.column_stack([*columns.values()]).tolist()]

    def at(self, frequency: RealArray, draws: ComplexArray | None = None) -> ComplexArray:
        """The response at frequencies (M,) [Hz], (M, outputs, inputs), by cubic splines over their logarithms; beyond its band that of its end.

        Args:
            frequency: the frequencies.
            draws: responses of the same sizes in place of its own.
        """
        inside = np.clip(frequency, *self.frequency[[0, -1]])
        spline = CubicSpline(np.log(self.frequency), self.response if draws is None else draws)
        return np.asarray(spline(np.log(inside)))

    def drawn(self) -> list[ComplexArray]:
        """`DRAWS` responses with errors of their standard errors, always the same; none where these aren't known."""
        if self.standard_error is None:
            return []
        errors = np.random.default_rng(0).standard_normal((DRAWS, 2, *self.response.shape)) * self.standard_error
        return [*(self.response + errors[:, 0] + 1j * errors[:, 1])]

    def to_control(self) -> control.FrequencyResponseData:
        """The response as data of python-control, whose names have underscores for dots."""
        import control

        names = {key: [each.replace(".", "_") for each in getattr(self, key)] for key in ("inputs", "outputs")}
        values, omega = np.moveaxis(self.response, 0, 2), 2.0 * pi * self.frequency
        return control.frd(values, omega, dt=self.sample_time or 0, **names)

    def margins(self) -> LoopMargins:
        """The margins of the loop that this is the open loop's response of, for negative feedback, each with its standard error.

        They are those of a stable loop: whether it is, a response alone can't tell. With several channels they change together.

        Raises:
            InputError: there aren't as many outputs as inputs.
        """
        if len(self.inputs) != len(self.outputs):
            raise InputError(f"a loop has as many outputs as inputs, got {len(self.outputs)} and {len(self.inputs)}")
        channels = np.arange(len(self.inputs))

        between = np.linspace(np.log(self.frequency[:-1]), np.log(self.frequency[1:]), FINER, endpoint=False)
        grid = np.append(2.0 * pi * np.exp(between.T.ravel()), 2.0 * pi * self.frequency[-1])
        omega = refined(lambda each: -self.at(each / (2.0 * pi)), channels, grid)
        loops = (self.at(omega / (2.0 * pi), draw) for draw in (None, *self.drawn()))
        figures = [loop_figures(omega, -each, channels, each) for each in loops]
        return margins_with_errors("loop", figures[0], figures[1:])

    def modes(self, count: int | None = None) -> Modes:
        """Natural frequencies and damping ratios within the band, with standard errors and 95 % intervals.

        Args:
            count: number of modes; None for as many as the response shows, at most 10.

        Raises:
            InputError: the response has too few frequencies.
        """
        flat = (len(self.frequency), -1)
        errors = None if self.standard_error is None else self.standard_error.reshape(flat)
        return Modes(self, *fitted_modes(self.frequency, self.response.reshape(flat), errors, self.sample_time, count))

    def plot(self, marks: Sequence[float] = ()) -> Figure:
        """Magnitude with its standard error [dB], phase [degrees] and coherence over the frequency [Hz], a curve for each pair.

        Args:
            marks: frequencies that are marked [Hz].
        """
        from flexfmu.cosim.reports.figure_style import figure_of  # Matplotlib takes longer than most commands

        f, error = self.frequency, 0.0 if self.standard_error is None else self.standard_error
        sizes, phases = np.abs(self.response), np.degrees(np.unwrap(np.angle(self.response), axis=0))
        low, high = (20.0 * np.log10(np.maximum(each, 1e-3 * sizes)) for each in (sizes - error, sizes + error))
        shown: dict[str, list[Curve]] = {"magnitude [dB]": [], "phase [°]": [], "coherence": []}
        gains, angles, shares = shown.values()
        for (o, i), colour in zip(np.ndindex(sizes.shape[1:]), cycle(PALETTE), strict=False):
            # the area within the standard error, and the curve
            around = np.append(low[:, o, i], high[::-1, o, i])
            gains.append(Curve(np.append(f, f[::-1]), around, colour=colour, width=0.0, fill=0.3))
            gains.append(Curve(f, 20.0 * np.log10(sizes[:, o, i]), f"{self.outputs[o]} / {self.inputs[i]}", colour))
            angles.append(Curve(f, phases[:, o, i], colour=colour))
            if self.coherence is not None and not i:
                shares.append(Curve(f, self.coherence[:, o], colour=colour))
        lines = [(each, "") for each in marks]
        panels = tuple(Panel(label, each, logarithmic="x", marks=lines) for label, each in shown.items() if each)
        return figure_of([Plot("response", "Frequency response", "", panels, "frequency [Hz]", 380.0)])


def as_response(source: FrequencyResponse | str | Path | None) -> FrequencyResponse | None:
    """Return the response that a file has, if it is one; errors as for `FrequencyResponse.read`."""
    return FrequencyResponse.read(source) if isinstance(source, str | Path) else source


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Rows):
    """Modes of a measured response, the lowest first.

    Attributes:
        response: the response.
        modes: natural frequencies and damping ratios.
        misfit: root mean square of the residuals in units of the response's standard errors (relative to its magnitude where these aren't
            known): 1 where the modes explain it. The errors of modes grow with a larger one.
    """

    response: FrequencyResponse
    modes: tuple[MeasuredMode, ...]
    misfit: float

    def __repr__(self) -> str:
        """Return a line: the modes."""
        listed = ", ".join(f"{each.frequency:.4g} Hz ({100.0 * each.damping_ratio:.2g} %)" for each in self.modes)
        return f"{len(self.modes)} modes: {listed}" if listed else "no modes"

    def rows(self) -> list[dict[str, Any]]:
        """A row for each mode, frequencies in Hz."""
        return [
            {
                "frequency": float(each.frequency), "frequency_error": each.frequency.error,
                "frequency_interval": list(each.frequency_interval), "damping_ratio": float(each.damping_ratio),
                "damping_ratio_error": each.damping_ratio.error, "damping_ratio_interval": list(each.damping_interval),
            } for each in self.modes
        ]  # fmt: skip

    def plot(self) -> Figure:
        """The response with its modes."""
        return self.response.plot([float(each.frequency) for each in self.modes])


def _from_csv(path: Path) -> dict[str, Any]:
    """The arguments of a response from a CSV file."""
    table, frequency = table_of(path), None
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for name, values in table.table.items():
        # OUTPUT/INPUT before what it is, of which decibels may be a part
        output, of, text, decibel = re.fullmatch(
            r"(?:(.+)/(.+?) (?=standard|\S+$))?(.+?)([ _]+db)?", name, re.IGNORECASE
        ).groups()  # type: ignore[union-attr]
        unit = table.units.get(name, "")
        part = next((each for each, names in PARTS.items() if text.lower() in names), None)
        if part == "frequency":
            usual = "rad/s" if text.lower() in ("omega", "w") else "Hz"
            frequency = values * _factor(path, name, unit or usual, PER_SECOND)
        elif part is not None:
            if part == "phase":
                values = values * _factor(path, name, unit, {each: UNITS[each][1] for each in ("rad", "deg", "°")})
            elif decibel or unit.lower() == "db":
                values = 10.0 ** (values / 20.0)
            found.setdefault((output or "output", of or "input"), {})[part] = values
    if frequency is None:
        raise SignalFileError(f"{path} has no column `frequency`; columns: {', '.join(table.table)}")
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in found)) for k in (0, 1))
    pairs = [found.get(pair, {}) for pair in product(outputs, inputs)]
    for each in pairs:
        if {"magnitude", "phase"} <= each.keys():
            each["response"] = each["magnitude"] * np.exp(1j * each["phase"])
        elif {"real", "imaginary"} <= each.keys():
            each["response"] = each["real"] + 1j * each["imaginary"]
    if not pairs or not all("response" in each for each in pairs):
        need = "`magnitude` and `phase [deg]`, or `real` and `imaginary`"
        raise SignalFileError(
            f"{path} has no response of each output to each input: that needs {need}; columns: {', '.join(table.table)}"
        )
    stacked = {
        key: np.stack([each[part] for each in pairs], axis=1)
        for key, part in (("response", "response"), ("standard_error", "standard error"), ("coherence", "coherence"))
        if all(part in each for each in pairs)
    }
    if "coherence" in stacked:
        stacked["coherence"] = stacked["coherence"][:, :: len(inputs)]
    note = re.match(r"# sample time (\S+) s", read_text(path))
    step = float(note[1]) if note else None
    return {"frequency": frequency, **stacked, "inputs": inputs, "outputs": outputs, "sample_time": step}


def _factor(path: Path, name: str, unit: str, known: Mapping[str, float]) -> float:
    """The factor of a column's unit, which stands in brackets behind its name."""
    if unit not in known:
        raise InputError(
            f"{path}: {name} has the unit {unit!r}; it needs one of {', '.join(known)}: `{name} [{next(iter(known))}]`"
        )
    return known[unit]


def _from_mat(path: Path) -> dict[str, Any]:
    """The arguments of a response from a .mat file."""
    try:
        from scipy.io import loadmat

        content: dict[str, Any] = loadmat(path, appendmat=False)
    except (OSError, NotImplementedError, ValueError, TypeError) as error:
        raise SignalFileError(f"can't read {path}: {error}; MATLAB saves what can be read with -v7") from error
    # the file itself, or a struct in it
    structs = [each for each in content.values() if isinstance(each, np.ndarray) and each.dtype.names and each.size]
    for level in (content, *({name: each[name].flat[0] for name in each.dtype.names} for each in structs)):
        data = {name.lower(): each for name, each in level.items()}
        values = next((data[each] for each in ("responsedata", "fresp", "frdata", "response") if each in data), None)
        name = next((each for each in ("frequency", "omega", "freq", "w") if each in data), "")
        if values is not None and name:
            break
    else:
        raise SignalFileError(
            f"{path} has no arrays ResponseData and Frequency, nor fresp and omega; of an idfrd object G save G.ResponseData and G.Frequency"
        )
    f, values = np.ravel(data[name]).astype(float), np.asarray(values, complex)
    units = next((data[each] for each in ("frequencyunit", "frequencyunits", "units") if each in data), "rad/s")
    if values.size == f.size:
        values = values.reshape(1, 1, -1)
    if values.shape[2:] != f.shape:
        raise SignalFileError(
            f"{path}: {values.shape} values for {len(f)} frequencies; they must be (outputs, inputs, frequencies)"
        )
    step = float(np.ravel(data.get("ts", 0.0))[0])
    names = {key: _texts(data.get(label, ())) for key, label in (("outputs", "outputname"), ("inputs", "inputname"))}
    for (key, known), size in zip(names.items(), values.shape, strict=False):
        if len(known) != size or not all(known):
            names[key] = (key[:-1],) if size == 1 else tuple(f"{key[:-1]}{k + 1}" for k in range(size))
    more = {key: data[key] for key in ("standard_error", "coherence") if key in data}
    if (covariance := data.get("covariancedata")) is not None and np.ndim(covariance) == 5:
        more["standard_error"] = np.moveaxis(np.sqrt(0.5 * (covariance[..., 0, 0] + covariance[..., 1, 1])), 2, 0)
    frequency = f * _factor(path, name, _texts(units)[0], PER_SECOND)
    return {"frequency": frequency, "response": np.moveaxis(values, 2, 0), "sample_time": step or None, **names, **more}


def _texts(value: Any) -> tuple[str, ...]:
    """Texts of a cell array, or a single one."""
    return tuple(str(np.ravel(each)[0]) if np.size(each) else "" for each in np.ravel(np.asarray(value, object)))
