"""Files of a plan: the planned scene, the table of the front, all figures, and the page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from flexfmu.cosim.design.plans.assessment import Assessment
from flexfmu.cosim.design.plans.plan_page import plan_page
from flexfmu.cosim.design.plans.planner import FRONT, PlanResult
from flexfmu.cosim.design.scene_files import toml_item
from flexfmu.cosim.engine.files import OutputFolder, write_whole
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
        document.add(key, toml_item(value))
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
    written = write_scene(result, folder / FILE)
    written.append(out.write("front.csv", result.to_csv()))
    written.append(out.write("plan.json", json.dumps(summary(result), indent=1) + "\n"))
    written.append(out.write("plan.html", plan_page(result)))
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
                **{key: getattr(line, key) for key in ("model", "residual", "where", "torque_ratio", "off_path")},
                **({} if math.isfinite(line.residual) else {"residual": None}),
                "missed": list(line.missed),
                "note": line.note,
            }
            for line in result.robustness
        ],
        "cpu_time": result.cpu_time,
    }
