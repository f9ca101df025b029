"""Tables in narrow and wide terminals: every number of every command's tables is whole."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.table import Column, Table

from flexfmu.benchmarks.hard_cases.suite import terminal_table as hard_table
from flexfmu.cosim.cli.export import _table as fmus_table
from flexfmu.cosim.cli.run_summary import _metrics_table as metrics_table
from flexfmu.cosim.cli.run_summary import _motors_table as motors_table
from flexfmu.cosim.cli.run_summary import _ranges as ranges_table
from flexfmu.cosim.cli.scenes import _table as scenes_table
from flexfmu.cosim.design.effects.study import comparison_table, contribution_table, frequency_table
from flexfmu.cosim.design.shapers.examination import terminal_table as shaper_table
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.motors import MOTOR_VALUES
from flexfmu.cosim.reports.comparison import ComparedRun
from flexfmu.cosim.reports.comparison import metrics_table as compare_table
from flexfmu.cosim.reports.modes_table import ModalPose, modes_table
from flexfmu.cosim.reports.terminal import FittingTable, as_terminal_table, titled_table
from flexfmu.cosim.studies.workprec.study import terminal_table as workprec_table

WIDTHS = (60, 80, 120)
POSES = [
    ModalPose(i / 10, -0.175, 0.32, -1.2345, 2.3456, (31.25, 98.76, 543.21, 6543.2, 65432.1, 7.0)) for i in range(3)
]


SCENE_FACTS = {
    "name": "barnard2012-6kg",
    "description": "The robot",
    "payload_mass": 6.0,
    "duration": 0.43,
    "drive": "motion",
}


def printed(table: Any, width: int) -> str:
    """What a terminal of this width shows."""
    console = Console(width=width, file=io.StringIO(), record=True, highlight=False)
    console.print(table)
    return console.export_text()


def numbers(table: Table) -> Iterator[str]:
    """The cells of the columns of numbers, and the words with digits of the others."""
    for column in table.columns:
        for cell in (str(each) for each in column.cells):
            yield from [cell] if column.justify == "right" else (word for word in cell.split() if has_digit(word))


def has_digit(word: str) -> bool:
    """Whether there is a digit in it."""
    return any(sign.isdigit() for sign in word)


def lost_numbers(table: Table, width: int) -> list[str]:
    """Numbers that can't be read in the printed table."""
    text = printed(table, width)
    assert all(len(line) <= width for line in text.splitlines())
    return [number for number in numbers(table) if number not in text or "…" in text]


def scene_tables() -> dict[str, Callable[[], Table]]:
    """The tables of the commands, with results of many digits."""
    return {
        "run": lambda: metrics_table(
            "barnard2012-6kg", dict.fromkeys(METRICS, 1.23456e3), dict.fromkeys(METRICS, 1.23e-4)
        ),
        "run ssp": ssp_ranges,
        "run, motors": motors,
        "compare": compared,
        "scenes": lambda: scenes_table([SCENE_FACTS, SCENE_FACTS | {"payload_mass": 123.456}]),
        "modes": lambda: modes_table("barnard2012-6kg", POSES)[0],
        "shaper": shaper_results,
        "workprec": work_precision,
        "hard": hard_cases,
        "fmus": exported,
        "effects": lambda: contribution_table(effect_study()),
        "effects, frequencies": lambda: frequency_table(effect_study()),
        "effects --check": effect_comparison,
    }


def ssp_ranges() -> Table:
    """Ranges of two outputs of an SSP file."""
    values = np.array([-1.23456e-11, 9.87654e11])
    column = SimpleNamespace(values=values, texts=None, unit="kg.m2/s2")
    names = "robot.end_effector.acceleration.x", "robot.link11.bending[1]"
    return ranges_table("system", SimpleNamespace(columns=dict.fromkeys(names, column)))  # type: ignore[arg-type]


def motors() -> Table:
    """Margins of two motors with long names."""
    margin = {"name": "RMS torque", "value": 0.86194321, "limit": 1.2345, "unit": "N.m", "use": 1.234}
    of_joint = dict.fromkeys((key for key, *_ in MOTOR_VALUES), 123.456)
    return motors_table([{"joint": i, "name": "maker XY-12", "margins": [margin], **of_joint} for i in (1, 2)])


def compared() -> Table:
    """Metrics of four runs."""
    runs = [
        ComparedRun(
            f"results/variant-{i}",
            Recording(np.zeros(0), {}),
            {name: Metric(1.2345e3 / (i + 1.0)) for name in METRICS},
        )
        for i in range(4)
    ]
    return as_terminal_table(compare_table(runs))


def shaper_results() -> Table:
    """Two candidates of a shaper study."""
    results: list[Any] = [
        SimpleNamespace(
            candidate=SimpleNamespace(name=name, application="joints, torque"),
            added_time=0.01234,
            nominal=SimpleNamespace(residual=123.456e-6, peak_torque=1234.5),
            worst_residual=1234.5e-6,
            time_to_rest=0.9876,
            path_deviation=0.123456,
        )
        for name in ("none", "extra-insensitive 5 %")
    ]
    return shaper_table("Shapers, 58.84 Hz and 73.54 Hz", results, results[1])


def work_precision() -> Table:
    """Trials of a study of work and precision; one failed."""
    trials = [
        SimpleNamespace(family="formulations", line="multipliers", label="1e-5", error=error, time=0.1234, note=note)
        for error, note in (
            (1.2e-7, ""),
            (None, "the closure residual grew beyond 1e-3 m after 12 communication points"),
        )
    ]
    study = SimpleNamespace(scene=SimpleNamespace(name="barnard2012-6kg"), scale=1e-3, duration=0.68, trials=trials)
    return workprec_table(study)  # type: ignore[arg-type]


def hard_cases() -> Table:
    """A case with much text."""
    checks = [SimpleNamespace(name=f"residual {i}", value=1.2e-5, unit="m", limit=1e-3, passed=True) for i in range(9)]
    report = SimpleNamespace(happened="completed after 12345 steps", checks=checks, passed=True)
    case = SimpleNamespace(
        name="singular-pose-1e-6", hard="the elbows are 1e-6 m from a line, and 200 m/s2 act on them"
    )
    return hard_table([SimpleNamespace(case=case, report=report)])  # type: ignore[list-item]


def exported() -> Table:
    """A controller as an FMU."""
    facts = SimpleNamespace(sample_time=1.25e-4, description="Proportional-derivative controller with feedforward")
    slave = SimpleNamespace(
        facts=facts, path=SimpleNamespace(name="pd.fmu"), parameters={"proportional": 1.2345e4, "limit": 300}
    )
    return fmus_table(SimpleNamespace(slaves=[slave]))  # type: ignore[arg-type]


def effect_study() -> Any:
    """Two effects with their contributions to three metrics."""
    cost = SimpleNamespace(states=12, operations=12345, time=1.2345e-4)
    estimate = SimpleNamespace(effect="distal bending", change="2 -> 3 modes", contribution=(0.0123, 1.234, 0.98765))
    row = SimpleNamespace(
        place="in", estimate=estimate, cost=SimpleNamespace(states=10, operations=1, time=1e-4), poses=POSES
    )
    choice = SimpleNamespace(of=("peak_torque_1", "residual_vibration_amplitude", "rms_acceleration_error"))
    scene = SimpleNamespace(name="barnard2012-6kg")
    return SimpleNamespace(scene=scene, choice=choice, cost=cost, rows=[row, row], poses=POSES)


def effect_comparison() -> Table:
    """The chosen set beside a richer one."""
    changes = {"peak_torque_1": 0.0123}
    found = SimpleNamespace(
        effect="foreshortening",
        change="of links 12 and 22",
        estimated=changes,
        observed=changes,
        effectivity=0.98,
        slower=12.34,
    )
    return comparison_table([found])  # type: ignore[list-item]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("command", scene_tables())
def test_no_number_is_cut_or_broken(command: str, width: int) -> None:
    """Every number of every table can be read whole, and no line is longer than the terminal is wide."""
    table = scene_tables()[command]()
    assert len([*numbers(table)]) > 2
    assert lost_numbers(table, width) == []


def test_rich_alone_loses_numbers() -> None:
    """The test above can fail: the same cells in a table of rich lack numbers at 60 columns."""
    modes = modes_table("barnard2012-6kg", POSES)[0]
    assert isinstance(modes, FittingTable)
    plain = Table(*(Column(column.header) for column in modes.columns))
    for row in zip(*(column.cells for column in modes.columns), strict=True):
        plain.add_row(*row)
    assert lost_numbers(plain, 60)


def make_table(shape: Sequence[int], keys: int, rng: np.random.Generator) -> FittingTable:
    """A table of drawn texts and numbers: one number of words a column, 0 for a column of numbers."""
    heads = [Column(f"heading of {i}", justify="right" if words == 0 else "left") for i, words in enumerate(shape)]
    table = titled_table("A title that is longer than the table below it is wide", *heads, keys=keys)
    for row in range(4):
        texts = [" ".join("abcdefghi"[: rng.integers(1, 9)] for _ in range(words)) for words in shape]
        table.add_row(
            *(text or f"{rng.normal() * 10.0 ** rng.integers(-9, 9):.6g} µm" for text in texts),
            style="bold" * (row == 1),
        )
    assert isinstance(table, FittingTable)
    return table


def test_drawn_tables_fit_every_width() -> None:
    """Whatever the columns and the width: numbers are whole, lines fit, and a table that fits is one table."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        shape = [int(rng.integers(1, 12)), *(int(each) for each in rng.choice([0, 0, 0, 1, 20], rng.integers(1, 12)))]
        table, width = make_table(shape, int(rng.integers(1, 3)), rng), int(rng.integers(40, 200))
        assert lost_numbers(table, width) == []
        wide = printed(table, 2000)
        assert wide.count("─\n") + wide.count("─ \n") == 1


def test_columns_that_do_not_fit_go_on_below_beside_the_rows_names() -> None:
    """Each part names the rows, and every column is there once."""
    table = titled_table("T", "name", *(Column(f"h{i}", justify="right") for i in range(10)))
    for name in ("first", "second"):
        table.add_row(name, *(f"{name[0]}{i}-123456789" for i in range(10)))
    text = printed(table, 60)
    parts = text.count("─\n")
    assert parts > 1
    assert text.count("first ") == text.count("second ") == text.count("name ") == parts
    assert all(text.count(f"h{i}") == 1 for i in range(10))


def test_brackets_in_titles_headings_and_cells_are_units() -> None:
    """rich would take "[m]" for markup."""
    table = titled_table("Scene [m]", "x [m]")
    table.add_row("1 [s]")
    assert printed(table, 80).split() == ["Scene", "[m]", "x", "[m]", "─" * 5, "1", "[s]"]
