"""Measured frequency responses: read and written, with their modes, the margins of a loop that they are of, and their picture."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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
from flexfmu.cosim.engine.showing import UNITS, Rows, csv_text
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
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

    row_name = "frequency"

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
        with replacing(path) as file:
            if path.suffix.lower() == ".csv":
                rows = [
                    {"frequency [Hz]" if name == "frequency" else name: each for name, each in row.items()}
                    for row in self.rows()
                ]
                rows = [
                    {name: each for name, each in row.items() if not name.endswith((" magnitude", " phase"))}
                    for row in rows
                ]
                note = "" if self.sample_time is None else f"# sample time {self.sample_time!r} s\n"
                file.write_text(note + csv_text(rows), encoding="utf-8")
                return path
            from scipy.io import savemat

            arrays = {"standard_error": self.standard_error, "coherence": self.coherence}
            savemat(
                file,
                {
                    "ResponseData": np.moveaxis(self.response, 0, 2), "Frequency": self.frequency, "FrequencyUnit": "Hz",
                    "Ts": self.sample_time or 0.0, "InputName": np.array(self.inputs, object), "OutputName": np.array(self.outputs, object),
                    **{name: each for name, each in arrays.items() if each is not None},
                }, appendmat=False,
            )  # fmt: skip
        return path

    def rows(self) -> list[dict[str, Any]]:
        """A row for each frequency: of each pair real and imaginary part, magnitude, phase [rad], and what is known of their errors."""
        found: list[dict[str, Any]] = [{"frequency": f} for f in self.frequency.tolist()]
        for (o, output), (i, name) in ((a, b) for a in enumerate(self.outputs) for b in enumerate(self.inputs)):
            value = self.response[:, o, i]
            parts = {
                "real": value.real,
                "imaginary": value.imag,
                "magnitude": np.abs(value),
                "phase": np.unwrap(np.angle(value)),
            }
            parts |= {} if self.standard_error is None else {"standard error": self.standard_error[:, o, i]}
            parts |= {} if self.coherence is None else {"coherence": self.coherence[:, o]}
            for part, values in parts.items():
                for row, each in zip(found, values.tolist(), strict=True):
                    row[f"{output}/{name} {part}"] = each
        return found

    def row_units(self) -> Mapping[str, str]:
        """Of the columns."""
        return {"frequency": "Hz"} | {f"{o}/{i} phase": "rad" for o in self.outputs for i in self.inputs}

    def at(self, frequency: RealArray, draws: ComplexArray | None = None) -> ComplexArray:
        """The response at frequencies (M,) [Hz] within its band, (M, outputs, inputs), by cubic splines over their logarithms.

        Args:
            frequency: the frequencies.
            draws: responses of the same sizes in place of its own.
        """
        return np.asarray(
            CubicSpline(np.log(self.frequency), self.response if draws is None else draws)(np.log(frequency))
        )

    def drawn(self) -> list[ComplexArray]:
        """`DRAWS` responses with errors of their standard errors, always the same; none where these aren't known."""
        if self.standard_error is None:
            return []
        rng, size = np.random.default_rng(0), self.response.shape
        return [
            self.response + self.standard_error * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
            for _ in range(DRAWS)
        ]

    def to_control(self) -> Any:
        """The response as frequency response data of python-control.

        Raises:
            ImportError: python-control isn't installed.
        """
        import control

        labels = {
            "inputs": [each.replace(".", "_") for each in self.inputs],
            "outputs": [each.replace(".", "_") for each in self.outputs],
        }
        dt = 0 if self.sample_time is None else self.sample_time
        return control.frd(np.moveaxis(self.response, 0, 2), 2.0 * pi * self.frequency, dt=dt, **labels)

    def margins(self) -> LoopMargins:
        """The margins of the loop that this is the open loop's response of, for negative feedback, each with its standard error.

        They are those of a stable loop: whether it is, a response alone can't tell. With several channels they change together.

        Raises:
            InputError: there aren't as many outputs as inputs.
        """
        if len(self.inputs) != len(self.outputs):
            raise InputError(f"a loop has as many outputs as inputs, got {len(self.outputs)} and {len(self.inputs)}")
        channels = np.arange(len(self.inputs))

        def figures(omega: RealArray, draws: ComplexArray | None) -> tuple[float, ...]:
            found = self.at(omega / (2.0 * pi), draws)
            return loop_figures(omega, -found, channels, found)

        between = np.linspace(np.log(self.frequency[:-1]), np.log(self.frequency[1:]), FINER, endpoint=False)
        grid = 2.0 * pi * np.append(np.exp(between.T.ravel()), self.frequency[-1])
        grid[::FINER], last = 2.0 * pi * self.frequency, 2.0 * pi * self.frequency[-1]
        omega = refined(lambda each: -self.at(np.minimum(each, last) / (2.0 * pi)), channels, grid)
        drawn = (figures(omega, each) for each in self.drawn())
        return margins_with_errors("loop", figures(omega, None), drawn)

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

    def plot(self) -> Figure:
        """Magnitude with its standard error [dB], phase [degrees] and coherence over the frequency [Hz], a curve for each pair."""
        return _drawn(self)


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
        """A row for each mode."""
        return [
            {
                "frequency": float(each.frequency), "frequency_error": each.frequency.error, "damping_ratio": float(each.damping_ratio),
                "damping_ratio_error": each.damping_ratio.error, "frequency_interval": list(each.frequency_interval),
                "damping_ratio_interval": list(each.damping_interval),
            } for each in self.modes
        ]  # fmt: skip

    def row_units(self) -> Mapping[str, str]:
        """Hz, for frequencies."""
        return {"frequency": "Hz", "frequency_error": "Hz", "frequency_interval": "Hz"}

    def plot(self) -> Figure:
        """The response with its modes."""
        return _drawn(self.response, [float(each.frequency) for each in self.modes])


def _drawn(response: FrequencyResponse, modes: Sequence[float] = ()) -> Figure:
    from flexfmu.cosim.reports.figure_style import GREY, draw, style  # Matplotlib takes longer than most commands

    coherence = response.coherence
    with style():
        figure = draw(8.0, 6.0)
        axes = figure.subplots(2 if coherence is None else 3, 1, sharex=True)
        for o, output in enumerate(response.outputs):
            for i, name in enumerate(response.inputs):
                value = response.response[:, o, i]
                (line,) = axes[0].semilogx(
                    response.frequency, 20.0 * np.log10(np.abs(value)), label=f"{output} / {name}"
                )
                axes[1].semilogx(response.frequency, np.degrees(np.unwrap(np.angle(value))), color=line.get_color())
                if response.standard_error is not None:
                    size, error = np.abs(value), response.standard_error[:, o, i]
                    ends = [20.0 * np.log10(np.maximum(each, 1e-3 * size)) for each in (size - error, size + error)]
                    axes[0].fill_between(response.frequency, *ends, color=line.get_color(), alpha=0.3, linewidth=0.0)
            if coherence is not None:
                axes[2].semilogx(response.frequency, coherence[:, o], label=output)
        for each in axes:
            for frequency in modes:
                each.axvline(frequency, color=GREY, linewidth=0.8, linestyle=":")
        for each, text in zip(axes, ("magnitude [dB]", "phase [°]", "coherence"), strict=False):
            each.set_ylabel(text)
        axes[0].legend(fontsize=7.5)
        axes[-1].set_xlabel("frequency [Hz]")
    return figure


def _from_csv(path: Path) -> dict[str, Any]:
    """The arguments of a response from a CSV file."""
    table = table_of(path)
    usual = {alias: part for part, aliases in PARTS.items() for alias in aliases}
    found: dict[tuple[str, str], dict[str, ComplexArray]] = {}
    frequency = None
    for name, values in table.table.items():
        pair, _, last = name.rpartition(" ") if "/" in name else ("", "", name)
        if pair.endswith(" standard"):
            pair, last = pair.removesuffix(" standard"), "standard error"
        unit, decibel = table.units.get(name, ""), re.fullmatch(r"(.+?)[ _]*db", last.lower())
        if (part := usual.get(decibel[1] if decibel else last.lower())) is None:
            continue
        if part == "frequency":
            unit = unit or ("Hz" if last.lower() in ("frequency", "freq", "f") else "rad/s")
            frequency = values * _factor(path, name, unit, PER_SECOND)
            continue
        if part == "magnitude" and (decibel or unit.lower() == "db"):
            values = 10.0 ** (values / 20.0)
        elif part == "phase":
            values = values * _factor(path, name, unit, {key: UNITS[key][1] for key in ("rad", "deg", "°")})
        output, _, of = pair.partition("/")
        found.setdefault((output or "output", of or "input"), {})[part] = values
    if frequency is None:
        raise SignalFileError(f"{path} has no column `frequency`; columns: {', '.join(table.table)}")
    outputs, inputs = (tuple(dict.fromkeys(pair[k] for pair in found)) for k in (0, 1))
    if not found or len(found) != len(outputs) * len(inputs):
        raise SignalFileError(
            f"{path} has no response for each output and input: columns `real` and `imaginary`, or `magnitude` and `phase [deg]`"
        )
    parts: dict[str, list[Any]] = {"response": [], "standard_error": [], "coherence": []}
    for output, of in ((o, i) for o in outputs for i in inputs):
        given = found[output, of]
        if {"real", "imaginary"} <= given.keys():
            parts["response"].append(given["real"] + 1j * given["imaginary"])
        elif {"magnitude", "phase"} <= given.keys():
            parts["response"].append(given["magnitude"] * np.exp(1j * given["phase"]))
        else:
            raise SignalFileError(
                f"{path} has {', '.join(given)}: a response needs `real` and `imaginary`, or `magnitude` and `phase [deg]`"
            )
        parts["standard_error"].append(given.get("standard error"))
        parts["coherence"] += [given.get("coherence")] if of == inputs[0] else []
    shape = (len(frequency), len(outputs), len(inputs))
    arrays = {
        name: np.stack(each, axis=1).reshape(shape if name != "coherence" else shape[:2])
        for name, each in parts.items() if not any(one is None for one in each)
    }  # fmt: skip
    note = re.match(r"# sample time (\S+) s", path.read_text(encoding="utf-8-sig").partition("\n")[0])
    return {
        "frequency": frequency,
        **arrays,
        "inputs": inputs,
        "outputs": outputs,
        "sample_time": float(note[1]) if note else None,
    }


def _factor(path: Path, name: str, unit: str, known: Mapping[str, float]) -> float:
    if unit not in known:
        raise InputError(
            f"{path}: column {name!r} has the unit {unit!r}; it needs one of {', '.join(known)} in brackets: `{name} [{next(iter(known))}]`"
        )
    return known[unit]


def _from_mat(path: Path) -> dict[str, Any]:
    """The arguments of a response from a .mat file."""
    from scipy.io import loadmat

    try:
        content: Any = loadmat(path, appendmat=False)
    except (OSError, NotImplementedError, ValueError, TypeError) as error:
        raise SignalFileError(f"can't read {path}: {error}; in MATLAB save it with -v7") from error
    # the file itself, or a struct in it
    levels = [content] + [
        {name: each[name].flat[0] for name in each.dtype.names}
        for each in content.values()
        if getattr(each, "dtype", None) is not None and each.dtype.names and each.size
    ]
    for level in levels:
        data = {name.lower(): each for name, each in level.items()}
        values = next((data[name] for name in ("responsedata", "fresp", "frdata", "response") if name in data), None)
        name = next((name for name in ("frequency", "omega", "w", "freq") if name in data), None)
        if values is not None and name is not None:
            break
    else:
        raise SignalFileError(
            f"{path} has no arrays ResponseData and Frequency, nor fresp and omega; save those of an idfrd object: ResponseData = G.ResponseData;"
        )
    f = np.ravel(data[name]).astype(float)
    unit = _texts(
        data.get("frequencyunit", data.get("frequencyunits", data.get("units", "Hz" if name == "freq" else "rad/s")))
    )[0]
    f = f * _factor(path, str(name), unit, PER_SECOND)
    values = np.asarray(values, complex)
    if values.ndim < 3:
        values = values.reshape(-1, len(f)) if len(f) else values
        inputs = len(_texts(data["inputname"])) if "inputname" in data else 1
        values = values.reshape(-1, inputs, len(f)) if len(f) else values
    if values.shape[2:] != f.shape:
        raise SignalFileError(
            f"{path}: a response of the shape {values.shape} for {len(f)} frequencies; it must be (outputs, inputs, frequencies)"
        )
    found: dict[str, Any] = {"frequency": f, "response": np.moveaxis(values, 2, 0)}
    for key, name, size in (("inputs", "inputname", values.shape[1]), ("outputs", "outputname", values.shape[0])):
        texts = _texts(data[name]) if name in data else ()
        usual = tuple(f"{key[:-1]}{k + 1}" for k in range(size)) if size > 1 else (key[:-1],)
        found[key] = texts if len(texts) == size and all(texts) else usual
    if (step := float(np.ravel(data.get("ts", 0.0))[0])) > 0.0:
        found["sample_time"] = step
    if "covariancedata" in data and np.ndim(data["covariancedata"]) == 5:
        covariance = np.asarray(data["covariancedata"], float)
        found["standard_error"] = np.moveaxis(np.sqrt(0.5 * (covariance[..., 0, 0] + covariance[..., 1, 1])), 2, 0)
    return found | {name: data[name] for name in ("standard_error", "coherence") if name in data}


def _texts(value: Any) -> tuple[str, ...]:
    """Texts of a cell array, or a single one."""
    return tuple(str(np.ravel(each)[0]) if np.size(each) else "" for each in np.ravel(np.asarray(value, object)))
