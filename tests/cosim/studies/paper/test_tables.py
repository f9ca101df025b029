"""The paper's tables: complete, compared with figures that are known, laid out, and those that need no simulation against the print."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.studies.paper import report, tables
from flexfmu.cosim.studies.paper.figures import WINDOW, acceleration_spectrum
from flexfmu.cosim.studies.paper.report import PaperReport, footnotes, print_report
from flexfmu.trajectories.trajectory import Trajectory

SHAPES = {
    "table-02": (1, 5),
    "table-05": (1, 12),
    "table-06": (1, 12),
    "frequencies": (1, 6),
    "table-07": (3, 36),
    "table-08": (3, 36),
    "table-09": (3, 36),
    "table-10": (3, 36),
    "table-11": (4, 52),
}
"""Table → number of quantities and of figures, counted in the paper."""

CASES: tuple[tables.PaperCase, ...] = tuple(
    ("barnard2012-6kg", "Bang-bang", curve) for curve in ("Lamé", "Clothoid", "Polar")
)


@pytest.mark.parametrize("key", tables.TABLES)
def test_tables_are_complete(key: str) -> None:
    """A cell lost while typing, a remark on a misspelt row, or a metric that nothing computes would go unnoticed."""
    table, known = tables.printed_table(key), tables.evaluators()
    figures = [figure for quantity in table.quantities for row in quantity.values for figure in row]
    assert (len(table.quantities), len(figures)) == SHAPES[key]
    assert all(float(figure) > 0.0 for figure in figures)
    for quantity in table.quantities:
        assert [len(row) for row in quantity.values] == [len(quantity.columns)] * len(quantity.rows)
        assert quantity.metric in known
        for remark in quantity.remarks:
            assert set(remark.rows) <= set(quantity.rows)
            assert set(remark.columns) <= set(quantity.columns)


def test_corrupt_tables_are_marked_as_such() -> None:
    """Nobody validates against Tables 8 and 10: only the Lamé positions of Table 10 count as printed."""
    found = [compare_with_itself(key) for key in ("table-08", "table-10")]
    cells = ((table.key, each.metric, cell) for table in found for each in table.quantities for cell in each.cells)
    believable = [(key, metric, cell.column) for key, metric, cell in cells if cell.believable]
    assert believable == [("table-10", "end_position_error", "Lamé")] * 4


def test_simulations_are_the_twelve_combinations_twice_and_the_extended_curves() -> None:
    """Every simulation that the tables need is run, and none twice."""
    cases = tables.simulated_cases(map(tables.printed_table, tables.TABLES))
    assert len(cases) == len(set(cases)) == 12 * 2 + 4 * 2
    assert {profile for _, profile, _ in cases} == set(tables.CASES["profiles"])
    assert (
        {curve for _, _, curve in cases}
        == {"Lamé", "Clothoid", "Polar", "Lamé Ext", "Clot. Ext"}
        <= set(tables.CASES["curves"])
    )


def compare_with_itself(key: str, factor: float = 1.0) -> tables.PaperTable:
    """A table compared with its own figures times ``factor``."""
    table = tables.printed_table(key)

    def evaluate(metric: str, row: str, column: str) -> float:
        quantity = table.quantity(metric)
        return (
            factor * float(quantity.values[quantity.rows.index(row)][quantity.columns.index(column)]) / quantity.scale
        )

    metrics = [quantity.metric for quantity in table.quantities]
    return tables.compare(table, {metric: lambda row, column, m=metric: evaluate(m, row, column) for metric in metrics})


def cell(printed: str, computed: float) -> tables.Cell:
    return tables.Cell("row", "column", printed, computed)


@pytest.mark.parametrize(
    ("printed", "computed", "agrees"),
    [
        ("0.3843", 0.38434, True),
        ("0.3843", 0.38436, False),
        ("58", 57.6, True),
        ("58", 57.4, False),
        ("0.09700", 0.097004, True),
        ("0.09700", 0.097006, False),
    ],
)
def test_digits_are_those_printed(printed: str, computed: float, agrees: bool) -> None:
    """A figure agrees to its digits when it rounds to the printed one, trailing zeros included."""
    assert cell(printed, computed).agrees_to_the_digits is agrees


def test_relative_errors_are_signed() -> None:
    """Computed over printed: positive where the computed figure is larger, in every table alike."""
    texts = [cell("1.0", computed).difference() for computed in (1.00123, 0.8477, 13.0, 1.0)]
    assert texts == [f"{each}\N{NO-BREAK SPACE}%" for each in ("+0.12", "−15.2", "+1200", "+0.00")]


def test_a_figure_that_is_not_finite_is_an_error() -> None:
    """NaN would pass every comparison of bounds unnoticed."""
    with pytest.raises(ResultsError, match=r"Table 2, Blend length, Lamé, Length: .* nan"):
        tables.compare(tables.printed_table("table-02"), {"blend_length": lambda row, column: math.nan})


def test_agreement_counts_within_each_bound_and_not_a_misprint() -> None:
    """A cell 3 % off is within 3.5 % and 10 % only; the misprint of Table 7, in millimetres as printed, is marked in its cell and
    explained below the table, and neither agreement nor disagreement with it says anything."""
    assert [*tables.count_agreement([cell("1.0000", 1.03), cell("1.0000", 0.9999)])["within"].values()] == [
        1,
        1,
        1,
        2,
        2,
    ]
    table = compare_with_itself("table-07")
    found = tables.count_agreement(table.cells)
    assert (found["compared"], found["misprinted"], found["to_the_digits"]) == (35, 1, 35)
    assert "1 cell is misprinted and not counted" in tables.agreement(table.cells)
    deflections = table.quantity("peak_modal_deflection_1")
    misprint = deflections.cell("1/8 Trapezoidal", "Polar")
    assert misprint.grade == "misprint"
    assert any("0.15813" in remark.text for remark in misprint.remarks)
    assert any("0.15813" in text for _, text in footnotes(table))
    assert deflections.cell("Bang-bang", "Polar").computed == pytest.approx(0.06681)


def test_files_and_terminal_show_every_cell() -> None:
    """Scripts find paper, computed and relative error of all 36 cells of Table 9; what is printed for people lacks nothing of them."""
    found = PaperReport((compare_with_itself("table-09", 1.01),))
    written = json.loads(found.to_json())
    cells = [c for q in written["tables"][0]["quantities"] for c in q["cells"]]
    assert len(cells) == 36
    assert all(c["relative_error"] == pytest.approx(0.01) for c in cells)
    assert all(c["computed"] == pytest.approx(1.01 * c["paper"]) for c in cells)
    assert "ESDA2012-82197" in written["source"]["citation"]
    console = Console(width=60, record=True, file=io.StringIO())
    print_report(found, console)
    text = console.export_text()
    shown = [f"{cell.printed} → {cell.rounded()}" for cell in found.tables[0].cells]
    assert all(part in text for part in (*shown, "All tables", "Barnard"))


def test_lengths_and_accelerations_agree() -> None:
    """Tables 2, 5 and 6: lengths to five digits, accelerations on the Lamé path within 0.1 and 0.5 %, others as far as known."""
    lengths, task, joint = (
        tables.compare(tables.printed_table(key), tables.evaluators()).quantities[0]
        for key in ("table-02", "table-05", "table-06")
    )
    for curve in ("Lamé", "Polar"):
        assert abs(lengths.cell(curve, "Length").relative_error) < 1e-5
    assert lengths.cell("Extended Lamé", "Length").agrees_to_the_digits
    assert abs(lengths.cell("Extended Clothoid", "Length").relative_error) < 5e-4
    for each in task.cells:
        bound = 0.011 if (each.row, each.column) == ("1/8 Trapezoidal", "Polar") else 0.001
        assert each.column == "Clothoid" or abs(each.relative_error) < bound, each
    for each in joint.cells:
        assert abs(each.relative_error) < (0.005 if each.column == "Lamé" else 0.025), each


def joints_on(curve: str, duration: float = 1.0) -> Trajectory:
    return plan(tables.trajectory_scene(tables.POLYNOMIAL, curve, duration=duration)).joints


def test_a_maximum_is_not_missed_between_samples() -> None:
    """Twice as many samples change no peak by more than 1e-6: the tables' digits don't depend on the sampling."""
    joints = joints_on("Clothoid")
    fine = max(d[2, :, 0].max() for _, d in tables.smooth_pieces(joints, 2 * tables.POINTS))
    assert tables.maximum(joints, lambda d: d[2, :, 0]) == pytest.approx(fine, rel=1e-6)


def test_spectrum_has_the_energy_of_the_motion() -> None:
    """Parseval: the integral of the density is the mean square over the window; Fig. 8 shows one spectrum, since the path is its mirror
    image."""
    joints = joints_on("Lamé")
    (frequency, density), (_, second) = (acceleration_spectrum(joints, joint) for joint in (0, 1))
    energy = sum(np.trapezoid(d[2, :, 0] ** 2, time) for time, d in tables.smooth_pieces(joints, 2001))
    assert np.sum(density) * (frequency[1] - frequency[0]) == pytest.approx(energy / WINDOW, rel=1e-6)
    assert second == pytest.approx(density, rel=1e-6, abs=1e-10 * density.max())


def simulated(cases: Iterable[tables.PaperCase]) -> Iterator[tuple[tables.PaperCase, tables.SimulatedCase]]:
    """Simulations whose metrics are 1, 2, 3, ... in the order of `METRICS`."""
    metrics = {name: float(index) for index, name in enumerate(METRICS, 1)}
    for case in cases:
        yield case, tables.SimulatedCase(metrics, 0.43, np.array([0.0, 0.68]), np.zeros(2), Path("plant.fmu"), 0.2)


def test_shorter_cycles_put_more_energy_at_the_resonance() -> None:
    """The paper's conclusion from Fig. 10: halving the cycle time raises the spectrum at 58 Hz."""
    at_resonance = []
    for duration in (1.0, 0.5, 0.25):
        frequency, density = acceleration_spectrum(joints_on("Lamé", duration), 0)
        at_resonance.append(density[np.abs(frequency - 58.0) < 5.0].mean())
    assert at_resonance == sorted(at_resonance)


def test_simulations_before_a_failure_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interruption after two of three simulations leaves two lines of metrics; progress never goes back."""

    def fails_after_two(cases: Iterable[tables.PaperCase]) -> Iterator[tuple[tables.PaperCase, tables.SimulatedCase]]:
        yield from [*simulated(cases)][:2]
        raise tables.PaperError("the FMU gave up at 0.1 s")

    seen: list[float] = []
    monkeypatch.setattr(report, "simulate", fails_after_two)
    with pytest.raises(tables.PaperError, match="gave up"):
        report.simulate_cases(CASES, tmp_path, lambda what, fraction: seen.append(fraction or 0.0))
    lines = list(csv.DictReader((tmp_path / "simulations.csv").read_text(encoding="utf-8").splitlines()))
    assert [(line["scene"], line["profile"], line["curve"]) for line in lines] == list(CASES[:2])
    assert float(lines[0]["peak_torque_1"]) == 1.0
    assert 0.0 <= seen[0] <= seen[-1] <= 1.0
    assert seen == sorted(seen)


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    """Nobody waits for simulations whose results have nowhere to go."""
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="can't write"):
        report.run_paper(tmp_path / "file" / "results")


def test_cells_find_their_simulations() -> None:
    """Tables 7 and 11 name the same curve differently; a run that was cut short must not become an empty cell."""
    done = dict(simulated(CASES))
    torque = tables.evaluators(done, CASES[0][0])["peak_torque_1"]
    assert torque("Bang-bang", "Clot.") == torque("Bang-bang", "Clothoid") == 1.0
    done[CASES[0]] = tables.SimulatedCase(
        dict.fromkeys(METRICS), 0.43, np.zeros(1), np.zeros(1), Path("plant.fmu"), 0.0
    )
    with pytest.raises(tables.PaperError, match="Bang-bang, Lamé: the simulation has no peak_torque_1"):
        torque("Bang-bang", "Lamé")
