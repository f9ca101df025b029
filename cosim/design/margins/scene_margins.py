"""Margins of a scene's loop at poses along its path, or of a loop around a model; as a table for the terminal, as plain data, and as files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import degrees, isfinite, isnan, log, nan, pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.design.margins.course import PathLoop, Place, least_places, worst_places
from flexfmu.cosim.design.margins.linear_loop import LinearLoop
from flexfmu.cosim.design.margins.loop_warnings import coarse_counts
from flexfmu.cosim.design.margins.margins import FIGURES, LoopMargins, PoseMargins, pose_margins, shown_robot
from flexfmu.cosim.design.margins.measured_loop import MeasuredLoop, measured_margins
from flexfmu.cosim.design.margins.pictures import draw_root_locus, margin_plots
from flexfmu.cosim.design.margins.scene_loop import WiredLoop, WiredSystem, standing_for
from flexfmu.cosim.design.response.response import FrequencyResponse
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder, replacing
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.showing import Rows
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.user_slaves import SlaveNames, as_slave
from flexfmu.cosim.metrics.metric_table import LOOP_FIGURES
from flexfmu.cosim.reports.page import Page
from flexfmu.cosim.reports.page import Table as PageTable
from flexfmu.cosim.reports.report import of_scene
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.fmu_build.own_models import linear_about
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POSES = 5
"""Usual number of poses."""

BETTER_IF_LESS = ("gain_reduction", "sensitivity_peak")
"""Margins that are worse the larger they are."""


@dataclass(frozen=True, eq=False, repr=False)
class MarginsResult(Rows):
    """Margins of a loop along a path, or about a point of a model.

    Attributes:
        scene: the scene, or the model from equations.
        poses: margins at the poses that were asked for and at the worst ones, from start to end, then with other payloads; one of a model.
        linear: the linear loop at each pose.
        coarse_counts: what there is to say of encoders that are too coarse for the gains; None for fine ones.
        response: the plant's response that was measured; None where all is the model's.
    """

    scene: Scene | SymbolicModel
    poses: tuple[PoseMargins, ...]
    linear: tuple[LinearLoop, ...]
    coarse_counts: str | None = None
    response: FrequencyResponse | None = None

    def __repr__(self) -> str:
        """Return a line: what the margins say."""
        return f"Margins of {self.scene.name}. {self.verdict}"

    @property
    def is_stable(self) -> bool:
        """Whether the loop is stable at all poses."""
        return all(pose.is_stable for pose in self.poses)

    @property
    def own(self) -> MarginsResult:
        """Those with the robot's own payload."""
        count = sum(not pose.robot and pose.payload == self.poses[0].payload for pose in self.poses)
        return MarginsResult(self.scene, self.poses[:count], self.linear[:count])

    @property
    def worst(self) -> LoopMargins:
        """The worst value of each margin over all poses, all payloads and all cuts."""
        rows = [row for pose in self.poses for row in pose.loops]
        found = {}
        for name in FIGURES:
            values = [value for row in rows if not isnan(value := getattr(row, name))]
            found[name] = (max if name in BETTER_IF_LESS else min)(values, default=nan)
        # a loop that is unstable at a pose has neither there
        if not self.is_stable:
            found |= {"sensitivity_peak": nan, "bandwidth": nan}
        return LoopMargins.of("worst", *found.values())

    @property
    def verdict(self) -> str:
        """Whether the loop is stable, and the worst margins, in a sentence."""
        if self.is_stable:
            worst = self.worst
            return (
                f"The loop is stable: gain margin {worst.gain_reduction:.3g} to {worst.gain_margin:.3g}, phase margin "
                f"{degrees(worst.phase_margin):.3g}°, delay margin {1e3 * worst.delay_margin:.3g} ms."
            )
        several = len({each.carrier for each in self.poses}) > 1
        unstable = [each for each in self.poses if not each.is_stable]
        where = "; ".join(each.place(several) for each in unstable)
        if self.response is not None:
            return (
                f"Unstable at {where}: by encirclements of its response it has {unstable[0].unstable} unstable poles."
            )
        growth = max(pose.poles[0].real for pose in self.poses)
        return (
            f"Unstable at {where}: small motions grow tenfold in {1e3 * log(10.0) / growth:.3g} ms "
            f"(eigenvalues over a period reach {max(pose.radius for pose in self.poses):.4g})."
        )

    def plot(self) -> Figure:
        """Bode diagram of the open loops with their margins, and Nyquist diagram about -1 with the disk of the disk margin."""
        from flexfmu.cosim.reports.figure_style import figure_of  # Matplotlib takes longer than most commands

        return figure_of(margin_plots(self.poses), f"{self.scene.name}. {self.verdict}", columns=2)

    def page(self) -> str:
        """The page: verdict, the worst margins, those of each pose and cut, Bode and Nyquist diagrams of all open loops, as HTML."""
        heads = [" ".join(head.replace("-\n", "").split("\n")) for head in HEADS]
        rows = [
            [f"{pose.s:.2f}, {row.channel.removesuffix('.torque')}", *_texts(row)]
            for pose in self.poses
            for row in pose.loops
        ]
        table = PageTable("Margins", ["Place on the path, cut", *heads], rows, self.coarse_counts or "")
        names = (
            "gain margin",
            "gain may fall to",
            "phase margin, degrees",
            "delay margin, ms",
            "disk margin",
            "peak of the sensitivity",
        )
        tiles = [(name, [text]) for name, text in zip(names, _texts(self.worst), strict=False)]
        frame = of_scene(self.scene) if isinstance(self.scene, Scene) else {}
        return Page(
            f"Margins of {self.scene.name}", [self.verdict], margin_plots(self.poses), [table], tiles, **frame
        ).html

    def row_units(self) -> Mapping[str, str]:
        """Margin → unit."""
        return {"x": "m", "y": "m", "payload": "kg"} | {name: each.unit for name, each in LOOP_FIGURES.items()}

    def shown_rows(self) -> list[dict[str, Any]]:
        """The rows with the smallest disk margins first, then gain margins."""
        return sorted(self.rows(), key=lambda row: (row["disk_margin"], row["gain_margin"]))

    def rows(self) -> list[dict[str, Any]]:
        """A row for each pose and each cut, in SI units."""
        found, several = [], any(pose.robot for pose in self.poses)
        for pose in self.poses:
            place: dict[str, Any] = {"s": pose.s, "x": pose.position[0], "y": pose.position[1], "payload": pose.payload}
            place |= {"robot": pose.robot} if several else {}
            place |= {"stable": pose.is_stable, "radius": pose.radius}
            found += [place | {name: getattr(row, name) for name in ("channel", *FIGURES)} for row in pose.loops]
        return found


@one_blas_thread()
def scene_margins(
    scene: Scene,
    *,
    poses: int = POSES,
    payloads: Sequence[float] = (),
    robots: Sequence[Mapping[str, float]] = (),
    response: FrequencyResponse | None = None,
    progress: Callable[[float], None] = lambda fraction: None,
) -> MarginsResult:
    """The margins of a scene's loop at equilibria along its path, and at the worst ones.

    Args:
        scene: the scene, its effects chosen, driven by torques, with controllers.
        poses: number of poses, equally spaced along the path; between them the worst values are searched. 1 for the end alone.
        payloads: lightest and heaviest payload [kg]; the worst values are searched between them, too.
        robots: parameters of further robots, unknown to the controllers.
        response: of the robot at the end of the path, in place of the model's in its band; then there is no other pose.
        progress: called with the finished fraction, 0 to 1.

    Raises:
        InputError: the scene has no loop, a slave can't be linearised, or sample times have no common period.
        TrajectoryError: the motion isn't feasible.
        EquilibriumError: there is no equilibrium at a pose.
    """
    if poses < 1:
        raise InputError(f"the number of poses must be at least 1, got {poses}")
    loop = loop_of(scene, about_rest=True)
    wired = WiredLoop(scene, loop)
    path = PathLoop(wired, loop.motion)
    if response is not None:
        if payloads or robots:
            raise InputError(
                "a measured response is that of one robot: leave out the band of payloads, and what was identified"
            )
        linear, names = wired.at(path.position(1.0))
        model = pose_margins(linear, names, 1.0, path.position(1.0), path.joints(1.0), path.payload)
        measured = MeasuredLoop(linear, names, wired.wired, wired.plant(path.position(1.0)), response)
        pose = measured_margins(measured, names, model)
        return MarginsResult(scene, (pose,), (linear,), coarse_counts(scene, loop, wired), response)

    def margins_at(path: PathLoop, robot: str, place: Place) -> tuple[PoseMargins, LinearLoop]:
        s, payload = place.s, place.payload
        found = [
            (replace(pose_margins(linear, names, s, path.position(s), path.joints(s), payload), robot=robot), linear)
            for linear, names in path.loops(place)
        ]
        # where the motion passes twice, the worse of both
        return min(found, key=lambda each: min(each[0].measures))

    def measures(each: tuple[PoseMargins, LinearLoop]) -> tuple[float, ...]:
        return each[0].measures

    given = np.linspace(0.0, 1.0, poses).tolist() if poses > 1 else [1.0]
    searched = [*given, *path.breakpoints(scene)] if poses > 1 else given
    results, paths = list[tuple[PoseMargins, LinearLoop]](), [("", path)]
    paths += [(shown_robot(each), PathLoop(wired.around(each), loop.motion)) for each in robots]
    for number, (robot, path) in enumerate(paths):
        found = worst_places(
            partial(margins_at, path, robot),
            measures,
            searched,
            (path.payload,) if robot else (path.payload, *payloads),
            lambda share, number=number: progress((number + share) / len(paths)),  # type: ignore[misc]
        )
        # the poses that were asked for of the scene's robot, and the worst ones: with the robot's own payload, and with any
        own = {place: each for place, each in found.items() if place.payload == path.payload}
        worst = [*least_places(own, measures), *least_places(found, measures)]
        asked = () if robot else given
        chosen = [place for place in found if place in worst or (place.s in asked and place.payload == path.payload)]
        chosen.sort(key=lambda place: (place.payload != path.payload, place.payload, place.s))
        results += [found[each] for each in chosen]
    counts = coarse_counts(scene, loop, wired)
    return MarginsResult(scene, tuple(pose for pose, _ in results), tuple(linear for _, linear in results), counts)


@one_blas_thread()
def model_margins(
    slaves: Sequence[Any],
    wires: Sequence[tuple[str, str]],
    point: Mapping[str, float],
    response: FrequencyResponse | None = None,
) -> MarginsResult:
    """The margins of a loop around a model from equations, about a point.

    Args:
        slaves: the model, and what samples around it, as `flexfmu.simulate` takes them.
        wires: pairs (``slave.output``, ``slave.input``).
        point: state or input of the model → value; the start value for others.
        response: of the model's part, measured about the point, in place of the model's in its band.

    Raises:
        InputError: there isn't one model, it has sampled parts, the slaves can't be connected or linearised, or there is no loop.
        ModelError: the point has an unknown name, or the model gives no finite number there.
    """
    models = [k for k, each in enumerate(slaves) if isinstance(each, SymbolicModel)]
    if len(models) != 1:
        raise InputError(
            f"margins need one model from equations and its controllers, margins([axis, pd], {{'axis.torque': 'pd.torque'}}), "
            f"got {len(models)} models"
        )
    model, names = slaves[models[0]], SlaveNames(())
    if any(each.at_start and each.is_instant for each in model.events):
        raise InputError(f"model '{model.name}' samples inside: margins need its parts as slaves beside it")
    made = [standing_for(each, names.of_file(each.name)) if each is model else as_slave(each, names) for each in slaves]
    wired = WiredSystem(connect(made, wires), models[0])
    plant = linear_about(model, point, wired.measured)
    linear, channels = wired.about(plant)
    pose = pose_margins(linear, channels, nan, (nan, nan), (nan, nan))
    if response is not None:
        pose = measured_margins(MeasuredLoop(linear, channels, wired, plant, response), channels, pose)
    return MarginsResult(model, (pose,), (linear,), None, response)


HEADS = ("gain", "less", "phase\n°", "delay\nms", "disk", "peak\nS", "band-\nwidth\nHz", "cross-\nover\nHz")
"""Of the columns, short enough for 80 characters with all others."""


def margins_table(result: MarginsResult) -> list[RenderableType]:
    """The margins of each pose and each cut, the worst ones, and what they say."""
    tables, carriers = list[Table](), dict.fromkeys((each.robot, each.payload) for each in result.poses)
    for carrier in carriers:
        poses = [each for each in result.poses if (each.robot, each.payload) == carrier]
        several = f", {poses[0].carrier}" if len(carriers) > 1 else ""
        tables.append(titled_table(f"Margins of {result.scene.name}{several}", "path", "cut", numbers=HEADS))
        for pose in poses:
            for row in pose.loops:
                # of an unstable loop the crossover alone means something
                texts = _texts(row) if pose.is_stable else [*"-" * 7, _texts(row)[-1]]
                tables[-1].add_row(f"{pose.s:.2f}", row.channel.removesuffix(".torque"), *texts)
                if row.gain_margin.error is not None or row.phase_margin.error is not None:
                    errors = [nan if (error := getattr(row, name).error) is None else error for name in FIGURES]
                    tables[-1].add_row("", "±", *_texts(LoopMargins.of("", *errors)))
    tables[-1].add_row("", "worst", *_texts(result.worst))
    warning = [Text(f"warning: {result.coarse_counts}", style="yellow")] if result.coarse_counts else []
    return [*tables, Text(result.verdict), *warning]


def _texts(row: LoopMargins) -> list[str]:
    values = (
        row.gain_margin, row.gain_reduction, degrees(row.phase_margin), 1e3 * row.delay_margin, row.disk_margin,
        row.sensitivity_peak, row.bandwidth / (2 * pi), row.crossover / (2 * pi),
    )  # fmt: skip
    return ["∞" if value == float("inf") else "-" if value != value else f"{value:.3g}" for value in values]


def margins_data(result: MarginsResult) -> dict[str, Any]:
    """The margins as plain data, in SI units and rad; None for what is infinite or doesn't exist."""

    def plain(value: Any) -> Any:
        return None if isinstance(value, float) and not isfinite(value) else value

    poles = [(each.s, each.payload, each.poles.real.tolist(), each.poles.imag.tolist()) for each in result.poses]
    return {
        "scene": result.scene.name,
        "stable": result.is_stable,
        "worst": {name: plain(getattr(result.worst, name)) for name in FIGURES},
        "coarse_counts": result.coarse_counts,
        "rows": [{name: plain(value) for name, value in row.items()} for row in result.rows()],
        "standard_errors": [
            {name: getattr(row, name).error for name in FIGURES} for pose in result.poses for row in pose.loops
        ]
        if result.response is not None
        else None,
        "poles": [dict(zip(("s", "payload", "real", "imaginary"), each, strict=True)) for each in poles],
    }


@one_blas_thread()
def write_margins(result: MarginsResult, folder: Path) -> list[Path]:
    """Write ``margins.csv``, ``bode.png``, ``nyquist.png``, of a model ``root-locus.png``, and ``margins.html`` into a folder; return the files.

    Raises:
        ResultsError: a file can't be written.
    """
    from flexfmu.cosim.reports.figure_style import figure_of

    out = OutputFolder(folder)
    out.prepare()
    name, (bode, nyquist) = result.scene.name, margin_plots(result.poses)
    pictures = {"bode.png": figure_of([bode], f"{name}. {result.verdict}"), "nyquist.png": figure_of([nyquist], name)}
    if result.response is None:  # of which no eigenvalues are known
        pictures["root-locus.png"] = draw_root_locus(result.poses, result.linear, f"{name}: eigenvalues over a period")
    for file, figure in pictures.items():
        with replacing(folder / file) as path:
            figure.savefig(path, format="png", dpi=130)
    written = [out.write("margins.csv", result.to_csv()), *(folder / file for file in pictures)]
    return [*written, out.write("margins.html", result.page())]
