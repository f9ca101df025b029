"""Files of a plan: the planned scene, the table of the front, all figures, and the page.

The page has the chosen motion beside the given one, how close it comes to each limit and where, and the front.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydantic_core

from flexfmu.cosim.design.plans.assessment import FIGURES, Assessment, heading, shown
from flexfmu.cosim.design.plans.clearance import Clearance
from flexfmu.cosim.design.plans.goals import INSTANTS, RATES, Goals
from flexfmu.cosim.design.plans.planner import PlanResult
from flexfmu.cosim.design.scene_files import write_new
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder, to_json
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.chart import GREY, INK, PALETTE, Curve, Marker, Panel
from flexfmu.cosim.reports.comparison import ComparedRun, first_tiles, metrics_table, signal_plots
from flexfmu.cosim.reports.page import Page, Plot, Table
from flexfmu.cosim.reports.plots import to_scale
from flexfmu.cosim.reports.report import of_scene
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates
from flexfmu.trajectories.table import write_table
from flexfmu.trajectories.trajectory import Trajectory

FILE = "planned.toml"
"""Usual name of the planned scene."""


NAMES, COLOURS = ("given", "planned"), (PALETTE[0], PALETTE[1])
"""Of the two motions."""

LEAST = 1e-3
"""Smallest residual vibration on a logarithmic axis [µm]."""

DASHED, DOTTED = "5,3", "2,2"
"""Lines of second joints, and of the keep-out region."""

BORDER, LONG = 0.06, 2.0
"""Of the path's view, relative to its size; and half the length of lines [m]."""


def planned_scenes(folder: Path) -> list[Scene]:
    """The planned scenes of an earlier plan's folder, one for each way.

    Raises:
        InputError: there are none.
        SceneError: a scene can't be read.
    """
    paths = [folder / FILE] if (folder / FILE).exists() else []
    if not paths:
        paths = sorted(folder.glob("planned-*.toml"), key=lambda path: int(path.stem.rpartition("-")[2]))
    if not paths:
        raise InputError(f"{folder} has no {FILE} of an earlier plan: name the folder that `flexfmu plan` wrote to")
    return [load_scene(path) for path in paths]


def write_scene(result: PlanResult, path: Path) -> list[Path]:
    """Write the planned scene; a motion of the joints stands in a CSV file beside it, of the same name.

    Args:
        result: the plan.
        path: the scene file; those of the ways of a cycle have its name with -1, -2 and so on behind it.

    Returns:
        The written files.

    Raises:
        ResultsError: a file can't be written.
        TrajectoryError: the motion can't be written.
    """
    chosen, paths = result.chosen.candidate, [path]
    scenes = [(result.scene, chosen.trajectory)]
    if chosen.ways:
        scenes = [(way.scene, way.trajectory) for way in chosen.ways]
        paths = [path.with_stem(f"{path.stem}-{number}") for number in range(1, len(scenes) + 1)]
    return [each for one, there in zip(scenes, paths, strict=True) for each in _write_motion(result, *one, there)]


def _write_motion(result: PlanResult, scene: Scene, trajectory: Trajectory | None, path: Path) -> list[Path]:
    """Write the scene of a single motion, or of one way of a cycle."""
    data = scene.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    data["name"] = f"{scene.name}-planned"
    if scene.effects.choice is not None and None in scene.effects.choice.error:
        del data["effects"]["choice"]  # TOML has no null for errors that aren't estimated
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
    chosen, given, (low, high) = result.chosen, result.given, result.goals.band
    comments = (
        f"Planned by `flexfmu plan` for {result.goals.scene.name}: {chosen.candidate.label} ({chosen.candidate.method}).",
        f"Total time {chosen.time:.6g} s (given {given.time:.6g} s), residual vibration at most {1e6 * chosen.residual:.3g} um",
        f"(given {1e6 * given.residual:.3g} um) over payloads of {low:g} to {high:g} kg.",
        result.verdict[0].upper() + result.verdict[1:] + ".",
    )
    return [write_new(data, path, comments), *written]


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
    texts = {"front.csv": result.to_csv(), "plan.json": to_json(summary(result)), "plan.html": plan_page(result)}
    return written + [out.write(name, text) for name, text in texts.items()]


def summary(result: PlanResult) -> dict[str, Any]:
    """The plan as plain data, in SI units; None for what isn't known."""

    def figures(each: Assessment) -> dict[str, Any]:
        keys = "name", "value", "limit", "unit", "where", "met"
        return each.row | {"limits": [{key: getattr(use, key) for key in keys} for use in each.uses]}

    data = {
        "scene": result.goals.scene.name,
        "minimise": result.goals.wishes.minimise,
        "payloads": list(result.goals.band),
        "given": figures(result.given),
        "chosen": figures(result.chosen),
        "front": [figures(each) for each in result.front],
        "tried": [
            {key: each.row[key] for key in ("motion", "method", "time")}
            | {"excess": each.excess, "missed": {use.name: use.share for use in each.uses if not use.met}}
            for each in result.assessed
        ],
        "compared": [figures(each) for each in result.table if each not in result.front],
        "ways": [[figures(each) for each in pair] for pair in result.ways],
        "verdict": result.verdict,
        "interrupted": result.interrupted,
        "failures": list(result.failures),
        "robustness": [
            {**{key: value for key, value in vars(line).items() if key != "uses"}, "missed": list(line.missed)}
            for line in result.robustness
        ],
        "cpu_time": result.cpu_time,
    }
    plain: dict[str, Any] = pydantic_core.from_json(pydantic_core.to_json(data, inf_nan_mode="null"))
    return plain


def plan_page(result: PlanResult) -> str:
    """The page of a plan as HTML.

    Raises:
        ResultsError: a run for the signals failed.
    """
    tables = [summary_table(result), *ways_table(result), limits_table(result.chosen), front_table(result)]
    tables += [tried_table(result), *robustness_table(result)]
    plots, compared = [_front_plot(result)], list[ComparedRun]()
    every = result.goals.ways or (result.goals,)
    for number, (goals, pair) in enumerate(zip(every, result.ways or [(result.given, result.chosen)], strict=True), 1):
        runs = [each.candidate.prepared().run() for each in pair]
        way = f", way {number}" if result.ways else ""
        for name, run in zip(NAMES, runs, strict=True):
            compared.append(ComparedRun(f"{name}{way}", run.recording, measure_run(run), run.plan.duration))
        plots += [_path_plot(goals, runs, way), _references_plot(result, runs, way)]
    low, high = result.goals.band
    # what was planned, and whether it keeps to all limits
    chosen = result.chosen.candidate
    lead = f"{chosen.label} ({chosen.method}), for payloads of {low:.4g} to {high:.4g} kg: {result.verdict}."
    lead += " Stopped before the end: this is the best motion so far." if result.interrupted else ""
    title, frame = f"{result.goals.scene.name}: planned motion", of_scene(runs[-1].scene, runs[-1])
    tables.append(metrics_table(compared))
    return Page(title, lead, [*plots, *signal_plots(compared)], tables, first_tiles(compared), **frame).html


def summary_table(result: PlanResult) -> Table:
    """Worst figures over the bands, of the given and the chosen motion."""
    rows = []
    for name, figure in FIGURES.items():
        if name == "clearance":
            continue
        one, other = (each.worst(name) for each in (result.given, result.chosen))
        ratio = f"{other / one:.3g}" if one else "-"
        rows.append([f"{figure.label} [{figure.display_unit}]", shown(name, one), shown(name, other), ratio])
    note = f"Worst of all robots within the bands; the motion may enter the keep-out region by {1e3 * result.goals.wishes.margin:g} mm."
    return Table("Planned motion", ["", *NAMES, "ratio"], rows, note)


SHOWN = ("time", "residual", "torque", "rms_torque", "power", "energy", "jerk", "off_path")
"""Figures that tables of several motions have."""


def motions_table(
    result: PlanResult,
    title: str,
    motions: Sequence[Assessment],
    note: str,
    figures: Sequence[str] = SHOWN,
    *,
    is_brief: bool = False,
) -> Table:
    """Motions with figures, and whether they keep to the limits; a brief table has no method, and of what is missed the worst."""
    header = ["Motion", *([] if is_brief else ["Method"]), *map(heading, figures), "Limits"]
    rows = []
    for each in motions:
        names = [each.candidate.label, *([] if is_brief else [each.candidate.method])]
        rows.append([*names, *_shown(each, figures), standing(result, each, 1 if is_brief else None)])
    return Table(title, header, rows, note)


def _shown(found: Assessment, figures: Sequence[str]) -> list[str]:
    """The cells of figures."""
    return [shown(name, found.worst(name)) for name in figures]


def ways_table(result: PlanResult) -> list[Table]:
    """What each way of a cycle needs, of the given and the chosen one, the worst of its payloads; nothing for a single motion."""
    rows, figures = [], SHOWN[:6]
    for number, pair in enumerate(result.ways, 1):
        for name, each in zip(NAMES, pair, strict=True):
            masses = [peaks.variation.payload for peaks in each.peaks]
            payloads = dict.fromkeys(f"{mass:.4g}" for mass in (min(masses), max(masses)))
            rows.append([f"{number}, {name}", " to ".join(payloads), *_shown(each, figures)])
    pauses = ", ".join(f"{goals.pause:g} s" for goals in result.goals.ways)
    header = ["Way", "Payloads [kg]", *map(heading, figures)]
    note = f"Each from rest, the worst of its payloads; pauses after them: {pauses}."
    return [Table("Ways of the cycle", header, rows, note)] if rows else []


def limits_table(found: Assessment) -> Table:
    """How close a motion comes to each limit, and where."""
    rows = []
    for use in found.uses:
        unit, share, kept = "-" if use.unit == "1" else use.unit, f"{100 * use.share:.1f} %", "yes" if use.met else "no"
        rows.append([use.name, f"{use.value:.4g}", f"{use.limit:.4g}", unit, share, kept, use.where])
    header = ["Limit", "Value", "At most", "Unit", "Used", "Kept", "Where"]
    return Table("Limits", header, rows, "Worst over all robots of the bands. Clearance: depth in the keep-out region.")


def front_table(result: PlanResult) -> Table:
    """The front and the motions to compare with, the fastest first."""
    note = f"No other motion found beats one of these in every figure of {', '.join(result.axes)}."
    if len(result.table) > len(result.front):
        note = "Motions that no other one beats in every figure, and for comparison those of other planners and files."
    return motions_table(result, "Pareto front", result.table, note)


def tried_table(result: PlanResult) -> Table:
    """All motions that were tried, those nearest to the limits first."""
    tried = sorted(result.assessed, key=lambda each: (each.excess, each.time))
    note = "Of what is missed, the largest share of its limit."
    return motions_table(result, "Motions that were tried", tried, note, SHOWN[:2])


def standing(result: PlanResult, found: Assessment, most: int | None = None) -> str:
    """Whether a motion keeps to the limits, what it needs of those that it misses, and whether it is the chosen one.

    Of the limits that it misses there are so many, the worst ones; None for all.
    """
    missed = [f"{use.name} {use.share:.3g}x" for use in sorted(found.uses, key=lambda use: -use.share) if not use.met]
    more = f" and {len(missed) - most} more" if most is not None and len(missed) > most else ""
    text = f"misses {', '.join(missed[:most])}{more}" if missed else "kept"
    return f"{text}, chosen" if found is result.chosen else text


def robustness_table(result: PlanResult) -> list[Table]:
    """The chosen motion in other models; nothing without them."""
    rows = []
    for line in result.robustness:
        values = line.residual, line.torque_ratio, line.off_path
        factors = 1e6, 1.0, 1e3
        cells = ["-" if math.isnan(value) else f"{k * value:.3g}" for value, k in zip(values, factors, strict=True)]
        limits = f"misses {', '.join(line.missed)}" if line.missed else "kept" if line.uses else line.note
        rows.append([line.model, cells[0], line.where, *cells[1:], limits])
    header = ["Model", "Residual [µm]", "Worst for", "Torque ratio", "Off path [mm]", "Limits"]
    note = "Torques are relative to the given motion's in the same model."
    return [Table("In other models", header, rows, note)] if rows else []


def _front_plot(result: PlanResult) -> Plot:
    """The other figures of the front over its first one."""
    along, *names = result.axes
    panels, marked = list[Panel](), {result.given: "given", result.chosen: "chosen"}
    for name in names:
        is_residual, curves = name == "residual", list[Curve]()
        # logarithmic for residual vibrations
        values = {each: FIGURES[name].displayed(each.worst(name)) for each in result.table}
        places = {each: (each.worst(along), max(y, LEAST) if is_residual else y) for each, y in values.items()}
        for is_kept, group, colour in ((True, "limits kept", PALETTE[0]), (False, "limits missed", PALETTE[1])):
            if motions := [each for each in places if each.feasible == is_kept]:
                x, y = np.array([places[each] for each in motions]).T
                notes = [f"{each.candidate.label}: {standing(result, each)}" for each in motions]
                curves.append(Curve(x, y, group, colour, width=0.0, dot="disc", notes=notes))
        # discs about the given and the chosen motion, with their names in the first panel
        markers = [
            Marker(*places[each], 11.0, INK, 0.25, text="" if panels else text, offset=(9.0, 3.0))
            for each, text in marked.items()
            if each in places
        ]
        scale, level = ("y", 1e6 * result.goals.wishes.residual) if is_residual else ("", None)
        label = heading(name).replace(" [", "\n[")
        panels.append(Panel(label, curves, markers, is_function=False, logarithmic=scale, level=level))
    caption = "The motions of the table. Dashed: the limit of the residual vibration."
    return Plot("front", "Pareto front", caption, tuple(panels), heading(along), 330.0)


def _path_plot(goals: Goals, runs: Sequence[Run], way: str = "") -> Plot:
    """The paths of the end effector, and what it keeps clear of."""
    paths = [np.column_stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"]) for run in runs]
    curves = [
        Curve(path[:, 0], path[:, 1], name, colour) for name, colour, path in zip(NAMES, COLOURS, paths, strict=True)
    ]
    view = _view(np.concatenate(paths), goals.clearance)
    outlines = [np.vstack([each.corners, each.corners[:1]]) for each in goals.clearance.regions]
    for origin, normal in zip(goals.clearance.origins, goals.clearance.normals, strict=True):
        outlines.append(origin + np.outer([-LONG, LONG], [-normal[1], normal[0]]))
    shown = [points for outline in outlines if np.isfinite(points := _within(outline, view)).any()]
    for number, points in enumerate(shown):
        label = "" if number else "keep-out"
        curves.append(Curve(points[:, 0], points[:, 1], label, GREY, width=1.0, dashes=DOTTED, is_read=False))
    caption = "With the scene's own payload; dotted: regions to stay out of and lines not to cross."
    panel = Panel(label="y [m]", curves=curves, is_to_scale=True, is_function=False)
    return to_scale(f"path{way[-1:]}", f"Path of the end effector{way}", caption, panel)


def _view(points: RealArray, clearance: Clearance) -> RealArray:
    """The lowest and the highest corner (2, 2) [m] of what a plot shows: points, and regions near to them."""
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    corners = np.concatenate([points, *(each.corners for each in clearance.regions)])
    near = corners[np.all((corners > low - 0.5 * span) & (corners < high + 0.5 * span), axis=1)]
    return np.array([near.min(axis=0) - BORDER * span, near.max(axis=0) + BORDER * span])


def _within(outline: RealArray, view: RealArray) -> RealArray:
    """A line through points (N, 2), with more points between them, broken where it leaves a view (2, 2)."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(outline, axis=0).T))])
    even = np.union1d(length, np.arange(0.0, length[-1], 2e-3 * float(np.ptp(view, axis=0).max())))
    points = np.column_stack([np.interp(even, length, outline[:, k]) for k in range(2)])
    inside = np.all((points >= view[0]) & (points <= view[1]), axis=1)
    return np.where(inside[:, None], points, np.nan)


def _references_plot(result: PlanResult, runs: Sequence[Run], way: str = "") -> Plot:
    """Speed, acceleration and jerk of the joint references, with their limits."""
    panels = list[Panel]()
    for order, name in enumerate(RATES, start=1):
        curves = []
        for motion, colour, run in zip(NAMES, COLOURS, runs, strict=True):
            joints = run.plan.joints
            instants = np.linspace(0.0, joints.duration, INSTANTS)
            values = joints.evaluate(instants, order, "left")[order]
            for joint, dashes in enumerate(("", DASHED)):
                label = f"{motion} {joint + 1}"
                curves.append(Curve(instants, values[:, joint], label, colour, dashes=dashes))
        usual = np.array(result.given.worst(name))
        level = float(result.goals.limit(name, usual)) if name in result.goals.limits else None
        panels.append(Panel(heading(name).replace(" [", "\n["), curves, level=level))
    caption = "Both joints of both motions. Dashed: the limit, where it is near."
    return Plot(f"planned-references{way[-1:]}", f"Joint references{way}", caption, tuple(panels), height=330.0)
