"""The paper's tables: its printed figures (`data/*.toml`) beside computed ones, cell by cell, and how many of them agree how closely.

Computed are lengths of curves, largest accelerations, natural frequencies along the path, and the metrics of every motion profile
on every curve, for both payloads, simulated with one FMU. The paper names its scenes by labels (``7th order polynomial``,
``Lamé``); `case_scene` turns these into a shipped scene with another profile and another blend.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter

from flexfmu.cosim.engine.errors import CosimError, ResultsError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies
from flexfmu.trajectories.trajectory import Trajectory


class PaperError(CosimError):
    """A simulation of the paper's experiment failed."""


# Printed and computed figures

TABLES = (
    *("table-02", "table-05", "table-06", "frequencies"),
    *("table-07", "table-08", "table-09", "table-10", "table-11"),
)
"""Data files in the order in which the report shows them."""

CLOSE, NEAR = 0.005, 0.035
"""Relative errors up to which a cell is graded close (the bound of torque and deflection) and near (RMS errors)."""

BOUNDS = (0.001, 0.005, 0.01, 0.035, 0.10)
"""Relative errors within which cells are counted: 0.1 %, 0.5 %, 1 %, 3.5 % and 10 %."""

EvaluateCell = Callable[[str, str], float]
"""Computed value [SI] of a cell from its row's and its column's label."""


@dataclass(frozen=True)
class Remark:
    """A remark on some cells of a quantity; empty ``rows`` or ``columns`` mean all of them.

    Attributes:
        text: one sentence or two.
        verdict: the printed figure can't be right (misprint), isn't reproducible from the paper's text (unexplained), or rests on
            a value that the paper doesn't give (identified); or how to read it (note).
        rows, columns: labels of the cells.
    """

    text: str
    verdict: Literal["misprint", "unexplained", "identified", "note"]
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()

    def concerns(self, row: str, column: str) -> bool:
        """Whether the remark is about this cell."""
        return (not self.rows or row in self.rows) and (not self.columns or column in self.columns)


@dataclass(frozen=True)
class Cell:
    """One figure of the paper beside the computed one, both in the quantity's unit.

    Attributes:
        row, column: labels as printed.
        printed: the figure as printed.
        computed: the computed figure.
        remarks: remarks on this cell.
    """

    row: str
    column: str
    printed: str
    computed: float
    remarks: tuple[Remark, ...] = ()

    @property
    def relative_error(self) -> float:
        """Computed / printed - 1."""
        return self.computed / float(self.printed) - 1.0

    @property
    def decimals(self) -> int:
        """Number of printed decimals."""
        return len(self.printed.partition(".")[2])

    @property
    def agrees_to_the_digits(self) -> bool:
        """Whether the computed figure, rounded to the printed digits, equals the printed one."""
        return abs(self.computed - float(self.printed)) <= 0.5000001 * 10.0**-self.decimals

    @property
    def believable(self) -> bool:
        """Whether the printed figure can be right."""
        return all(remark.verdict != "misprint" for remark in self.remarks)

    @property
    def grade(self) -> Literal["close", "near", "far", "misprint"]:
        """How near the computed figure is to the printed one, which gives the cell's colour."""
        if not self.believable:
            return "misprint"
        if abs(self.relative_error) <= CLOSE or self.agrees_to_the_digits:
            return "close"
        return "near" if abs(self.relative_error) <= NEAR else "far"

    def rounded(self) -> str:
        """The computed figure with one more decimal than printed."""
        return f"{self.computed:.{self.decimals + 1}f}"

    def difference(self) -> str:
        """The relative error as text with sign: two decimals below 10 %, none above 1000 %."""
        value = 100.0 * self.relative_error
        decimals = 2 if abs(value) < 9.995 else 1 if abs(value) < 999.5 else 0
        return f"{value:+.{decimals}f}\N{NO-BREAK SPACE}%".replace("-", "\N{MINUS SIGN}")


@dataclass(frozen=True)
class Quantity:
    """One block of a table: a quantity printed for rows and columns.

    Attributes:
        name, unit, meaning: the paper's name, the unit of ``values``, what is computed to compare with them.
        metric: name of the computed number (SI), which ``scale`` converts to ``unit``.
        rows, columns: labels as printed.
        values: figures as printed, so that their digits are kept, ``values[row][column]``.
        remarks: remarks on cells.
        cells: printed and computed figures, row by row; empty before they are computed.
    """

    name: str
    unit: str
    meaning: str
    metric: str
    scale: float
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]
    remarks: tuple[Remark, ...] = ()
    cells: tuple[Cell, ...] = ()

    def lines(self) -> list[tuple[str, list[Cell]]]:
        """Label and cells of each row."""
        return [(row, [self.cell(row, column) for column in self.columns]) for row in self.rows]

    def cell(self, row: str, column: str) -> Cell:
        """The cell of a row and a column; KeyError if there is none."""
        return {(cell.row, cell.column): cell for cell in self.cells}[row, column]


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper.

    Attributes:
        key: name of the data file without its suffix.
        label, title: for example ``Table 7`` and its caption.
        quantities: the blocks of the table.
        scene: name of the shipped scene simulated for it; empty for tables of trajectories alone.
        remarks: what holds for the whole table.
    """

    key: str
    label: str
    title: str
    quantities: tuple[Quantity, ...]
    scene: str = ""
    remarks: tuple[str, ...] = ()

    @property
    def cells(self) -> tuple[Cell, ...]:
        """The cells of all quantities."""
        return tuple(cell for quantity in self.quantities for cell in quantity.cells)

    def quantity(self, metric: str) -> Quantity:
        """The quantity that is compared with a metric; KeyError if there is none."""
        return {quantity.metric: quantity for quantity in self.quantities}[metric]


@cache
def read_data(name: str) -> Mapping[str, Any]:
    """Read ``data/<name>.toml`` of this package."""
    file = files("flexfmu.cosim.studies.paper").joinpath("data", f"{name}.toml")
    return tomllib.loads(file.read_text(encoding="utf-8"))


@cache
def printed_table(key: str) -> PaperTable:
    """Read one table of `TABLES`."""
    data = read_data(key)
    # labels of rows and columns are those of the table unless the block has its own
    shared = {"rows": data["rows"], "columns": data["columns"]}
    quantities = [shared | block for block in data["quantities"]]
    table = {**data, "key": key, "label": data["table"], "quantities": quantities}
    return TypeAdapter(PaperTable).validate_python(table)


def compare(table: PaperTable, evaluate: Mapping[str, EvaluateCell]) -> PaperTable:
    """The table with every cell computed.

    Args:
        table: the printed table.
        evaluate: for each metric of the table, the function that computes its cells in SI units.

    Raises:
        ResultsError: a computed figure is not finite.
    """
    quantities = []
    for quantity in table.quantities:
        cells = []
        for row, figures in zip(quantity.rows, quantity.values, strict=True):
            for column, printed in zip(quantity.columns, figures, strict=True):
                # evaluators work in SI, tables in their own units
                computed = quantity.scale * evaluate[quantity.metric](row, column)
                if not math.isfinite(computed):
                    where = f"{table.label}, {quantity.name}, {row}, {column}"
                    raise ResultsError(f"{where}: the computed figure is {computed}; look at the simulation's results")
                remarks = tuple(remark for remark in quantity.remarks if remark.concerns(row, column))
                cells.append(Cell(row, column, printed, computed, remarks))
        quantities.append(replace(quantity, cells=tuple(cells)))
    return replace(table, quantities=tuple(quantities))


def count_agreement(cells: Iterable[Cell]) -> dict[str, Any]:
    """How many cells agree.

    Keys:
        compared: number of cells whose printed figure can be right.
        within: a relative error of `BOUNDS` as text → number of these within it.
        to_the_digits: number of these equal to the printed figure when rounded like it.
        misprinted: number of further cells whose printed figure can't be right.
    """
    cells = tuple(cells)
    believable = [cell for cell in cells if cell.believable]
    return {
        "compared": len(believable),
        "within": {f"{bound:g}": sum(abs(each.relative_error) <= bound for each in believable) for bound in BOUNDS},
        "to_the_digits": sum(cell.agrees_to_the_digits for cell in believable),
        "misprinted": len(cells) - len(believable),
    }


def agreement(cells: Iterable[Cell]) -> str:
    """The counts of `count_agreement` in one sentence."""
    found = count_agreement(cells)
    misprinted = "1 cell is" if found["misprinted"] == 1 else f"{found['misprinted']} cells are"
    if not found["compared"]:
        return f"{misprinted} misprinted."
    more = f"; {misprinted} misprinted and not counted" if found["misprinted"] else ""
    # only bounds that add cells
    steps = [
        f"{count} within {100 * bound:g} %"
        for bound, (before, count) in zip(BOUNDS, pairwise((0, *found["within"].values())), strict=True)
        if count > before
    ]
    counts = ", ".join(steps or ["none within 10 %"])
    return f"Of {found['compared']} cells, {counts} ({found['to_the_digits']} to the printed digits){more}."


# Scenes and motions

TRAJECTORY_SCENE = "barnard2012-6kg"
"""Scene whose path the tables and figures of trajectories alone refer to; the payload doesn't matter to them."""

TRAJECTORY_DURATION = 1.0
"""Cycle time of the paper's comparison of trajectories (Tables 5 and 6, Figs. 7 to 11) [s]."""

POLYNOMIAL = "7th order polynomial"
"""Label of the smoothest motion profile."""

POINTS = 2001
"""Instants between two breakpoints: a smooth maximum is met to about (pi / POINTS)²/8 < 1e-6 relative."""


CASES: Mapping[str, Mapping[str, Any]] = read_data("cases")
"""``curves``: label → the scene's ``trajectory.blend``; ``profiles``: label of a motion profile → its ``trajectory.profile``."""


def case_scene(scene: str, profile: str, curve: str, **changes: Any) -> Scene:
    """The shipped scene with another motion profile and another curve.

    Args:
        scene: name of a shipped scene.
        profile, curve: labels as in the paper's tables.
        changes: further keys of the scene's trajectory section, for example ``duration=1.0``.

    Raises:
        KeyError: no such label.
        SceneError: the scene doesn't exist, or a changed value is out of range.
    """
    trajectory = {"profile": dict(CASES["profiles"][profile]), "blend": dict(CASES["curves"][curve]), **changes}
    return load_scene(scene).replace({f"trajectory.{key}": value for key, value in trajectory.items()})


def trajectory_scene(profile: str, curve: str, **changes: Any) -> Scene:
    """The scene of the comparison of trajectories: a cycle time of 1 s unless ``changes`` have another one."""
    return case_scene(TRAJECTORY_SCENE, profile, curve, **{"duration": TRAJECTORY_DURATION, **changes})


def blend_length(curve: str) -> float:
    """Arc length of one blend [m]; it doesn't depend on the motion profile, so any will do."""
    return plan(trajectory_scene(POLYNOMIAL, curve)).profiled.path.blend.curve.length


def peak_task_acceleration(profile: str, curve: str) -> float:
    """Largest norm of the end effector's acceleration [m/s²], both sides of every jump included."""
    task = plan(trajectory_scene(profile, curve)).task
    return maximum(task, lambda derivatives: np.hypot(derivatives[2, :, 0], derivatives[2, :, 1]))


def peak_joint_acceleration(profile: str, curve: str) -> float:
    """Largest signed second derivative of q11 [rad/s²]."""
    return maximum(plan(trajectory_scene(profile, curve)).joints, lambda derivatives: derivatives[2, :, 0])


def maximum(trajectory: Trajectory, quantity: Callable[[RealArray], RealArray]) -> float:
    """Largest value over the motion of a function of the trajectory's derivatives (order + 1, N, 2) with a result (N,)."""
    return max(float(np.max(quantity(derivatives))) for _, derivatives in smooth_pieces(trajectory, POINTS))


def smooth_pieces(trajectory: Trajectory, points: int, order: int = 2) -> Iterator[tuple[RealArray, RealArray]]:
    """Times (N,) and derivatives (order + 1, N, 2) between neighbouring breakpoints, with one-sided limits at both."""
    for begin, end in pairwise(trajectory.breakpoints):
        time = np.linspace(begin, end, points)
        before = trajectory.evaluate(time[:-1], order=order, side="right")
        last = trajectory.evaluate(time[-1:], order=order, side="left")
        yield time, np.concatenate([before, last], axis=1)


# Frequencies and simulations

POSES = 41
"""Poses along the path, start, middle and end included."""

FREQUENCY_ROWS: Mapping[str, tuple[str, int]] = {
    "first, 6 kg": ("barnard2012-6kg", 0),
    "first, 0.1 kg": ("barnard2012-0.1kg", 0),
    "third, 0.1 kg": ("barnard2012-0.1kg", 2),
}
"""Row of the comparison → scene, and index of the frequency in ascending order."""

PaperCase = tuple[str, str, str]
"""A simulation: shipped scene, motion profile (row), curve (column)."""


@cache
def path_frequencies(name: str) -> RealArray:
    """Natural frequencies [Hz] of a shipped scene, (poses, n), ascending, at equally spaced instants of the motion on the Lamé path."""
    scene = case_scene(name, POLYNOMIAL, "Lamé")
    joints = plan(scene).joints
    poses = joints.evaluate(np.linspace(0.0, joints.duration, POSES), order=0)[0]
    return np.stack([natural_frequencies(scene, pose) for pose in poses])


def natural_frequency(row: str, column: str) -> float:
    """Centre or half range of a frequency over the poses of the path [Hz]."""
    name, index = FREQUENCY_ROWS[row]
    lowest, highest = path_frequencies(name)[:, index].min(), path_frequencies(name)[:, index].max()
    return float({"centre": highest + lowest, "half range": highest - lowest}[column] / 2)


@dataclass(frozen=True)
class SimulatedCase:
    """The results of a run.

    Attributes:
        metrics: name → value in SI units.
        duration: duration of the motion [s].
        time, path_error: instants [s] and norm of the end effector's position error [m], over motion and dwell.
        fmu_path: the FMU that was simulated.
        simulation_time: wall-clock time [s].
    """

    metrics: Mapping[str, float | None]
    duration: float
    time: RealArray
    path_error: RealArray
    fmu_path: Path
    simulation_time: float


def evaluators(
    simulations: Mapping[PaperCase, SimulatedCase] | None = None, scene: str = ""
) -> dict[str, EvaluateCell]:
    """Metric → function of row and column, which raises `PaperError` where a simulation lacks the metric.

    Args:
        simulations: those done; None for tables that need none.
        scene: name of the shipped scene of the table.
    """

    def simulated(metric: str, row: str, column: str) -> float:
        value = (simulations or {})[scene, row, canonical_curve(column)].metrics[metric]
        if value is None:
            raise PaperError(f"{scene}, {row}, {column}: the simulation has no {metric}")
        return value

    return {
        "blend_length": lambda row, column: blend_length(row),
        "path_length": lambda row, column: plan(trajectory_scene(POLYNOMIAL, column)).profiled.path.length,
        "peak_task_acceleration": peak_task_acceleration,
        "peak_joint_acceleration_1": peak_joint_acceleration,
        "natural_frequency": natural_frequency,
        **{name: partial(simulated, name) for name in METRICS},
    }


def simulated_cases(tables: Iterable[PaperTable]) -> tuple[PaperCase, ...]:
    """Every simulation that the tables need, once each and in their order; tables repeat curves under other labels."""
    cases = (
        (table.scene, row, canonical_curve(column))
        for table in tables
        if table.scene
        for quantity in table.quantities
        for row in quantity.rows
        if row in CASES["profiles"]
        for column in quantity.columns
    )
    return tuple(dict.fromkeys(cases))


def canonical_curve(label: str) -> str:
    """The first label of the same curve: ``Clothoid`` and ``Clot.`` are one."""
    return next(other for other, blend in CASES["curves"].items() if blend == CASES["curves"][label])


def simulate(cases: Iterable[PaperCase]) -> Iterator[tuple[PaperCase, SimulatedCase]]:
    """Run the cases one after the other; all use the FMU of the first, with their own parameters.

    Raises:
        PaperError: a simulation didn't reach its end.
    """
    fmu = None
    for case in cases:
        run = run_scene(case_scene(*case), fmu_path=fmu)
        # an incomplete run has no metrics to compare
        if not run.completed:
            raise PaperError(f"{', '.join(case)}: {run.message}")
        fmu = run.fmu_path
        metrics = {name: each.value for name, each in measure_run(run, companions=0).items()}
        x, y = (
            run.recording[f"end_effector.position.{axis}"].values
            - run.recording[f"end_effector.reference.position.{axis}"].values
            for axis in "xy"
        )
        found = metrics, run.plan.duration, run.recording.time, np.hypot(x, y), fmu, run.timing.simulate
        yield case, SimulatedCase(*found)
