"""What an identification found: values with intervals, correlations, tests of the residuals, and what follows for the next commands."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.files import to_json, write_whole
from flexfmu.cosim.engine.showing import Rows, csv_text, few_lines, html_table, shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.reports.chart import INK, PALETTE, Curve, Panel
from flexfmu.cosim.reports.page import TILES, Page, Plot, Table
from flexfmu.cosim.reports.page import Figure as PageFigure
from flexfmu.cosim.reports.spectrum import spectrum, spectrum_caption, spectrum_panel
from flexfmu.errors import read_text
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNLIKELY = 1e-3
"""Probability below which residuals count as dependent on the motion."""

MOVING = 1.2
"""Ratio of the residuals while the signal moves to those while it doesn't, from which on the model counts as wrong."""

CORRELATED = 0.9
"""Correlation of two estimates that is told."""

SAID = 2
"""Estimates and signals in a page's first sentence."""

DRAWS = 200
"""Number of drawn cases in ``draws.csv``."""

PLAN_BANDS = {"material.youngs_modulus": "stiffness_band"} | dict.fromkeys(
    ("damping.ratio", "damping.rate", "damping.time"), "damping_band"
)
"""Parameter → relative band of a plan."""


@dataclass(frozen=True)
class Estimated:
    """A parameter of the model or of a sensor.

    Attributes:
        name: key, or what it is of a sensor.
        unit: in SI.
        start: first value.
        value: estimate, or what it was kept at.
        standard_error: of the value; NaN where it was kept.
        interval: of 95 % confidence; unknown models included where the residuals show that something is missing.
        kept: why it isn't an estimate; empty where it is one.
        profiled: whether the interval is that of the profile likelihood.
        key: of the scene; the name of an FMU's parameter.
    """

    name: str
    unit: str
    start: float
    value: float
    standard_error: float
    interval: tuple[float, float]
    kept: str = ""
    profiled: bool = False
    key: str = ""


@dataclass(frozen=True, eq=False)
class FittedSignal:
    """A measured signal beside the simulated one.

    Attributes:
        log, name, unit: of the signal.
        time: (N,) instants of the log, from its start on [s].
        measured, before, after: (N,) measured values, and simulated ones with the first and the last parameters, as the sensor shows them.
        noise: standard deviation of its noise.
        order: of the noise's model; 0 for white noise.
        whiteness: probability that white noise looks like the whitened residuals.
        independence: probability that residuals which don't depend on the motion look like these.
        moving: ratio of the whitened residuals while the signal moves to those while it doesn't.
        ringing: frequency [Hz] of what rings in the residuals; None for nothing.
        axis: label of the time, or of what stands in its place.
    """

    log: str
    name: str
    unit: str
    time: RealArray = field(repr=False)
    measured: RealArray = field(repr=False)
    before: RealArray = field(repr=False)
    after: RealArray = field(repr=False)
    noise: float
    order: int
    whiteness: float
    independence: float
    moving: float
    ringing: float | None
    axis: str = "time [s]"

    @property
    def is_explained(self) -> bool:
        """Whether the residuals look like noise of a sensor."""
        return self.independence >= UNLIKELY and self.moving < MOVING

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square of measured minus simulated values, before and after."""
        before, after = (float(np.sqrt(np.mean((self.measured - each) ** 2))) for each in (self.before, self.after))
        return before, after


@dataclass(frozen=True)
class Explanation:
    """An effect that the scene lacks, and how well it would explain the residuals.

    Attributes:
        label: the effect in words.
        changes: key → value that adds it.
        share: of the sum of squares of the whitened residuals that it explains, 0 to 1.
        probability: that noise is explained as well.
        shifts: name of a parameter → by how much its estimate would change.
    """

    label: str
    changes: Mapping[str, Any]
    share: float
    probability: float
    shifts: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Rows):
    """Parameters from measurements.

        found.values["payload.mass"], found.estimates[0].interval
        flexfmu.run(found.scene); flexfmu.margins(scene, identified=found)

    Attributes:
        name: of the scene or FMU.
        estimates: the model's parameters.
        sensors: delays, offsets and gains.
        covariance: of the estimates that weren't kept, in their order (n, n).
        signals: the measured signals.
        explanations: effects that the scene lacks, the best first; none where the residuals look like noise, or none was tried.
        messages: what there is to say.
        runs: number of simulations.
        scene: the scene with the values; None for an FMU.
        changes: key of the scene → its new value.
    """

    row_name = "parameter"

    name: str
    estimates: tuple[Estimated, ...]
    sensors: tuple[Estimated, ...]
    covariance: RealArray
    signals: tuple[FittedSignal, ...]
    explanations: tuple[Explanation, ...]
    messages: tuple[str, ...]
    runs: int
    scene: Scene | None = None
    changes: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_explained(self) -> bool:
        """Whether nothing shows that the model lacks something."""
        return not self.explanations and all(each.is_explained for each in self.signals)

    @property
    def values(self) -> dict[str, float]:
        """Name of a parameter → value."""
        return {each.name: each.value for each in self.estimates}

    @property
    def free(self) -> tuple[Estimated, ...]:
        """The estimates that weren't kept."""
        return tuple(each for each in self.estimates if not each.kept)

    @property
    def correlations(self) -> RealArray:
        """Correlations of the estimates that weren't kept (n, n)."""
        errors = np.sqrt(np.diag(self.covariance))
        return self.covariance / np.outer(errors, errors) if errors.size else self.covariance

    def band(self, name: str) -> tuple[float, float]:
        """The interval of a parameter: a ``payload_band`` for `flexfmu.margins`, `flexfmu.tune` and `flexfmu.compare`.

        Raises:
            InputError: it isn't an estimate.
        """
        if (found := next((each.interval for each in self.free if each.name == name), None)) is None:
            names = [each.name for each in self.free]
            raise InputError(f"the identification of {self.name} has no interval of {name}; {suggestion(name, names)}")
        return found

    def plan_bands(self, scene: Scene) -> dict[str, Any]:
        """The bands of a plan that contain the intervals: keywords of `flexfmu.plan_motion`, `payload_band` in kg and fractions about the scene's
        own Young's modulus and damping.

        Raises:
            InputError: a plan can't vary anything that was identified, or an interval is too far from the scene's value.
        """
        found = dict[str, Any]()
        for each, own in zip(self.free, self._own_values(scene), strict=True):
            low, high = each.interval
            if each.name == "payload.mass":
                found["payload_band"] = each.interval
            elif band := PLAN_BANDS.get(each.name):
                found[band] = max(found.get(band, 0.0), abs(low / own - 1.0), abs(high / own - 1.0))
                if found[band] >= 1.0:
                    told = f"{each.name} is {low:.4g} to {high:.4g} as identified, {own:.4g} in scene {scene.name}"
                    raise InputError(
                        f"{told}; bands of a plan stay below 100 %: take the scene that identify writes with -o"
                    )
        if not found:
            raise InputError(f"a plan varies payload, stiffness and damping; none was identified of {self.name}")
        return found

    def _own_values(self, scene: Scene) -> list[float]:
        """A scene's values of what was estimated.

        Raises:
            InputError: its robot lacks one.
        """
        known = {name: each.value for name, each in scene_values(scene).items() if each.value}
        if lacking := next((each.name for each in self.free if each.name not in known), None):
            raise InputError(
                f"scene {scene.name} has no {lacking}, which was identified of {self.name}: take the scene that identify writes with -o"
            )
        return [known[each.name] for each in self.free]

    def robots(self, scene: Scene) -> list[dict[str, float]]:
        """Robots at the edge of what is likely, two for each estimate: values of the FMU's parameters.

        They are sigma points (S. J. Julier, J. K. Uhlmann, Unscented filtering and nonlinear estimation, Proc. IEEE 92 (2004) 401-422), so
        far from the estimates that their convex hull contains the ellipsoid of the joint distribution that the intervals enclose: among them
        a figure that is linear in the parameters is no better than at the worse end of its own interval of 95 % confidence. Each
        parameter's values reach both ends of its interval.

        Raises:
            InputError: the scene's robot lacks a parameter.
        """
        self._own_values(scene)
        free = self.free
        values = np.array([each.value for each in free])
        low, high = np.array([each.interval for each in free]).T
        powers, axes = np.linalg.eigh(self.correlations)
        root = np.sqrt(len(free)) * (axes * np.sqrt(np.maximum(powers, 0.0))) @ axes.T
        steps = np.vstack([root, -root])
        points = values + np.where(steps > 0.0, high - values, values - low) * steps
        points = np.where((points <= 0.0) & (values > 0.0), low, points)
        return [dict(zip((each.name for each in free), row, strict=True)) for row in points.tolist()]

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """The estimates and their covariance from an ``identified.json``.

        Raises:
            InputError: the file can't be read, or is another one.
        """
        try:
            data = json.loads(read_text(Path(path)))
            estimates = [
                Estimated(name, **each | {"standard_error": each["standard_error"] or np.nan, "interval": tuple(each["interval"])})
                for name, each in data["parameters"].items()
            ]  # fmt: skip
            return cls(data["name"], tuple(estimates), (), np.array(data["covariance"]), (), (), (), data["runs"])
        except OSError as error:
            raise InputError(f"can't read {path}: {error.strerror}") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"{path} isn't an identified.json, which flexfmu identify --out DIR writes") from error

    def draws(self, count: int = DRAWS, seed: int = 0) -> list[dict[str, float]]:
        """Parameters drawn from their joint distribution, cases for `flexfmu.sweep`; none leaves what is allowed."""
        free = self.free
        if not free:
            return []
        errors = np.array([each.standard_error for each in free])
        drawn = np.random.default_rng(seed).multivariate_normal(np.zeros(len(free)), self.correlations, count)
        values = np.array([each.value for each in free]) + errors * drawn
        positive = np.array([each.value > 0.0 for each in free])
        values = np.where(positive & (values <= 0.0), [each.value for each in free], values)
        return [dict(zip((each.key for each in free), row, strict=True)) for row in values.tolist()]

    def rows(self) -> list[dict[str, Any]]:
        """A row for each parameter of the model, then of the sensors, in SI units."""
        return [
            {
                "parameter": each.name,
                "value": each.value,
                "standard_error": each.standard_error,
                "from": each.interval[0],
                "to": each.interval[1],
                "start": each.start,
                "unit": each.unit,
            }
            for each in (*self.estimates, *self.sensors)
        ]

    def as_data(self) -> dict[str, Any]:
        """Plain data in SI units, the content of ``identified.json``."""

        def described(each: Estimated) -> dict[str, Any]:
            error = each.standard_error if np.isfinite(each.standard_error) else None
            found = {"value": each.value, "standard_error": error, "interval": [*each.interval], "unit": each.unit}
            return found | {"start": each.start} | ({"kept": each.kept} if each.kept else {})

        return {
            "name": self.name,
            "parameters": {each.name: described(each) | {"key": each.key} for each in self.estimates},
            "sensors": {each.name: described(each) for each in self.sensors},
            "correlations": {"parameters": [each.name for each in self.free], "matrix": self.correlations.tolist()},
            "covariance": self.covariance.tolist(),
            "signals": [
                {
                    "log": each.log,
                    "signal": each.name,
                    "unit": each.unit,
                    "samples": each.time.size,
                    **dict(zip(("rms_before", "rms_after"), each.rms, strict=True)),
                    "noise_order": each.order,
                    **{key: getattr(each, key) for key in ("noise", "whiteness", "independence", "moving", "ringing")},
                }
                for each in self.signals
            ],
            "explanations": [
                {"effect": each.label, "changes": each.changes, "share": each.share, "probability": each.probability}
                for each in self.explanations
            ],
            "messages": [*self.messages],
            "runs": self.runs,
        }

    def __repr__(self) -> str:
        """Return at most five lines: the values with their standard errors."""
        items = [f"{each.name} = {_with_error(each)}" for each in self.estimates]
        return few_lines(f"{self.name} from {len({each.log for each in self.signals})} logs:", items)

    def tables(self) -> Iterator[Table]:
        """Yield the tables of the page and of the terminal."""
        logs = {each.log for each in self.signals}
        only = f" of {next(iter(logs))}" if len(logs) == 1 else " of the logs"
        for title, group in (("Parameters", self.estimates), ("Sensors", self.sensors)):
            rows = [
                [
                    each.name.removesuffix(only),
                    _with_error(each),
                    "–" if each.kept else f"{each.interval[0]:.4g} to {each.interval[1]:.4g}",
                    f"{each.start:.4g}",
                    shown_unit(each.unit),
                    each.kept,
                ]
                for each in group
            ]
            note = "Value ± standard error; the interval is of 95 % confidence."
            if any(each.profiled for each in group):
                note += " Unsymmetrical ones are those of the profile likelihood."
            header = ["Name", "Value", "Interval", "Start", "Unit", ""]
            if not any(each.kept for each in group):
                header, rows = header[:-1], [row[:-1] for row in rows]
            if rows:
                yield Table(title, header, rows, note, 1 if len(header) > 5 else 0)
        pairs = [
            [a.name, b.name, f"{self.correlations[i, j]:+.3f}".replace("-", "−")]
            for i, a in enumerate(self.free)
            for j, b in enumerate(self.free[:i])
            if abs(self.correlations[i, j]) >= CORRELATED
        ]
        if pairs:
            yield Table("Strong correlations", ["Parameter", "with", "Correlation"], pairs)
        rows = [
            [
                f"{each.name} of {each.log}".removesuffix(only),
                *(f"{value:.4g} {shown_unit(each.unit)}".rstrip() for value in each.rms),
                "white" if each.order == 0 else f"order {each.order}",
                f"{each.independence:.2g}",
                f"{each.moving:.3g}",
            ]
            for each in self.signals
        ]
        note = "Independence: probability that residuals independent of the motion look like these. Moving: residuals in motion over those at rest."
        yield Table(
            "Measured minus simulated", ["Signal", "RMS before", "after", "Noise", "Independence", "Moving"], rows, note
        )
        rows = [
            [
                each.label,
                f"{100.0 * each.share:.3g} %",
                f"{each.probability:.2g}",
                "; ".join(f"{key} {value:+.3g}" for key, value in each.shifts.items()),
            ]
            for each in self.explanations
        ]
        if rows:
            yield Table(
                "Effects that would explain residuals",
                ["Effect", "Explains", "By chance", "Estimates would change by"],
                rows,
                texts=1,
            )

    def html_tables(self) -> str:
        """The tables of a notebook."""
        return "".join(html_table(table.header, table.rows) for table in self.tables())

    def page(self) -> str:
        """The page: what was found, and whether it fits better, tables, measured and simulated signals, residuals and their spectra, as HTML."""
        # the estimates that changed most, and the signals that fit worst, come first
        moved = sorted(self.free, key=lambda each: -abs(each.value - each.start) / (abs(each.start) or 1.0))
        values = [f"{_with_error(each)} {shown_unit(each.unit)}".rstrip() for each in moved]
        said = zip(moved, values, strict=True)
        tiles: list[tuple[str, Sequence[str]]] = [
            (f"{each.name}, {each.start:.4g} before", [text]) for each, text in said
        ]
        verdict = [" and ".join(f"{each.name} is {text}" for each, text in zip(moved[:SAID], values, strict=False))]
        residuals = list[tuple[str, Sequence[str]]]()
        for each in sorted(self.signals, key=lambda each: each.rms[0] / (each.rms[1] or 1.0)):
            before, after = (float(f"{value:.4g}") for value in each.rms)
            text, is_worse = f"{before:g} → {after:g} {shown_unit(each.unit)}".rstrip(), after > before
            worse = PageFigure.said(f"{text}{', worse' if is_worse else ''}", is_over=is_worse)
            residuals.append((f"{each.name}, RMS of measured minus simulated", [worse]))
        for (label, (text,)), join in zip(residuals[:SAID], ("; ", ", "), strict=False):
            verdict += [f"{join}{label} ", text]
        tiles[max(TILES - len(residuals), SAID) :] = residuals
        verdict.append(" ".join([".", *self.messages]))
        return Page(f"{self.name}, identified", verdict, [*self.plots()], [*self.tables()], tiles[:TILES]).html

    def write(self, folder: str | os.PathLike[str]) -> Path:
        """Write identified.html, identified.json, and draws.csv for `flexfmu sweep --cases`, into a folder; return its path.

        Raises:
            ResultsError: a file can't be written, with the system's reason.
        """
        target = Path(folder)
        write_whole(target / "identified.html", self.page())
        write_whole(target / "identified.json", to_json(self.as_data()))
        if draws := self.draws():
            write_whole(target / "draws.csv", csv_text(draws))
        return target

    def plot(self) -> Figure:
        """Measured and simulated signals over each other, and what is left."""
        from flexfmu.cosim.reports.figure_style import figure_of

        return figure_of(self.plots(), columns=2)

    def plots(self) -> Iterator[Plot]:
        """Yield measured and simulated signals with what is left, and its spectrum."""
        caption = "Measured, and simulated with the first and the identified parameters."
        for number, each in enumerate(self.signals):
            simulated = (each.before, "before", PALETTE[1]), (each.after, "after", PALETTE[0])
            lines = [(each.time, each.measured, "measured", INK), *((each.time, *line) for line in simulated)]
            left = [(each.time, each.measured - y, label, colour) for y, label, colour in simulated]
            title, groups = f"{each.name} of {each.log}", {each.name: lines, "residual": left}
            unit = shown_unit(each.unit)
            yield from fitted_plots(f"signal-{number}", title, caption, unit, groups, "residual", x_label=each.axis)


Line = tuple[RealArray, RealArray, str, str]
"""Instants (N,), values (N,), label and colour of a curve."""


def fitted_plots(
    key: str,
    title: str,
    caption: str,
    unit: str,
    groups: Mapping[str, Sequence[Line]],
    ringing: str,
    x_label: str = "time [s]",
) -> Iterator[Plot]:
    """Yield the plot of a measured signal beside simulated ones, and of their differences, and over time the spectra of either.

    Args:
        key, title, caption: of the plot.
        unit: of all values, as it is shown.
        groups: what each panel shows → its lines.
        ringing: the group of which spectra are shown; none of lines that are too short.
        x_label: of the horizontal axis.
    """
    panels = [Panel(f"{what}\n[{unit}]", [Curve(*line) for line in lines]) for what, lines in groups.items()]
    yield Plot(key, title, caption, tuple(panels), x_label, 260.0)
    found = [(spectrum(x, y, float(x[0])), *look) for x, y, *look in groups[ringing] if x_label.startswith("time")]
    if spectra := [Curve(*each, *look) for each, *look in found if each is not None]:
        panel, text = spectrum_panel(f"{ringing}\n[{unit}]", spectra), spectrum_caption(f"Amplitudes of {ringing}")
        yield Plot(f"{key}-spectrum", f"Spectrum of {title}", text, (panel,), "frequency [Hz]")


def identified_robots(
    scene: Scene, source: Identification | str | os.PathLike[str] | None
) -> Sequence[Mapping[str, float]]:
    """The robots of an identification, or of its ``identified.json``; none for None. Errors as for `Identification.robots` and `read`."""
    if source is None:
        return ()
    return (source if isinstance(source, Identification) else Identification.read(source)).robots(scene)


def _with_error(each: Estimated) -> str:
    """A value with its standard error, in two digits of that."""
    if not np.isfinite(each.standard_error) or each.standard_error <= 0.0:
        return f"{each.value:.6g}"
    digits = max(1, int(np.floor(np.log10(max(abs(each.value), each.standard_error) / each.standard_error))) + 2)
    return f"{each.value:.{min(digits, 12)}g} ± {each.standard_error:.2g}"


def joined(names: Sequence[str]) -> str:
    """Names in a sentence: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
