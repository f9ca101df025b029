"""The results of a sweep: kept case by case while it runs, and at its end a table, a data frame, a picture, or a Parquet file.

In a folder, each finished case is a line of ``journal.csv`` while the sweep runs. At the end the lines, in the order of the cases,
become ``sweep.csv``: the same bytes whatever was interrupted, and by however many processes. A sweep with other scene, cases or
metrics doesn't continue one in a folder.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import OutputFolder, write_pieces, write_whole
from flexfmu.cosim.engine.formats import write_arrays
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.showing import Rows, cell_text, safe_cell, shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.many.journal import Journal, difference
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, OF_BOTH, MetricDefinition, definition, display, metric
from flexfmu.cosim.reports.chart import INK, PALETTE, Curve, Panel
from flexfmu.cosim.reports.page import FIRST_METRICS, TILES, Page, Plot, Table
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.studies.sweep.cases import Cases, short_text, text_of
from flexfmu.cosim.studies.sweep.work import Row
from flexfmu.model.scene.keys import value_at
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOTS = 12
"""Metrics that the page draws."""

MANIFEST, JOURNAL, TABLE, SIGNALS = "sweep.json", "journal.csv", "sweep.csv", "signals"
"""What is swept, finished cases while the sweep runs, all of them at its end, and the folder of recorded signals."""


@dataclass(frozen=True, eq=False, repr=False)
class SweepResult(Rows, Sequence[dict[str, Any]]):
    """The cases of a sweep with their metrics, in SI units: a sequence of rows, each a dict from key or metric to value.

    Attributes:
        name: of the scene.
        cases: what was varied.
        metrics: names of the metrics.
        values: (N, M) the metrics of each case; NaN where one has no value, or where the case failed.
        messages: number of a failed case → why it failed.
        units: key or metric → unit; empty for none.
        recordings: number of a case → recorded signals, where they are in memory.
        folder: where the results are; None where they are in memory alone.
        scene: what was swept; None for a model from equations.
    """

    row_name = "case"

    name: str
    cases: Cases
    metrics: tuple[str, ...]
    values: RealArray
    messages: Mapping[int, str]
    units: Mapping[str, str]
    recordings: Mapping[int, Recording]
    folder: Path | None = None
    scene: Scene | None = None

    def __len__(self) -> int:
        return len(self.cases)

    def __getitem__(self, number: Any) -> Any:
        """The row of a case: ``case``, the keys, the metrics (`flexfmu.Metric`, None for no value) and ``message``."""
        if isinstance(number, slice):
            return [self[i] for i in range(*number.indices(len(self)))]
        if not -len(self) <= number < len(self):
            raise IndexError(f"the sweep has {len(self)} cases, there is no number {number}")
        found = self._row(number % len(self))
        return found | {
            name: metric(name, found[name]) for name in self.metrics if found[name] is not None and "." not in name
        }

    def _row(self, number: int) -> dict[str, Any]:
        """The row of a case with plain numbers."""
        found = [None if value != value else value for value in self.values[number].tolist()]
        return {
            "case": number,
            **dict(zip(self.cases.keys, self.cases.rows[number], strict=True)),
            **dict(zip(self.metrics, found, strict=True)),
            "message": self.messages.get(number, ""),
        }

    @property
    def failed(self) -> list[dict[str, Any]]:
        """The rows of the cases that failed."""
        return [self[number] for number in sorted(self.messages)]

    def recording(self, number: int) -> Recording:
        """The recorded signals of a case.

        Raises:
            InputError: nothing was recorded of it.
            ResultsError: its file can't be read.
        """
        if number in self.recordings:
            return self.recordings[number]
        if self.folder is None or not signal_file(self.folder, number).exists():
            raise InputError(
                f"nothing was recorded of case {number}: ask for signals by `record`, and see its `message`"
            )
        return Recording.read_csv(signal_file(self.folder, number))

    def rows(self) -> Sequence[dict[str, Any]]:
        """The rows of all cases, with plain numbers."""
        return [self._row(number) for number in range(len(self))]

    def row_columns(self) -> Mapping[str, Any]:
        """Number, keys, metrics (NaN for no value) and message of all cases."""
        return {
            "case": range(len(self)),
            **dict(zip(self.cases.keys, self.columns(), strict=True)),
            **dict(zip(self.metrics, self.values.T, strict=True)),
            "message": [self.messages.get(number, "") for number in range(len(self))],
        }

    def row_units(self) -> Mapping[str, str]:
        """Key or metric → unit."""
        return {name: unit for name, unit in self.units.items() if unit}

    def columns(self) -> list[list[Any]]:
        """The values of each key, one for each case."""
        return [list(each) for each in zip(*self.cases.rows, strict=True)]

    def plot(self) -> Figure:
        """The metrics over the varied keys: lines for one key, heat maps for two, parallel coordinates for more."""
        from flexfmu.cosim.studies.sweep.picture import draw_cases

        def labelled(label: str, unit: str) -> str:
            return f"{label} [{unit}]" if unit else label

        units = {key: shown_unit(self.units.get(key, "")) for key in self.cases.keys}
        pairs = zip(self.cases.keys, self.columns(), strict=True)
        keys = {labelled(key, units[key]): column for key, column in pairs}
        metrics = [self._definition(name) for name in self.metrics]
        titles = [labelled(each.label, each.display_unit) for each in metrics]
        values = self.values * [each.displayed(1.0) for each in metrics]
        failed = f", {len(self.messages)} failed" if self.messages else ""
        return draw_cases(f"{self.name}: {len(self)} cases{failed}", keys, titles, values)

    def summary(self) -> dict[str, dict[str, Any]]:
        """Smallest, median and largest value of each metric, the cases of the extremes with their values, and the number of values."""
        found = dict[str, dict[str, Any]]()
        for i, name in enumerate(self.metrics):
            column = self.values[:, i]
            there = np.flatnonzero(~np.isnan(column))
            if not there.size:
                continue
            found[name] = {"unit": self.units.get(name, ""), "count": int(there.size)}
            for end, pick in (("min", np.argmin), ("max", np.argmax)):
                case = int(there[pick(column[there])])
                at = {end: float(column[case]), f"{end}_case": case, f"{end}_values": self.cases.changes(case)}
                found[name] |= at
            found[name]["median"] = float(np.median(column[there]))
        return found

    def table(self) -> Table:
        """The extremes and the median of each metric, and where the extremes are."""
        rows = [
            [
                ALL_METRICS[name].label if name in ALL_METRICS else "", name, shown_unit(each["unit"]), f"{each['min']:.4g}",
                self.case_text(each["min_case"]), f"{each['median']:.4g}", f"{each['max']:.4g}", self.case_text(each["max_case"]),
            ]
            for name, each in self.summary().items()
        ]  # fmt: skip
        title = f"{self.name}: {len(self)} cases over {', '.join(self.cases.keys)}"
        return Table(title, ["Metric", "Name", "Unit", "Smallest", "At", "Median", "Largest", "at"], rows)

    def page(self, *, live: bool = False) -> str:
        """Return the page of the sweep as HTML: extremes, and each metric over the varied keys.

        Args:
            live: whether the page simulates the scene at a point that is picked, and by sliders of the varied keys; it needs ziglang.

        Raises:
            InputError: a model from equations was swept, which has no such page.
            MissingCompilerError: there is no ziglang, which compiles the scene for the page.
        """
        found, names = (
            self.summary(),
            [name for each in FIRST_METRICS if (name := OF_BOTH.get(each, [each])[0]) in self.metrics],
        )
        shown = [name for name in dict.fromkeys([*names, *self.metrics]) if name in found][:PLOTS]
        tiles = [
            (f"{definition(name).label}, from smallest to largest", [display(name, found[name][end], 4) for end in ("min", "max")])
            for name in shown[:TILES]
            if name in ALL_METRICS
        ]  # fmt: skip
        failed = f"{len(self.messages)} of {len(self)} cases failed, the first with {self.case_text(min(self.messages, default=0))}."
        sentences = [text for name in shown if (text := self._span(name))]
        verdict = " ".join(
            [*(sentences[:2] or ["No metric changes."] * bool(found)), *([failed] if self.messages else [])]
        )
        numbers = {
            key: column
            for key, column in zip(self.cases.keys, self.columns(), strict=True)
            if all(isinstance(each, int | float) and not isinstance(each, bool) for each in column)
        }
        plots = [self._plot(name, numbers) for name in shown]
        frame = {"folded": []} if self.scene is None else of_scene(self.scene)
        frame["folded"] = [self.table(), *frame["folded"]]
        page = Page(f"{self.name}: sweep", [verdict or "No case has a value."], plots, tiles=tiles, **frame)
        if live:
            from flexfmu.cosim.exchange.live import swept_page  # which few sweeps need

            if self.scene is None:
                raise InputError(f"the page of {self.name} can't simulate: it is no scene")
            spans = {key: (min(numbers[key]), max(numbers[key])) if key in numbers else None for key in self.cases.keys}
            data = self.scene.model_dump(mode="json", exclude_none=True)
            own = {key: short_text(value_at(data, key)) for key in spans}
            page = swept_page(page, self.scene, spans, own, shown[:TILES])
        return page.html

    def _definition(self, name: str) -> MetricDefinition:
        """What a metric is; of a model from equations, values of outputs have their own names and units."""
        unit = self.units.get(name, "")
        return ALL_METRICS.get(name) or MetricDefinition(name, unit, "", display=(unit, float))

    def _span(self, name: str) -> str:
        """From where to where a metric goes, in a sentence; empty for one that doesn't change."""
        info, each = self._definition(name), self.summary()[name]
        low, high = (f"{info.displayed(each[end]):.4g} {info.display_unit}".rstrip() for end in ("min", "max"))
        where = [self.case_text(each[end]) for end in ("min_case", "max_case")]
        return "" if low == high else f"{info.label} goes from {low} ({where[0]}) to {high} ({where[1]})."

    def _plot(self, name: str, numbers: Mapping[str, Sequence[float]]) -> Plot:
        """A metric over the first key with numbers: a line for each combination of the others where these are few, otherwise points in the
        colours of some of the others."""
        along = next((key for key, column in numbers.items() if len({*column}) > 1), "case")
        x = np.array(numbers.get(along, range(len(self))), dtype=float)
        info = self._definition(name)
        factor, unit, label = info.displayed(1.0), info.display_unit, info.label
        y = factor * self.values[:, self.metrics.index(name)]
        # by as many of the other keys as there are colours for
        named = [key for key in self.cases.keys if key != along]
        while True:
            groups: dict[str, list[int]] = {}
            for number, row in enumerate(map(self.cases.changes, range(len(self)))):
                groups.setdefault(", ".join(f"{key}={short_text(row[key])}" for key in named if key in row), []).append(
                    number
                )
            if len(groups) <= len(PALETTE):
                break
            named.pop()
        curves = []
        for (text, cases), colour in zip(groups.items(), PALETTE, strict=False):
            order = np.array(cases)[np.argsort(x[cases], kind="stable")]
            more = {f"{key} [{shown_unit(self.units.get(key, ''))}]": np.array(numbers[key])[order] for key in numbers}
            width = 1.4 if np.unique(x[order]).size == order.size else 0.0
            # what neither the legend nor numbers say
            said = [key for key in self.cases.keys if key not in numbers and key not in named]
            rows = (self.cases.changes(i) for i in order)
            notes = [", ".join(f"{key}={short_text(row[key])}" for key in said) for row in rows] if said else ()
            more = more | {f"{label} [{unit}]": y[order]}
            curves.append(Curve(x[order], y[order], text, colour, width, dot="disc", more=more, notes=notes))
        source = {"metric": name, "key": along, "factor": factor}
        curves.append(Curve(np.empty(0), np.empty(0), "", INK, 0.0, dot="cross", is_read=False, source=source))
        panel = Panel(label=f"{label}\n[{unit}]", curves=curves, is_function=False)
        key_unit = shown_unit(self.units.get(along, ""))
        return Plot(
            f"sweep-{name}", label, "A point for each case.", (panel,), f"{along} [{key_unit}]" if key_unit else along
        )

    def case_text(self, number: int) -> str:
        """The values of a case, ``payload.mass=3.2, trajectory.duration=0.4``."""
        return ", ".join(f"{key}={short_text(value)}" for key, value in self.cases.changes(number).items())

    def __repr__(self) -> str:
        shown = ", ".join(self.metrics[:3]) + (f" and {len(self.metrics) - 3} more" if len(self.metrics) > 3 else "")
        first = f", first {self.case_text(min(self.messages))}" if self.messages else ""
        return (
            f"Sweep of {self.name}: {len(self)} cases, {len(self.messages)} failed{first}\n"
            f"  varied:  {', '.join(self.cases.keys)}\n"
            f"  metrics: {shown}\n"
            f"  results: {self.folder or 'in memory'}\n"
            f"  see .to_pandas(), .plot(), .failed, .summary(), [number]"
        )


class Results:
    """The results of a sweep while it runs: in memory, and in the journal of a folder, which has those of an earlier call.

    A context; no other process is in it for the same folder.

    Args:
        cases: of the sweep.
        metrics: their names.
        units: key or metric → unit.
        folder: created if it doesn't exist; None for memory alone.
        manifest: what is swept.
        restart: whether the results of another sweep in the folder are discarded; otherwise they are an error.

    Attributes:
        values: (N, M) metrics; NaN for none.
        messages: number of a failed case → message.
        recordings: number of a case → its signals, without a folder.
        finished: (N,) whether each case is finished.

    Raises:
        InputError: the folder has results of another sweep.
        ResultsError: the folder can't be read or written, or another process works in it.
    """

    def __init__(
        self,
        cases: Cases,
        metrics: Sequence[str],
        units: Mapping[str, str],
        folder: Path | None = None,
        manifest: Mapping[str, Any] | None = None,
        *,
        restart: bool = False,
    ) -> None:
        self.values: RealArray = np.full((len(cases), len(metrics)), np.nan)
        self.messages: dict[int, str] = {}
        self.recordings: dict[int, Recording] = {}
        self.finished = np.zeros(len(cases), bool)
        self._cases, self._folder, self._lock = cases, folder, contextlib.ExitStack()
        titles = (f"{name} [{units[name]}]" if units.get(name) else name for name in (*cases.keys, *metrics))
        self._head = _line(_texts(["case", *titles, "message"]))
        if folder is None:
            return
        self._lock.enter_context(OutputFolder(folder).claimed())
        with contextlib.ExitStack() as after_error:
            after_error.callback(self._lock.close)
            self._journal = Journal(folder / JOURNAL)
            self._begin(folder, json.loads(json.dumps(manifest or {})), restart)
            after_error.pop_all()

    def _begin(self, folder: Path, manifest: dict[str, Any], restart: bool) -> None:
        """Compare the sweep with the one in the folder, and read what is finished."""
        path, table = folder / MANIFEST, folder / TABLE
        before: dict[str, Any] | None = None
        if not restart and path.exists():
            try:
                before = json.loads(path.read_text(encoding="utf-8"))
            except (OSError, ValueError) as error:
                raise ResultsError(f"can't read {path}: {error}; use --restart, or another --out") from error
            if before != manifest:
                raise InputError(
                    f"{folder} has the results of another sweep: {difference(before or {}, manifest)}; choose another --out, "
                    f"or discard them with --restart"
                )
        if before is None:
            if not restart and (self._journal.path.exists() or table.exists()):
                raise InputError(f"{folder} has a {TABLE} without {MANIFEST}: choose another --out, or --restart")
            for name in (MANIFEST, JOURNAL, TABLE, "sweep.parquet", "sweep.png", "sweep.svg", "sweep.html"):
                (folder / name).unlink(missing_ok=True)
            for signals in (folder / SIGNALS).glob("*.csv"):
                signals.unlink()
            write_pieces(path, [json.dumps(manifest, ensure_ascii=False, indent=1), "\n"])
        # the finished cases are in the journal, or in the table at the end
        if table.exists():
            self._journal.path.unlink(missing_ok=True)  # it may have ended between the table and this
        source = Journal(table) if table.exists() else self._journal
        for cells in csv.reader(line.decode() for place, line in source.read() if place):
            try:
                number = int(cells[0])
                self.values[number] = [
                    float(cell) if cell else np.nan for cell in cells[1 + len(self._cases.keys) : -1]
                ]
            except (ValueError, IndexError):
                raise ResultsError(
                    f"{source.path} has a line that is no case: {','.join(cells)[:40]!r}; begin anew with --restart"
                ) from None
            self.finished[number] = True
            if cells[-1]:
                self.messages[number] = cell_text(cells[-1])
        if not source.size:
            self._journal.append(self._head)

    def add(self, rows: Iterable[Row]) -> None:
        """Keep finished cases, in the journal at once, each as a line."""
        lines = []
        for row in rows:
            if self.finished[row.number]:
                continue
            self.values[row.number] = [np.nan if each is None else each for each in row.values]
            if row.message:
                self.messages[row.number] = row.message
            if row.recording is not None and self._folder is None:
                self.recordings[row.number] = row.recording
            elif row.recording is not None and self._folder is not None:
                row.recording.write_csv(signal_file(self._folder, row.number))
            self.finished[row.number] = True
            lines.append(self._case(row.number))
        if self._folder is not None:
            self._journal.append("".join(lines))

    def _case(self, number: int) -> str:
        """The line of a case."""
        keys, message = map(text_of, self._cases.rows[number]), self.messages.get(number, "")
        values = ("" if value != value else repr(value) for value in self.values[number].tolist())
        return _line([str(number), *_texts(keys), *values, *_texts([message])])

    def finish(self) -> None:
        """Write the table of a folder in the order of the cases, and remove the journal."""
        if self._folder is not None and not (self._folder / TABLE).exists():
            write_pieces(self._folder / TABLE, chain([self._head], map(self._case, range(len(self._cases)))))
            # the table is on the disk before the journal goes
            with (self._folder / TABLE).open("rb") as table:
                os.fsync(table.fileno())
            self._journal.path.unlink()

    def __enter__(self) -> Results:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()


def signal_file(folder: Path, number: int) -> Path:
    """File of the recorded signals of a case."""
    return folder / SIGNALS / f"{number:06d}.csv"


def _texts(cells: Iterable[str]) -> list[str]:
    """Cells of texts, which have no line breaks inside and aren't formulas."""
    return [safe_cell(" ".join(each.splitlines())) for each in cells]


def _line(cells: Iterable[str]) -> str:
    """Cells as a line of CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue()


def write_files(result: SweepResult, folder: Path, *, plot: bool, live: bool = False) -> list[Path]:
    """Write Parquet, picture and page; returns the files of the sweep.

    Args:
        result: the finished sweep.
        folder: where its table is.
        plot: whether picture and page are drawn.
        live: whether the page simulates.
    """
    files = [folder / TABLE]
    with contextlib.suppress(ImportError):
        files.append(write_parquet(result, folder / "sweep.parquet"))
    if plot:
        from flexfmu.cosim.reports.figure_style import save

        save(result.plot, folder / "sweep")
        write_whole(folder / "sweep.html", result.page(live=live))
        files += [folder / f"sweep.{ending}" for ending in ("png", "svg", "html")]
    return files


def write_parquet(result: SweepResult, path: Path) -> Path:
    """Write a Parquet table with a column for each key and metric, whose metadata has the unit; atomically.

    Raises:
        ImportError: pyarrow isn't installed.
    """
    import pyarrow

    columns: dict[str, Any] = {}
    for name, values in result.row_columns().items():
        kinds = {type(each) for each in values if each is not None} if name in result.cases.keys else set()
        if kinds - {bool} and kinds - {int, float}:
            values = [None if each is None else text_of(each) for each in values]  # other kinds, or mixed ones
        kind = pyarrow.float64() if kinds == {int, float} or (not kinds and name in result.cases.keys) else None
        columns[name] = pyarrow.array(values, kind, from_pandas=True), result.units.get(name, "")
    return write_arrays(path, columns, {"flexfmu": json.dumps({"scene": result.name, "units": dict(result.units)})})
