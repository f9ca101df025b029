"""What a plan leaves behind: the planned scene, the table of the front, and the report."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from flexfmu.cosim.choices.plans.assessment import Assessment
from flexfmu.cosim.choices.plans.planner import FRONT, PlanResult
from flexfmu.cosim.engine.files import OutputFolder, write_whole
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.chart import Curve, Marker, Panel
from flexfmu.cosim.reports.comparison import ComparedRun, render_comparison
from flexfmu.cosim.reports.page import Plot, Table
from flexfmu.cosim.reports.svg import PALETTE
from flexfmu.trajectories.piecewise import Coordinates
from flexfmu.trajectories.table import write_table

FILE = "planned.toml"
"""Usual name of the planned scene."""


def write_scene(result: PlanResult, path: Path) -> list[Path]:
    """Write the planned scene; a motion of the joints stands in a CSV file beside it, of the same name.

    Args:
        result: the plan.
        path: the scene file.

    Returns:
        The written files.

    Raises:
        ResultsError: a file can't be written.
        TrajectoryError: the motion can't be written.
    """
    scene, trajectory = result.scene, result.chosen.candidate.trajectory
    data = scene.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    data["name"] = f"{scene.name}-planned"
    written = list[Path]()
    if trajectory is not None:
        table = path.with_suffix(".csv")
        moving: Coordinates = getattr(trajectory, "coordinates", "end-effector")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_table(table, trajectory, moving)
        data["trajectory"] = {
            "kind": "table", "file": table.name, "coordinates": moving, "degree": 7, "dwell": scene.trajectory.dwell
        }  # fmt: skip
        data.pop("shaper", None)
        written.append(table)
    document = tomlkit.document()
    for line in _comments(result):
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    for key, value in data.items():
        document.add(key, _item(value))
    return [write_whole(path, tomlkit.dumps(document)), *written]


def _comments(result: PlanResult) -> list[str]:
    """What the planned scene is, beside the given one."""
    chosen, given = result.chosen, result.given
    low, high = result.goals.band
    return [
        f"Planned by `flexfmu plan` for {result.goals.scene.name}: {chosen.candidate.label} ({chosen.candidate.method}).",
        f"Total time {chosen.time:.6g} s (given {given.time:.6g} s), residual vibration at most {1e6 * chosen.residual:.3g} um",
        f"(given {1e6 * given.residual:.3g} um) over payloads of {low:g} to {high:g} kg.",
        result.verdict[0].upper() + result.verdict[1:] + ".",
    ]


def _item(value: Any) -> Any:
    """A value for TOML: sections below the first level in one line."""
    if isinstance(value, dict):
        table = tomlkit.table()
        for key, each in value.items():
            table.add(key, _inline(each))
        return table
    if isinstance(value, list) and value and isinstance(value[0], dict):
        tables = tomlkit.aot()
        for each in value:
            tables.append(_item(each))
        return tables
    return value


def _inline(value: Any) -> Any:
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update({key: _inline(each) for key, each in value.items()})
        return table
    return [_inline(each) for each in value] if isinstance(value, list) else value


def write_plan(result: PlanResult, folder: Path) -> list[Path]:
    """Write planned scene, front and report into a folder.

    Returns:
        The files: ``planned.toml`` (with ``planned.csv`` for a motion of the joints), ``front.csv``, ``plan.json`` and
        ``plan.html``.

    Raises:
        ResultsError: a file can't be written.
    """
    out = OutputFolder(folder)
    out.prepare()
    text = StringIO()
    rows = result.rows()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    written = write_scene(result, folder / FILE)
    written.append(out.write("front.csv", text.getvalue()))
    written.append(out.write("plan.json", json.dumps(summary(result), indent=1) + "\n"))
    written.append(out.write("plan.html", report(result)))
    return written


def summary(result: PlanResult) -> dict[str, Any]:
    """The plan as plain data, in SI units."""

    def figures(each: Assessment) -> dict[str, Any]:
        return {
            "motion": each.candidate.label,
            "method": each.candidate.method,
            **{name: float(getattr(each, name)) for name in FRONT},
            "rms_torque": float(each.rms_torque),
            "clearance": float(each.clearance) if np.isfinite(each.clearance) else None,
            "feasible": each.feasible,
            "limits": [
                {"name": use.name, "value": float(use.value), "limit": float(use.limit), "unit": use.unit, "where": use.where, "met": bool(use.met)}
                for use in each.uses
            ],
        }  # fmt: skip

    return {
        "scene": result.goals.scene.name,
        "minimise": result.goals.wishes.minimise,
        "payloads": list(result.goals.band),
        "given": figures(result.given),
        "chosen": figures(result.chosen),
        "front": [figures(each) for each in result.front],
        "compared": [figures(each) for each in result.table if each not in result.front],
        "verdict": result.verdict,
        "interrupted": result.interrupted,
        "failures": list(result.failures),
        "robustness": [
            {
                "model": line.model,
                "residual": line.residual if math.isfinite(line.residual) else None,
                "where": line.where,
                "torque_ratio": line.torque_ratio,
                "off_path": line.off_path,
                "missed": list(line.missed),
                "note": line.note,
            }
            for line in result.robustness
        ],
        "cpu_time": result.cpu_time,
    }


def report(result: PlanResult) -> str:
    """The page: the chosen motion beside the given one, limits, front and ways."""
    runs = [each.candidate.prepared().run() for each in (result.given, result.chosen)]
    compared = [
        ComparedRun(name, run.recording, measure_run(run), run.plan.duration)
        for name, run in zip(("given", "planned"), runs, strict=True)
    ]
    plots = [_front_plot(result), _ways_plot(result, runs)]
    title = f"{result.goals.scene.name}: planned motion"
    return render_comparison(
        compared, [limits_table(result.chosen), front_table(result), robustness_table(result)], plots, title
    )


def limits_table(found: Assessment) -> Table:
    """How close a motion comes to each limit, and where."""
    rows = [
        [
            use.name,
            f"{use.value:.4g}",
            f"{use.limit:.4g}",
            use.unit.replace("1", "-"),
            f"{100 * use.share:.1f} %",
            use.where,
        ]
        for use in found.uses
    ]
    return Table(
        "Limits", ["Limit", "Value", "Limit", "Unit", "Used", "Where"], rows, "Worst over all payloads of the band."
    )


def front_table(result: PlanResult) -> Table:
    """The front and the motions to compare with, the fastest first."""
    rows = [
        [
            each.candidate.label, each.candidate.method, f"{each.time:.4g}", f"{1e6 * each.residual:.3g}", f"{each.torque:.4g}",
            f"{each.energy:.4g}", f"{1e3 * each.off_path:.3g}", "yes" if each.feasible else _missed(each),
        ]
        for each in result.table
    ]  # fmt: skip
    header = [
        "Motion",
        "Method",
        "Time [s]",
        "Residual [µm]",
        "Torque [N·m]",
        "Energy [J]",
        "Off path [mm]",
        "Within limits",
    ]
    note = "No other motion found is better in every figure."
    if len(result.table) > len(result.front):
        note = "Motions of which no other is better in every figure, and those of other planners and of files to compare with."
    return Table("Pareto front", header, rows, note)


def robustness_table(result: PlanResult) -> Table:
    """The chosen motion in other models."""
    rows = [
        [
            line.model,
            f"{1e6 * line.residual:.3g}" if math.isfinite(line.residual) else "-",
            line.where,
            "-" if line.torque_ratio is None else f"{line.torque_ratio:.3f}",
            "-" if line.off_path is None else f"{1e3 * line.off_path:.3g}",
            f"misses {', '.join(line.missed)}" if line.missed else "kept" if line.uses else line.note,
        ]
        for line in result.robustness
    ]
    header = ["Model", "Residual [µm]", "Worst for", "Torque ratio", "Off path [mm]", "Limits"]
    return Table("In other models", header, rows, "Torques are relative to the given motion's in the same model.")


def _missed(each: Assessment) -> str:
    return "misses " + ", ".join(use.name for use in each.uses if not use.met)


def _front_plot(result: PlanResult) -> Plot:
    """Residual over time of all candidates."""
    groups = {"within limits": PALETTE[0], "beyond a limit": PALETTE[1]}
    curves = []
    for label, colour in groups.items():
        chosen = [each for each in result.front if each.feasible == (label == "within limits")]
        if chosen:
            x = np.array([each.time for each in chosen])
            y = np.array([max(1e6 * each.residual, 1e-3) for each in chosen])
            notes = [each.candidate.label for each in chosen]
            curves.append(Curve(x, y, label, colour, width=0.0, dot="disc", notes=notes))
    best = result.chosen
    marker = Marker(best.time, 1e6 * best.residual, 9.0, PALETTE[2], 0.5, text="chosen", offset=(6.0, -6.0))
    panel = Panel(label="residual\n[µm]", curves=curves, markers=[marker], logarithmic="y", is_function=False)
    return Plot("front", "Time and residual vibration", "The motions of the front.", (panel,), "total time [s]", 190.0)


def _ways_plot(result: PlanResult, runs: Sequence[Run]) -> Plot:
    """The ways of the end effector, and what it keeps clear of."""
    curves = []
    for region in result.goals.clearance.regions:
        closed = np.vstack([region.corners, region.corners[:1]])
        curves.append(Curve(closed[:, 0], closed[:, 1], "kept clear", "#999999", width=1.0, dashes="3,2"))
    for k, (name, run) in enumerate(zip(("given", "planned"), runs, strict=True)):
        x, y = (_values(run.recording, axis) for axis in "xy")
        curves.append(Curve(x, y, name, PALETTE[k]))
    panel = Panel(label="y [m]", curves=curves, is_to_scale=True, is_function=False)
    return Plot("ways", "Way of the end effector", "With the scene's own payload.", (panel,), "x [m]", 220.0)


def _values(recording: Recording, axis: str) -> Any:
    return recording[f"end_effector.position.{axis}"].values
