"""What a plan found: the chosen motion beside the given one, its tables, pictures, page and files, and its samples for a drive.

The page has how close the chosen motion comes to each limit and where, and the front.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pydantic_core

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge, heading, noted
from flexfmu.cosim.design.plans.clearance import interpolated, lengths
from flexfmu.cosim.design.plans.goals import INSTANTS, LOOP_PARTS, RATES, Goals
from flexfmu.cosim.design.plans.sampled_loop import with_learned_torques
from flexfmu.cosim.design.scene_files import write_new
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder, to_json
from flexfmu.cosim.engine.showing import Rows, shown_unit
from flexfmu.cosim.experiment.metric import RunMetrics
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.journal import about_scene
from flexfmu.cosim.metrics.metric_table import PLAN_FIGURES, definition, display
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.metrics.signals import POSITION
from flexfmu.cosim.reports.chart import GREY, INK, PALETTE, REPEATED, Curve, Marker, Panel, scale_of
from flexfmu.cosim.reports.comparison import ComparedRun, compared_plots, metrics_table
from flexfmu.cosim.reports.page import TILES, Page, Plot, Table
from flexfmu.cosim.reports.page import Figure as Said
from flexfmu.cosim.reports.plots import to_scale
from flexfmu.cosim.reports.report import of_scene
from flexfmu.model.reference_design.loads import OF_CYCLE
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.piecewise import Coordinates, spline
from flexfmu.trajectories.table import write_table
from flexfmu.trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILE = "planned.toml"
"""Usual name of the planned scene."""

OF_PLANS = re.compile(r"(planned(-\d+)?|front-\d+(-\d+)?)\.(toml|csv)|live\.html")
"""Names of files that not every plan writes."""

NAMES, COLOURS = ("given", "planned"), (PALETTE[0], PALETTE[1])
"""Of the two motions."""

DOTTED = (2.0, 2.0)
"""Lines of second joints, and of the keep-out region."""

BORDER, DENSE, LONG = 0.2, 0.02, 2.0
"""Border about the paths, relative to their size; distance of points of outlines, relative to that; half the length of lines [m]."""

FRONT = ("time", "residual", "torque", "energy", "off_path")
"""Figures that the Pareto front weighs against each other."""

BINDING = 0.98
"""Used share of a limit from which on the verdict names it."""

ALIKE = 1e-3
"""Relative difference of all figures of a front below which the front has one of two motions."""

ANGLES: Mapping[str, float] = {"rad": 1.0, "deg": 180.0 / math.pi, "turn": 0.5 / math.pi}
"""Unit of angles → how many of it are 1 rad."""

SAMPLE_RATES = 10.0, 1e6
"""Lowest and highest rate [1/s]."""

SHARE = 1e-9
"""Share of a sample by which a motion may be longer than its last one."""


@dataclass(frozen=True, eq=False)
class DriveTable:
    """Samples of the motion of both joints, the last ones at rest.

    Attributes:
        rate: samples a second.
        unit: of the angles: rad, deg, turn or count.
        values: positions, velocities and accelerations (3, N, 2) in the unit and s, whole numbers of counts.
        torque: feedforward of both motors for the scene's own payload (N, 2) [N m].
        use: the residual vibration that the samples leave over the bands, with its limit: the FMU follows quintics through position,
            velocity and acceleration of each sample; infinite where the robot can't follow them.
    """

    rate: float
    unit: str
    values: RealArray
    torque: RealArray
    use: Limit

    @property
    def time(self) -> RealArray:
        """Instants of the samples (N,) [s]."""
        return np.arange(len(self.torque)) / self.rate

    def to_csv(self) -> str:
        """A line for each sample; the header has units, FMU-like names joint by joint."""
        units = self.unit, f"{self.unit}/s", f"{self.unit}/s2", "N.m"
        kinds = ("position", "velocity", "acceleration", "torque")
        names = [f"joint{j}.{kind} [{unit}]" for kind, unit in zip(kinds, units, strict=True) for j in (1, 2)]
        angle, text = "%d" if self.unit == "count" else "%.12g", StringIO()
        columns, formats = [self.time[:, np.newaxis], *self.values, self.torque], ["%.9g", *[angle] * 6, *["%.7g"] * 2]
        np.savetxt(text, np.hstack(columns), formats, ",", header=",".join(["time [s]", *names]), comments="")
        return text.getvalue()


@dataclass(frozen=True)
class RobustnessLine:
    """What remains of a plan's promise in another model.

    Attributes:
        model: the model.
        residual: worst residual vibration [m], and for which robot.
        where: that robot.
        torque_ratio: worst ratio of peak torques to the given motion's in the same model; NaN if it isn't compared.
        off_path: largest distance of the end effector from the given path [m]; NaN if it isn't known.
        note: what else to know, in a few words.
        missed: names of the limits that don't hold; None if the limits aren't judged here.
    """

    model: str
    residual: float
    where: str
    torque_ratio: float = math.nan
    off_path: float = math.nan
    note: str = ""
    missed: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class PlanResult(Rows):
    """A planned motion, and what it was chosen from.

    Attributes:
        goals: what it was planned for.
        given: the scene's own motion.
        chosen: the best motion that keeps to all limits, or the one that misses them least, see `best`.
        assessed: all candidates, in the order in which they were found.
        failures: message of each candidate or method that failed.
        interrupted: whether the plan ended before its methods did.
        cpu_time: processor time of planning [s], of all processes.
        robustness: what remains of the chosen motion's figures in richer models, beyond the bands, and in a loop.
    """

    goals: Goals
    given: Assessment
    chosen: Assessment
    assessed: tuple[Assessment, ...]
    failures: tuple[str, ...]
    interrupted: bool
    cpu_time: float
    robustness: tuple[RobustnessLine, ...] = ()

    def __repr__(self) -> str:
        """Return the chosen motion beside the given one, in a few lines."""
        lines = [f"PlanResult of {self.goals.scene.name}: {self.chosen.candidate.label}"]
        for name in (*FRONT, "rms_torque", "power"):
            unit = definition(name).display_unit
            lines.append(f"  {name}: {self.chosen.shown(name)} {unit} (given {self.given.shown(name)})")
        return "\n".join([*lines, f"  {self.verdict}"])

    @cached_property
    def ways(self) -> tuple[tuple[Assessment, Assessment], ...]:
        """The given and the chosen motion of each way of a cycle, from rest; empty for a single motion."""
        given, chosen = (Judge(self.goals).of_ways(each.candidate) for each in (self.given, self.chosen))
        return tuple(zip(given, chosen, strict=True))

    @property
    def metrics(self) -> RunMetrics:
        """The figures of the chosen motion, the worst within the bands."""
        return self.chosen.metrics

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """The scene with the chosen motion of each way; motions of the joints are in ``chosen.candidate``."""
        found = list[Scene]()
        for goals, way in zip(self.goals.ways, self.chosen.candidate.ways, strict=True):
            scene = way.scene.replace({"payload.mass": goals.payload})
            if goals.loop is not None:
                # the motion, followed by the controllers
                loop = with_learned_torques(goals.loop, way.joints, scene.trajectory.dwell)
                scene = scene.model_copy(update={key: getattr(loop, key) for key in ("cosimulation", *LOOP_PARTS)})
            found.append(scene)
        return tuple(found)

    @property
    def scene(self) -> Scene:
        """The scene with the chosen motion, or the first one of a cycle; a motion of the joints is in ``chosen.candidate.trajectory``."""
        return self.scenes[0]

    def drive_table(self, rate: float, unit: str = "rad", counts: float | None = None) -> DriveTable:
        """The chosen motion or cycle as a drive reads it.

        Args:
            rate: samples a second; the last one of a cycle is that before the first one.
            unit: of the angles, one of `ANGLES`; without meaning for counts.
            counts: encoder counts of one turn of a joint, to which positions, velocities and accelerations are rounded; None for no rounding.

        Raises:
            InputError: a rate or a number of counts out of range, or an unknown unit.
            TrajectoryError, ResultsError: the motion can't be planned or run.
        """
        check_drive(rate, unit, counts)
        per_radian = ANGLES[unit] if counts is None else counts * ANGLES["turn"]
        values, torques, motions = list[RealArray](), list[RealArray](), list[Trajectory]()
        candidate = self.chosen.candidate
        for goals, way in zip(self.goals.ways, candidate.ways, strict=True):
            run = way.prepared(step=1.0 / rate).run()
            joints = run.plan.joints
            # up to the first sample at rest; in a cycle up to that before the next motion
            pause, moving = goals.pause if candidate.cycle else 0.0, math.ceil(joints.duration * rate - SHARE)
            steps = max(moving, math.ceil((joints.duration + pause) * rate - SHARE) - 1)
            instants = np.arange(steps + 1) / rate
            angles = per_radian * joints.evaluate(np.minimum(instants, joints.duration), 2, "right")
            angles[1:, instants >= joints.duration - SHARE / rate] = 0.0
            values.append(angles if counts is None else np.rint(angles))
            recording = run.recording
            torque = [np.interp(instants, recording.time, recording[f"joint{joint}.torque"].values) for joint in (1, 2)]
            torques.append(np.column_stack(torque))
            # the motion of a drive that goes through each sample by quintics
            passed = values[-1][:, : moving + 1] / per_radian
            motions.append(spline(instants[: moving + 1], passed, coordinates="joints"))
        use, failures = self.goals.limits["residual"], list[str]()
        with noted(failures, "the robot can't follow them"):
            sampled = Candidate.of(self.goals, f"{rate:g} samples a second", "csv", motions)
            use = Judge(self.goals).assess(sampled).uses[0]
        use = replace(use.used(math.inf, failures[0]) if failures else use, figure="residual of the samples")
        unit = unit if counts is None else "count"
        return DriveTable(rate, unit, np.concatenate(values, axis=1), np.concatenate(torques), use)

    @property
    def axes(self) -> tuple[str, ...]:
        """The figures that the front weighs: those of the wishes, the time first, or `FRONT`."""
        return tuple(sorted(self.goals.wishes.front, key=lambda each: each != "time")) or FRONT

    @property
    def front(self) -> tuple[Assessment, ...]:
        """The candidates, the given motion included, of which no other is better in every figure of `axes`; the fastest first.

        A motion that misses a limit isn't better than one that keeps all. The chosen motion is always there. A front that was asked for has
        no motions that miss limits beside the given one, unless all do.
        """
        # the chosen one first, so that none like it replaces it
        everyone = sorted((self.given, *self.assessed), key=lambda each: (each is not self.chosen, each.time))
        if self.goals.wishes.front and self.chosen.feasible:
            everyone = [each for each in everyone if each.feasible or each is self.given]
        values, kept = np.array([[*map(each.worst, self.axes), not each.feasible] for each in everyone]), list[int]()
        for k, each in enumerate(everyone):
            is_beaten = ((values <= values[k]).all(axis=1) & (values < values[k]).any(axis=1)).any()
            is_there = np.isclose(values[kept, :-1], values[k, :-1], rtol=ALIKE, atol=0.0).all(axis=1).any()
            if each is self.chosen or not (is_beaten or is_there):
                kept.append(k)
        return tuple(sorted((everyone[k] for k in kept), key=lambda each: each.time))

    @property
    def table(self) -> tuple[Assessment, ...]:
        """The front and, to compare with, motions of the user; the fastest first."""
        front = self.front
        others = [each for each in self.assessed if each.candidate.method == "csv" and each not in front]
        return tuple(sorted([*front, *others], key=lambda each: each.time))

    @property
    def missed(self) -> tuple[Limit, ...]:
        """The limits that the chosen motion doesn't keep to."""
        return self.chosen.missed

    @property
    def verdict(self) -> str:
        """Whether the chosen motion keeps to all limits, in a sentence with what may help where it doesn't."""
        if self.interrupted and not self.assessed:
            return "no motion was judged before the interruption; this is the given one"
        missed, duration, remedy = {use.figure for use in self.missed}, self.goals.wishes.duration, ""
        if duration is not None and missed - {"loop_residual"}:
            remedy = f': {duration:g} s may be too short, `minimise = "time"` without `duration` tells the shortest'
        if "loop_residual" in missed:
            remedy += ": finer encoders, shorter sample times or other gains leave less in the loop"
        if not self.assessed:
            return f"no motion could be planned; this is the given one{remedy}"
        uses = sorted(self.chosen.uses, key=lambda use: -use.share)
        named = self.missed or [use for use in uses if use is uses[0] or use.share > BINDING]
        of = "instead of" if missed else "of"
        listed = ", ".join(f"{use.name} {_shown(use, use.value)} {of} {_shown(use)} ({use.where})" for use in named)
        if missed:
            so_far = " so far" * self.interrupted
            return f"no motion found{so_far} keeps all limits; the nearest misses {listed}{remedy}"
        return f"all limits are kept; the closest {'is' if len(named) == 1 else 'are'} {listed}"

    def row_units(self) -> Mapping[str, str]:
        """Figure → unit."""
        return {name: figure.unit for name, figure in PLAN_FIGURES.items()}

    def standing(self, found: Assessment, most: int | None = None) -> str:
        """Whether a motion keeps to the limits, what it needs of those that it misses, and whether it is the chosen one.

        Of the limits that it misses there are so many, the worst ones; None for all.
        """
        missed = [f"{use.name} {use.share:.5g}x" for use in sorted(found.missed, key=lambda use: -use.share)]
        more = f" and {len(missed) - most} more" if most is not None and len(missed) > most else ""
        text = f"misses {', '.join(missed[:most])}{more}" if missed else "kept"
        return f"{text}, chosen" if found is self.chosen else text

    def front_plot(self, motions: Sequence[Assessment], caption: str = "") -> Plot:
        """What motions need: each other figure of the front over its first one."""
        along, *names = self.axes
        panels, marked = list[Panel](), {self.given: "given", self.chosen: "chosen"}
        for name in names:
            info, curves = definition(name), list[Curve]()
            places = {each: (each.worst(along), info.displayed(each.worst(name))) for each in motions}
            for is_kept, group, colour in ((True, "limits kept", PALETTE[0]), (False, "limits missed", PALETTE[1])):
                if some := [each for each in places if each.feasible == is_kept]:
                    x, y = np.array([places[each] for each in some]).T
                    notes = [f"{each.candidate.label}: {self.standing(each)}" for each in some]
                    curves.append(Curve(x, y, group, colour, width=0.0, dot="disc", notes=notes))
            # discs about the given and the chosen motion, with their names in the first panel
            markers = [
                Marker(*places[each], 11.0, INK, 0.25, text="" if panels else text, offset=(9.0, 3.0))
                for each, text in marked.items()
                if each in places
            ]
            level = info.displayed(self.goals.wishes.residual) if name == "residual" else None
            label, scale = heading(name).replace(" [", "\n["), scale_of([y for _, y in places.values()])
            panels.append(Panel(label, curves, markers, is_function=False, logarithmic=scale, level=level))
        return Plot("front", "Pareto front", caption, tuple(panels), heading(along), 330.0)

    def plot(self) -> Figure:
        """What all motions need that were tried, beside the given and the chosen one."""
        from flexfmu.cosim.reports.figure_style import figure_of  # Matplotlib takes longer than most commands

        title = f"{self.goals.scene.name}: motions that were tried"
        return figure_of([self.front_plot((self.given, *self.assessed))], title)

    def rows(self) -> list[dict[str, Any]]:
        """The front, and motions to compare with, as rows: label, method, figures, and whether all limits are kept."""
        return [each.row for each in self.table]


def _shown(use: Limit, value: float | None = None) -> str:
    """A limit, or a value of what it limits, in the unit of tables."""
    value, figure = use.limit if value is None else value, use.figure.removeprefix("loop_")
    if use.is_relative or figure not in PLAN_FIGURES:
        return f"{value:.4g} {shown_unit(use.unit)}".rstrip()
    return display(figure, value, 4)


def check_drive(rate: float, unit: str, counts: float | None) -> None:
    """Refuse what no drive takes; arguments and errors as for `PlanResult.drive_table`."""
    if not SAMPLE_RATES[0] <= rate <= SAMPLE_RATES[1]:
        raise InputError(
            f"the rate of a drive's table must be {SAMPLE_RATES[0]:g} to {SAMPLE_RATES[1]:g} samples a second, got {rate:g}"
        )
    if unit not in ANGLES:
        raise InputError(f"angles of a drive's table are in {', '.join(ANGLES)}, got {unit!r}")
    if counts is not None and not (counts >= 1.0 and float(counts).is_integer()):
        raise InputError(f"the encoder's counts of a turn are a whole number from 1 on, got {counts:g}")


def planned_scenes(folder: Path) -> list[Scene]:
    """The planned scenes of an earlier plan's folder, one for each way.

    Raises:
        InputError: there are none.
        SceneError: a scene can't be read.
    """
    ways = sorted(folder.glob("planned-*.toml"), key=lambda path: int(path.stem.rpartition("-")[2]))
    if not (paths := [*folder.glob(FILE)] or ways):
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
    chosen, given, (low, high), written = result.chosen, result.given, result.goals.band, list[Path]()
    comments = (
        f"Planned by `flexfmu plan` for {result.goals.scene.name}: {chosen.candidate.label} ({chosen.candidate.method}).",
        f"Total time {chosen.time:.6g} s (given {given.time:.6g} s), residual vibration at most {1e6 * chosen.residual:.3g} um",
        f"(given {1e6 * given.residual:.3g} um) over payloads of {low:g} to {high:g} kg.",
        result.verdict[0].upper() + result.verdict[1:] + ".",
    )
    for number, (scene, way) in enumerate(zip(result.scenes, chosen.candidate.ways, strict=True), 1):
        there = path.with_stem(f"{path.stem}-{number}") if chosen.candidate.cycle else path
        changes: dict[str, Any] = {"name": f"{scene.name}-planned"}
        sections, tables = dict[str, Any](), list[Path]()
        if way.trajectory is not None:
            table = there.with_suffix(".csv")
            moving: Coordinates = getattr(way.trajectory, "coordinates", "end-effector")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_table(table, way.trajectory, moving)
            changes["shaper"], tables = (), [table]
            sections["trajectory"] = {
                "kind": "table", "file": table.name, "coordinates": moving, "degree": 7, "dwell": scene.trajectory.dwell
            }  # fmt: skip
        written += [write_new(scene.model_copy(update=changes), there, comments, sections), *tables]
    return written


def write_plan(result: PlanResult, folder: Path) -> list[Path]:
    """Write planned scene, front and report into a folder, and remove those of an earlier plan.

    Returns:
        The files: ``planned.toml`` (with ``planned.csv`` for a motion of the joints), ``front.csv``, ``plan.json`` and
        ``plan.html``. The list is empty if the plan was interrupted and the folder's motion stays, since it misses limits less, or is as
        good for the same scene and wishes.

    Raises:
        ResultsError: a file can't be written.
    """
    out, chosen = OutputFolder(folder), result.chosen
    out.prepare()
    if result.interrupted and _standing(folder, result) <= (chosen.excess, chosen.worst(result.goals.wishes.minimise)):
        return []
    written = write_scene(result, folder / FILE)
    # those of a front that was asked for, to choose from
    for number, each in enumerate(result.table if result.goals.wishes.front else (), 1):
        written += write_scene(replace(result, chosen=each), folder / f"front-{number}.toml")
    texts = {"front.csv": result.to_csv(), "plan.json": to_json(summary(result)), "plan.html": plan_page(result)}
    written += [out.write(name, text) for name, text in texts.items()]
    for path in folder.iterdir():
        if OF_PLANS.fullmatch(path.name) and path not in written:
            out.remove(path.name)
    return written


def _standing(folder: Path, result: PlanResult) -> tuple[float, float]:
    """The excess over limits of the motion that a folder has, and what is minimised if it is for the same scene and wishes; infinite for none."""
    with contextlib.suppress(OSError, ValueError, LookupError, TypeError):
        there = json.loads((folder / "plan.json").read_text())
        is_same, chosen = there["work"] == _work(result.goals), there["chosen"]
        return float(chosen["excess"]), float(chosen[result.goals.wishes.minimise]) if is_same else math.inf
    return math.inf, math.inf


def _work(goals: Goals) -> str:
    """What tells scene and wishes from others."""
    about = [about_scene(each) for each in (goals.scene, goals.loop) if each is not None]
    return sha256(json.dumps(about).encode()).hexdigest()


def summary(result: PlanResult) -> dict[str, Any]:
    """The plan as plain data, in SI units; None for what isn't known."""

    def figures(each: Assessment) -> dict[str, Any]:
        keys = "name", "value", "limit", "unit", "where", "met"
        limits = [{key: getattr(use, key) for key in keys} for use in each.uses]
        return each.row | {"excess": each.excess, "limits": limits}

    def of_way(each: Assessment) -> dict[str, Any]:
        # what is relative to the given cycle, and what adds up over it, is limited for the cycle alone
        own = tuple(use for use in each.uses if not use.is_relative and use.figure not in OF_CYCLE)
        return figures(replace(each, uses=own))

    data = {
        "scene": result.goals.scene.name,
        "work": _work(result.goals),
        "minimise": result.goals.wishes.minimise,
        "payloads": list(result.goals.band),
        "given": figures(result.given),
        "chosen": figures(result.chosen),
        "front": [figures(each) for each in result.front],
        "tried": [
            {key: each.row[key] for key in ("motion", "method", "time")}
            | {"excess": each.excess, "missed": {use.name: use.share for use in each.missed}}
            for each in result.assessed
        ],
        "compared": [figures(each) for each in result.table if each not in result.front],
        "ways": [[of_way(each) for each in pair] for pair in result.ways],
        "verdict": result.verdict,
        "interrupted": result.interrupted,
        "failures": list(result.failures),
        "robustness": [{**vars(line), "missed": line.missed or ()} for line in result.robustness],
        "cpu_time": result.cpu_time,
    }
    plain: dict[str, Any] = pydantic_core.from_json(pydantic_core.to_json(data, inf_nan_mode="null"))
    return plain


def plan_page(result: PlanResult) -> str:
    """The page of a plan as HTML.

    Raises:
        ResultsError: a run for the signals failed.
    """
    note = f"No other motion found beats one of these in every figure of {', '.join(result.axes)}."
    if len(result.table) > len(result.front):
        note = "Motions that no other one beats in every figure, and for comparison those of other planners and files."
    tried = sorted(result.assessed, key=lambda each: (each.excess, each.time))
    missed = "Of what is missed, the largest share of its limit."
    tables = [
        *(summary_table(result), *ways_table(result), limits_table(result.chosen)),
        motions_table(result, "Pareto front", result.table, note),
        motions_table(result, "Motions that were tried", tried, missed, SHOWN[:2]),
        *robustness_table(result),
    ]
    caption = "The motions of the table. Dashed: the limit of the residual vibration."
    plots, compared = [result.front_plot(result.table, caption)], list[ComparedRun]()
    every = zip(result.goals.ways, result.given.candidate.ways, result.chosen.candidate.ways, strict=True)
    for number, (goals, *pair) in enumerate(every, 1):
        runs = [each.prepared().run() for each in pair]
        way = f", way {number}" if result.goals.cycle else ""
        for name, run in zip(NAMES, runs, strict=True):
            compared.append(ComparedRun(f"{name}{way}", run.recording, measure_run(run), run.plan.duration))
        plots += [_path_plot(goals, runs, way), _references_plot(result, runs, way)]
    low, high = result.goals.band
    # what was planned, and whether it keeps to all limits
    chosen = result.chosen.candidate
    what = chosen.label if chosen.method in chosen.label else f"{chosen.label} ({chosen.method})"
    lead = f"The motion: {what}; figures are given → planned, the worst over payloads of {low:.4g} to {high:.4g} kg."
    lead += " Stopped before the end: this is the best motion so far." if result.interrupted else ""
    verdict = Said.said(f"{result.verdict[0].upper()}{result.verdict[1:]}.", is_over=bool(result.missed))
    title, frame = f"{result.goals.scene.name}: planned motion", of_scene(runs[-1].scene, runs[-1])
    tables.append(metrics_table(compared))
    plots += compared_plots(compared)
    return Page(title, [verdict], plots, tables, _tiles(result), lead, **frame).html


def _tiles(result: PlanResult) -> list[tuple[str, Sequence[str]]]:
    """The time, the figures that limits are about and others, given and planned; in red what misses a limit."""
    limits = [use for use in result.chosen.uses if use.figure in PLAN_FIGURES and use.figure != "clearance"]
    tiles = list[tuple[str, Sequence[str]]]()
    for name in [*dict.fromkeys(["time", *(use.figure for use in limits), *FRONT])][:TILES]:
        uses = [use for use in limits if use.figure == name]
        texts = [f"limit {_shown(use)}{' times the given' if use.is_relative else ''}" for use in uses]
        given, planned = (display(name, each.worst(name), 4) for each in (result.given, result.chosen))
        values = given, Said.said(planned, is_over=not all(use.met for use in uses))
        tiles.append((", ".join([definition(name).label, *texts]), values))
    return tiles


def summary_table(result: PlanResult) -> Table:
    """Worst figures over the bands, of the given and the chosen motion."""
    rows = []
    for name, figure in PLAN_FIGURES.items():
        if name == "clearance":
            continue
        one, other = (each.worst(name) for each in (result.given, result.chosen))
        ratio = f"{other / one:.3g}" if one else "-"
        cells = result.given.shown(name), result.chosen.shown(name), ratio
        rows.append([f"{figure.label} [{figure.display_unit}]", *cells])
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
        rows.append([*names, *map(each.shown, figures), result.standing(each, 1 if is_brief else None)])
    return Table(title, header, rows, note)


def ways_table(result: PlanResult) -> list[Table]:
    """What each way of a cycle needs, of the given and the chosen one, the worst of its payloads; nothing for a single motion."""
    rows, figures = [], SHOWN[:6]
    for number, pair in enumerate(result.ways, 1):
        for name, each in zip(NAMES, pair, strict=True):
            masses = [robot.payload for robot in each.robots]
            payloads = dict.fromkeys(f"{mass:.4g}" for mass in (min(masses), max(masses)))
            rows.append([f"{number}, {name}", " to ".join(payloads), *map(each.shown, figures)])
    pauses = ", ".join(f"{goals.pause:g} s" for goals in result.goals.ways)
    header = ["Way", "Payloads [kg]", *map(heading, figures)]
    note = f"Each from rest, the worst of its payloads; pauses after them: {pauses}."
    return [Table("Ways of the cycle", header, rows, note)] if rows else []


def limits_table(found: Assessment) -> Table:
    """How close a motion comes to each limit, and where."""
    rows = []
    for use in found.uses:
        unit, share = "-" if use.unit == "1" else use.unit, f"{100 * use.share:.1f} %"
        kept = Said.said("yes" if use.met else "no", is_over=not use.met)
        rows.append([use.name, f"{use.value:.4g}", f"{use.limit:.4g}", unit, share, kept, use.where])
    header = ["Limit", "Value", "At most", "Unit", "Used", "Kept", "Where"]
    return Table("Limits", header, rows, "Worst over all robots of the bands. Clearance: depth in the keep-out region.")


def robustness_table(result: PlanResult) -> list[Table]:
    """The chosen motion in other models; nothing without them."""
    rows = []
    for line in result.robustness:
        values = line.residual, line.torque_ratio, line.off_path
        factors = 1e6, 1.0, 1e3
        cells = ["-" if math.isnan(value) else f"{k * value:.3g}" for value, k in zip(values, factors, strict=True)]
        kept = line.note if line.missed is None else "kept"
        limits = f"misses {', '.join(line.missed)}" if line.missed else kept
        rows.append([line.model, cells[0], line.where, *cells[1:], limits])
    header = ["Model", "Residual [µm]", "Worst for", "Torque ratio", "Off path [mm]", "Limits"]
    note = "Torques are relative to the given motion's in the same model."
    return [Table("In other models", header, rows, note)] if rows else []


def _path_plot(goals: Goals, runs: Sequence[Run], way: str = "") -> Plot:
    """The paths of the end effector, and what it keeps clear of."""
    paths = [np.column_stack([run.recording[name].values for name in POSITION]) for run in runs]
    curves = [
        Curve(path[:, 0], path[:, 1], name, colour) for name, colour, path in zip(NAMES, COLOURS, paths, strict=True)
    ]
    low, high = (pick(np.concatenate(paths), axis=0) for pick in (np.min, np.max))
    border = BORDER * float((high - low).max())
    outlines = [np.vstack([each.corners, each.corners[:1]]) for each in goals.clearance.regions]
    outlines += [origin + np.outer([-LONG, LONG], [-y, x]) for origin, (x, y) in goals.clearance.lines]
    for outline in outlines:
        # with more points between them, those near to the paths
        length = lengths(outline)
        points = interpolated(outline, np.union1d(length, np.arange(0.0, length[-1], DENSE * border)), length)
        is_near = np.all((points >= low - border) & (points <= high + border), axis=1)
        if is_near.any():
            label = "" if len(curves) > len(paths) else "keep-out"
            x, y = np.where(is_near, points.T, np.nan)
            curves.append(Curve(x, y, label, GREY, width=1.0, dashes=DOTTED, is_read=False))
    caption = "With the scene's own payload; dotted: regions to stay out of and lines not to cross."
    panel = Panel(label="y [m]", curves=curves, is_to_scale=True, is_function=False)
    return to_scale(f"path{way[-1:]}", f"Path of the end effector{way}", caption, panel)


def _references_plot(result: PlanResult, runs: Sequence[Run], way: str = "") -> Plot:
    """Speed, acceleration and jerk of the joint references, with their limits."""
    panels = list[Panel]()
    for order, name in enumerate(RATES, start=1):
        curves = []
        for motion, colour, run in zip(NAMES, COLOURS, runs, strict=True):
            joints = run.plan.joints
            instants = np.linspace(0.0, joints.duration, INSTANTS)
            values = joints.evaluate(instants, order, "left")[order]
            for joint, dashes in enumerate(((), REPEATED)):
                label = f"{motion} {joint + 1}"
                curves.append(Curve(instants, values[:, joint], label, colour, dashes=dashes))
        usual = np.array(result.given.worst(name))
        level = float(result.goals.limit(name, usual)) if name in result.goals.limits else None
        panels.append(Panel(heading(name).replace(" [", "\n["), curves, level=level))
    caption = "Both joints of both motions. Dashed: the limit, where it is near."
    return Plot(f"planned-references{way[-1:]}", f"Joint references{way}", caption, tuple(panels), height=330.0)
