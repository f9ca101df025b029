"""`flexfmu paper`: computes every table and figure of the paper and writes each as soon as it is known, as files, one offline page, and
on a terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any
from urllib.parse import quote

from rich.console import Console
from rich.text import Text

from flexfmu.cosim.engine.files import RESULTS, OutputFolder, to_json
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.reports.figure_style import save
from flexfmu.cosim.reports.page import TILES, Page, Table, render
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.reports.summary import versions
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.cosim.studies.paper.figures import SIMULATED_FIGURES, TRAJECTORY_FIGURES, PaperFigure
from flexfmu.cosim.studies.paper.tables import (
    TABLES,
    TRAJECTORY_SCENE,
    Cell,
    PaperCase,
    PaperTable,
    Quantity,
    Remark,
    SimulatedCase,
    agreement,
    compare,
    count_agreement,
    evaluators,
    printed_table,
    read_data,
    simulate,
    simulated_cases,
)
from flexfmu.model.scene.file import load_scene

DEFAULT_FOLDER = RESULTS / "paper"
"""Default folder of the results."""

KEPT = " !$'()*+,-./:;=?@[]_~"
"""Characters of a data URL that aren't encoded, nor special within double quotes; base64 would be a third longer."""

GRADE_COLOURS = {"close": "green", "near": "yellow", "far": "red", "misprint": "bright_black"}
"""Colours of cells on a terminal."""

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class PaperReport:
    """The results computed so far.

    Attributes:
        tables: comparisons in the order of the report.
        figures: the figures drawn, in the order of the report; the overview, which sums the experiment up, comes last.
        timing: wall-clock time of the parts in seconds.
        versions: versions of packages, platform and compiler; None if unknown.
    """

    tables: tuple[PaperTable, ...] = ()
    figures: tuple[PaperFigure, ...] = ()
    timing: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str | None] = field(default_factory=dict)

    def table(self, key: str) -> PaperTable:
        """A table by the key of its data file, for example ``table-07``; KeyError if it has not been computed."""
        return {table.key: table for table in self.tables}[key]

    @property
    def cells(self) -> list[Cell]:
        """The cells of all tables."""
        return [cell for table in self.tables for cell in table.cells]

    def summary(self) -> str:
        """The agreement over all tables in one sentence."""
        return f"All tables: {agreement(self.cells)}"

    def to_json(self) -> str:
        """The whole report as JSON; figures in the unit of their quantity."""
        source = read_data("source")
        return to_json(
            {
                "source": {"citation": citation(), "doi": source["doi"], "url": source["url"]},
                "remarks": source["remarks"],
                "agreement": count_agreement(self.cells),
                "tables": [_table_data(table) for table in self.tables],
                "figures": [figure._asdict() for figure in self.figures if figure.key != "overview"],
                "timing": dict(self.timing),
                "versions": dict(self.versions),
            }
        )

    def to_html(self, folder: Path) -> str:
        """The page, with the figures that were written to a folder embedded: one file is the whole report."""

        def embedded(figure: PaperFigure) -> dict[str, Any]:
            # identifiers of different figures can't clash in data URLs
            text = (folder / figure.file(".svg")).read_text(encoding="utf-8").replace('"', "'")
            # without indentation, to a hundredth of a point
            drawing = re.sub(r"(\.\d\d)\d+(?=[ '])", r"\1", re.sub(r"\s+", " ", text))
            return figure._asdict() | {"image": f"data:image/svg+xml,{quote(drawing, safe=KEPT)}"}

        figures = {figure.key: embedded(figure) for figure in self.figures}
        return render(
            "paper.html.j2",
            source={"citation": citation(), **read_data("source")},
            tables=self.tables,
            marks=marks,
            footnotes=footnotes,
            agreement=agreement,
            overview=figures.pop("overview", None),
            figures=[*figures.values()],
            page=self._page(),
        )

    def _page(self) -> Page:
        """What the report has in common with other pages."""
        found = count_agreement(self.cells)
        tiles = {"cells compared": found["compared"]}
        tiles |= {f"within {100.0 * float(bound):g} %": count for bound, count in found["within"].items()}
        tiles |= {"to the printed digits": found["to_the_digits"], "misprinted, not counted": found["misprinted"]}
        times = [[name, f"{seconds:.1f} s"] for name, seconds in self.timing.items()]
        versions = [[name, version or "unknown"] for name, version in self.versions.items()]
        frame = of_scene(load_scene(TRAJECTORY_SCENE))
        frame["folded"] += [
            Table(title, (), rows) for title, rows in (("Wall-clock times", times), ("Versions", versions)) if rows
        ]
        title = "The paper's experiment, printed and computed"
        return Page(title, [self.summary()], tiles=[(name, [f"{n}"]) for name, n in tiles.items()][:TILES], **frame)

    def write(self, folder: Path) -> None:
        """Write what is known: page and JSON.

        Raises:
            ResultsError: the folder can't be written.
        """
        OutputFolder(folder).write("paper.json", self.to_json())
        OutputFolder(folder).write("report.html", self.to_html(folder))


def run_paper(out: Path = DEFAULT_FOLDER, *, progress: ShowProgress = quiet) -> PaperReport:
    """Run the paper's experiment and write tables and figures.

    Results are written as soon as they are computed, so that an interrupted run keeps those it has.
    ``out`` gets ``report.html``, ``paper.json``, ``simulations.csv`` (every metric of every simulation), ``figures/*.png|svg`` and
    ``overview.png|svg``.

    Args:
        out: folder of the results, created if missing.
        progress: called with the current activity and the finished fraction.

    Returns:
        The report: `to_json()`, and `print_report` for a terminal.

    Raises:
        PaperError: a simulation failed.
        ResultsError: ``out`` can't be written.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    OutputFolder(out).prepare()
    tables = [printed_table(key) for key in TABLES]
    report, started = PaperReport(versions=versions()), perf_counter()

    def add(stage: str, tables: Iterable[PaperTable] = (), figures: Iterable[PaperFigure] = ()) -> None:
        nonlocal report, started
        timing = {**report.timing, stage: perf_counter() - started}
        drawn, compared = (*report.figures, *figures), (*report.tables, *tables)
        report = replace(report, tables=compared, figures=drawn, timing=timing)
        report.write(out)
        started = perf_counter()

    # what needs no simulation
    progress("tables of the trajectories", 0.0)
    add("trajectory tables", [compare(table, evaluators()) for table in tables[:3]])
    for index, (figure, drawing) in enumerate(TRAJECTORY_FIGURES.items()):
        progress(figure.label, 0.10 + 0.02 * index)
        save(drawing, out / figure.file())
    add("trajectory figures", figures=TRAJECTORY_FIGURES)
    progress("natural frequencies along the path", 0.25)
    add("frequencies", [compare(tables[3], evaluators())])
    # tables about simulations, each with the evaluators of its own scene
    simulations = simulate_cases(simulated_cases(tables), out, progress)
    compared = [compare(table, evaluators(simulations, table.scene)) for table in tables[4:]]
    # one FMU serves all simulations, so its versions are those of every table
    report = replace(report, versions=versions(next(iter(simulations.values())).fmu_path))
    for index, (figure, draw) in enumerate(SIMULATED_FIGURES.items()):
        progress(figure.label, 0.95 + 0.02 * index)
        save(partial(draw, simulations, compared), out / figure.file())
    add("simulations", compared, SIMULATED_FIGURES)
    progress("done", 1.0)
    return report


def simulate_cases(
    cases: tuple[PaperCase, ...], out: Path, progress: ShowProgress
) -> Mapping[PaperCase, SimulatedCase]:
    """Simulate the cases, and write all metrics (SI units) to ``simulations.csv`` after each of them, one line each.

    Raises:
        PaperError, ResultsError, BuildError: as `run_paper`.
    """
    done: dict[PaperCase, SimulatedCase] = {}
    lines = [",".join(("scene", "profile", "curve", *METRICS, "simulation_time"))]
    progress("building the FMU", 0.30)
    for case, found in simulate(cases):
        done[case] = found
        # nine digits, so that files of equal runs are equal
        values = [*(found.metrics[name] for name in METRICS), found.simulation_time]
        lines.append(",".join((*case, *("" if value is None else f"{value:.9g}" for value in values))))
        OutputFolder(out).write("simulations.csv", "\n".join(lines) + "\n")
        progress(f"simulated {', '.join(case)}", 0.30 + 0.65 * len(done) / len(cases))
    return done


def citation() -> str:
    """The paper in one line."""
    source = read_data("source")
    event = f"{source['event']}, paper {source['number']}, doi:{source['doi']}"
    return f"{', '.join(source['authors'])}: {source['title']}. {event}"


def _remarks(table: PaperTable) -> list[Remark]:
    """The remarks on all quantities, which are numbered from 1 in this order."""
    return [remark for quantity in table.quantities for remark in quantity.remarks]


def footnotes(table: PaperTable) -> list[tuple[str, str]]:
    """Mark and text of each remark of a table."""
    texts = (f"{remark.verdict.capitalize()}: {remark.text}" for remark in _remarks(table))
    return [(str(number).translate(_SUPERSCRIPTS), text) for number, text in enumerate(texts, 1)]


def marks(table: PaperTable, of: Quantity | Cell) -> str:
    """The numbers of the remarks on a cell; those on all cells of a quantity stand at its heading alone."""
    # by identity, since two quantities may have remarks of the same wording
    general = isinstance(of, Quantity)
    wanted = {id(remark) for remark in of.remarks if (not remark.rows and not remark.columns) == general}
    numbers = (str(number) for number, remark in enumerate(_remarks(table), 1) if id(remark) in wanted)
    return " ".join(numbers).translate(_SUPERSCRIPTS)


def _table_data(table: PaperTable) -> dict[str, Any]:
    """A table for JSON; ``paper`` and ``computed`` in the quantity's unit."""

    def cell_data(cell: Cell) -> dict[str, Any]:
        return {
            "row": cell.row,
            "column": cell.column,
            "paper": float(cell.printed),
            "printed": cell.printed,
            **{key: getattr(cell, key) for key in ("computed", "relative_error", "agrees_to_the_digits", "believable")},
            "remarks": [{"verdict": remark.verdict, "text": remark.text} for remark in cell.remarks],
        }

    quantities = [
        {name: getattr(quantity, name) for name in ("name", "metric", "unit", "meaning")}
        | {"cells": [cell_data(cell) for cell in quantity.cells]}
        for quantity in table.quantities
    ]
    head = {"key": table.key, "label": table.label, "title": table.title, "scene": table.scene or None}
    return head | {"remarks": list(table.remarks), "quantities": quantities}


def print_report(report: PaperReport, console: Console) -> None:
    """Print every table of a report, its footnotes and the summary: cells as paper → computed (relative error), in colours."""
    console.print(Text(citation(), style="italic"))
    for table in report.tables:
        console.print(Text(f"\n{table.label}. {table.title}", style="bold"))
        for remark in table.remarks:
            console.print(Text(remark, style="italic"))
        # a table for each quantity
        for quantity in table.quantities:
            title = f"{quantity.name} [{quantity.unit}]{marks(table, quantity)}: paper → computed"
            shown = titled_table(title, "", numbers=quantity.columns)
            for row, cells in quantity.lines():
                texts = []
                for cell in cells:
                    difference = cell.difference().replace("\N{NO-BREAK SPACE}", "")  # rich would break the line there
                    end = f" ({difference}){marks(table, cell) or ' '}", GRADE_COLOURS[cell.grade]
                    paper = cell.printed, "" if cell.believable else "strike"
                    texts.append(Text.assemble(paper, " → ", (cell.rounded(), "bold"), end))
                shown.add_row(row, *texts)
            console.print(shown)
        # what the marks mean, and how well the table agrees
        for mark, text in footnotes(table):
            console.print(Text(f"{mark} {text}", style="dim"))
        console.print(Text(agreement(table.cells), style="bold"))
    console.print(Text(f"\n{report.summary()}", style="bold"))
