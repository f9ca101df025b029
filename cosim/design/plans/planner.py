"""Plans a motion: search, references for the flexible robot and optimal control, judged by the FMU, the best one chosen."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np

from flexfmu.cosim.design.limits import Limit
from flexfmu.cosim.design.plans.assessment import FIGURES, JUDGED, Assessment, Candidate, Judge, heading, noted, shown
from flexfmu.cosim.design.plans.drive_table import DriveTable, drive_table
from flexfmu.cosim.design.plans.goals import LOOP_PARTS, Goals, check_holding_torque, checked_goals, judged_scene
from flexfmu.cosim.design.plans.optimal import flexible, optimal
from flexfmu.cosim.design.plans.robustness import RobustnessLine, robustness
from flexfmu.cosim.design.plans.sampled_loop import with_learned_torques
from flexfmu.cosim.design.plans.search import search
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.showing import Rows, ShowProgress, quiet
from flexfmu.cosim.experiment.metric import RunMetrics
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.timing import processor_time
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import static_equilibrium

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Method = Callable[[Judge, Sequence[Assessment], int, ShowProgress], Iterator[Candidate | str]]

METHODS: Mapping[str, Method] = {"search": search, "flexible": flexible, "optimal": optimal}
"""Methods in the order in which they run, what one finds, the next can start from: from the judge, what it has assessed before, the
number of processes and where to show progress to all candidates that are tried, and why there is none from a start."""

FRONT = ("time", "residual", "torque", "energy", "off_path")
"""Figures that the Pareto front weighs against each other."""

BINDING = 0.98
"""Used share of a limit from which on the verdict names it."""

MANY = 20.0
"""Ratio of the largest to the smallest value from which on a diagram is logarithmic."""

ALIKE = 1e-3
"""Relative difference of all figures of a front below which the front has one of two motions."""

NO_SAG = 1e-12
"""Sag [m] below which an undeformed start is at rest."""


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
        chosen, given = self.chosen.metrics, self.given.metrics
        for name in (*FRONT, "rms_torque", "power"):
            unit = FIGURES[name].display_unit
            lines.append(f"  {name}: {shown(name, chosen[name])} {unit} (given {shown(name, given[name])})")
        return "\n".join([*lines, f"  {self.verdict}"])

    @cached_property
    def ways(self) -> tuple[tuple[Assessment, Assessment], ...]:
        """The given and the chosen motion of each way of a cycle, from rest; empty for a single motion."""
        judge = Judge(self.goals, JUDGED)
        pairs = (judge.of_ways(each.candidate, given=each is self.given) for each in (self.given, self.chosen))
        return tuple(zip(*pairs, strict=True))

    @property
    def metrics(self) -> RunMetrics:
        """The figures of the chosen motion, the worst within the bands."""
        return self.chosen.metrics

    @cached_property
    def scene(self) -> Scene:
        """The scene with the chosen motion; a motion of the joints is in ``chosen.candidate.trajectory``."""
        scene, mass, loop = self.chosen.candidate.scene, self.goals.payload, self.goals.loop
        if loop is not None:
            # the motion, followed by the controllers
            loop = with_learned_torques(loop, self.chosen.candidate.joints, scene.trajectory.dwell)
            scene = scene.model_copy(update={key: getattr(loop, key) for key in ("cosimulation", *LOOP_PARTS)})
        return scene if mass is None else scene.replace({"payload.mass": mass})

    def drive_table(self, rate: float, unit: str = "rad", counts: float | None = None) -> DriveTable:
        """The chosen motion or cycle as a drive reads it; arguments and errors as for `flexfmu.cosim.design.plans.drive_table.drive_table`."""
        return drive_table(Judge(self.goals, JUDGED), self.chosen.candidate, rate, unit, counts)

    @property
    def axes(self) -> tuple[str, ...]:
        """The figures that the front weighs: those of the wishes, the time first, or `FRONT`."""
        return tuple(sorted(self.goals.wishes.front, key=lambda each: each != "time")) or FRONT

    @property
    def front(self) -> tuple[Assessment, ...]:
        """The candidates, the given motion included, of which no other is better in every figure of `axes`; the fastest first.

        A motion that misses a limit isn't better than one that keeps all. The chosen motion is always there.
        """
        # the chosen one first, so that none like it replaces it
        everyone = sorted((self.given, *self.assessed), key=lambda each: (each is not self.chosen, each.time))
        values, kept = np.array([[each.worst(name) for name in self.axes] for each in everyone]), list[int]()
        for k, each in enumerate(everyone):
            others = values[[other.feasible or not each.feasible for other in everyone]]
            is_beaten = ((others <= values[k]).all(axis=1) & (others < values[k]).any(axis=1)).any()
            is_there = np.isclose(values[kept], values[k], rtol=ALIKE, atol=0.0).all(axis=1).any()
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
        return tuple(use for use in self.chosen.uses if not use.met)

    @property
    def verdict(self) -> str:
        """Whether the chosen motion keeps to all limits, in a sentence."""
        if self.missed:
            listed = [f"{use.name} {use.value:.4g} instead of {use.limit:.4g} ({use.where})" for use in self.missed]
            so_far = " so far" if self.interrupted else ""
            in_loop = any(use.name == "loop_residual" for use in self.missed)
            remedy = ": finer encoders, shorter sample times or other gains leave less in the loop" if in_loop else ""
            return f"no motion found{so_far} keeps all limits; the nearest misses {', '.join(listed)}{remedy}"
        uses = sorted(self.chosen.uses, key=lambda use: -use.share)
        closest = [use for use in uses if use is uses[0] or use.share > BINDING]
        listed = [f"{use.name} {use.value:.4g} of {use.limit:.4g} ({use.where})" for use in closest]
        return f"all limits are kept; the closest {'is' if len(closest) == 1 else 'are'} {', '.join(listed)}"

    def row_units(self) -> Mapping[str, str]:
        """Figure → unit."""
        return {name: figure.unit for name, figure in FIGURES.items()}

    def plot(self) -> Figure:
        """What all motions need: each figure of the front over its first one; those that miss a limit are hollow."""
        from flexfmu.cosim.reports.figure_style import INK, draw, logarithmic, style

        along, *names = self.axes
        groups = {
            "": (self.assessed, "o", 3.5, INK),
            "given": ((self.given,), "s", 7.0, "#1f8a5f"),
            "chosen": ((self.chosen,), "D", 7.0, "#c7394f"),
        }
        with style():
            rows = (len(names) + 1) // 2
            drawing = draw(9.0, 2.8 * max(rows, 1.5))
            grid = drawing.subplots(rows, min(len(names), 2), sharex=True, squeeze=False).ravel()
            for axes, name in zip(grid, names, strict=True):
                figure, values = FIGURES[name], [each.worst(name) for each in (*self.assessed, self.given)]
                for label, (motions, sign, size, colour) in groups.items():
                    for each in motions:
                        x, y = each.worst(along), figure.displayed(each.worst(name))
                        face = colour if each.feasible else "none"
                        axes.plot(x, y, sign, markersize=size, color=colour, markerfacecolor=face, label=label)
                if max(values) > MANY * min(values) > 0.0:
                    logarithmic(axes)
                axes.set_title(f"{figure.label} [{figure.display_unit}]", fontsize=8.5)
            for axes in grid[-2:]:
                axes.set_xlabel(heading(along))
            drawing.axes[0].legend(fontsize=8)
            drawing.suptitle(f"{self.goals.scene.name}: motions that were tried; hollow: misses a limit", fontsize=10)
        return drawing

    def rows(self) -> list[dict[str, Any]]:
        """The front, and motions to compare with, as rows: label, method, figures, and whether all limits are kept."""
        return [each.row for each in self.table]


@one_blas_thread()
def plan_scene(
    scene: Scene,
    *,
    methods: Collection[str] = METHODS,
    candidates: Sequence[Candidate] = (),
    before: Sequence[Scene] = (),
    processes: int = 1,
    budget: float | None = None,
    robust: bool = True,
    show: ShowProgress = quiet,
    journal: WorkJournal = NOWHERE,
) -> PlanResult:
    """Plan a motion for the wishes of a scene's section `plan`.

    Args:
        scene: the scene.
        methods: which of `METHODS`.
        candidates: further motions that are assessed beside those found.
        before: the planned scenes of an earlier plan, one for each way: optimal control goes on from them, and alone unless ``methods`` has more.
        processes: number of processes of the search.
        budget: time [s] after which it ends as after Ctrl-C; None for no limit.
        robust: whether the chosen motion is judged in richer models too, see `flexfmu.cosim.design.plans.robustness`.
        show: is called with what is being done.
        journal: where all that is found is kept, also from an earlier call for the same scene.

    Returns:
        The result; after Ctrl-C that of what was assessed so far.

    Raises:
        InputError: wishes contradict each other, or a method is unknown.
        TrajectoryError, SceneError, BuildError, ResultsError: the given motion can't be planned or run.
    """
    if unknown := [name for name in methods if name not in METHODS]:
        raise InputError(f"unknown method {', '.join(unknown)}; choose from {', '.join(METHODS)}")
    work, clock = processor_time(), monotonic()
    goals = checked_goals(scene)
    count, is_optimal, named = len(goals.ways or (goals,)), "optimal" in methods, ", ".join(methods)
    wrong = ""
    if before and len(before) != count:
        wrong = f"the earlier plan has {len(before)} motions, and this one {count}: warm starts are from as many ways"
    elif before and not is_optimal:
        wrong = "optimal control goes on from an earlier plan: choose the method optimal too, or start anew"
    elif goals.ways and candidates:
        wrong = "motions of your own are compared with single motions: leave out `plan.cycle`, or the motions"
    elif goals.ways and methods and not is_optimal:
        wrong = f"a cycle is planned by optimal control alone, not by {named}: choose it, or leave out `plan.cycle`"
    elif goals.wishes.front and not is_optimal:
        wrong = "`plan.front` is found by optimal control: choose the method optimal too, or leave out the front"
    if wrong:
        raise InputError(wrong)
    goals = replace(goals, before=tuple(plan(each).once.joints for each in before))
    if goals.ways:
        # other methods and models are for single motions
        methods, robust = [name for name in methods if name == "optimal"], False
    show("the given motion", None)
    PreparedScene(scene).check_size(companion=False)
    judge, is_new = Judge(goals, JUDGED, journal), not journal.done
    try:
        check_holding_torque(goals, {each.variation: each.values["torque"] for each in judge.given.peaks})
    except InputError:
        # another plan may begin in its folder
        if is_new:
            journal.remove()
        raise
    found, failures = [judge.given], list[str]()
    # what is planned otherwise than the scene says
    start = goals.given.once.joints.evaluate([0.0], 0, "right")[0, 0]
    away = float(np.hypot(*(static_equilibrium(goals.scene, start).position - goals.trace[0])))
    if scene.cosimulation.initial == "undeformed" and away > NO_SAG:
        failures.append(
            f'`cosimulation.initial = "undeformed"` starts {1e6 * away:.3g} µm off the equilibrium, and the robot swings from there '
            f'whatever the motion: planned from rest, `initial = "static"`, which the planned scene has'
        )
    candidates = [replace(each, scene=judged_scene(each.scene, goals.wishes)) for each in candidates]

    def proposed() -> Iterator[Candidate | str]:
        yield from candidates
        for name in (each for each in METHODS if each in methods):
            with noted(failures, name):
                yield from METHODS[name](judge, found, processes, watched)

    def watched(text: str, share: float | None) -> None:
        show(text, share)
        if budget is not None and monotonic() - clock > budget:
            raise KeyboardInterrupt

    def assess(candidate: Candidate) -> None:
        with noted(failures, candidate.label):
            found.append(judge.assess(candidate))

    interrupted = False
    try:
        for candidate in proposed():
            if isinstance(candidate, str):
                failures.append(candidate)
                continue
            assess(candidate)
            chosen = best(found, goals.wishes.minimise)
            watched(f"{chosen.time:.4g} s, {1e6 * chosen.residual:.2g} µm: {chosen.candidate.label}", None)
    except KeyboardInterrupt as interruption:
        interrupted = True
        # what was being improved
        for each in interruption.args:
            assess(each)
    chosen, lines = best(found, goals.wishes.minimise), list[RobustnessLine]()
    try:
        for line in robustness(chosen.candidate, goals, journal=journal) if robust and not interrupted else ():
            show(f"the chosen motion in other models: {line.model}", None)
            lines.append(line)
    except KeyboardInterrupt:
        interrupted = True
    work = processor_time() - work
    return PlanResult(goals, judge.given, chosen, tuple(found[1:]), tuple(failures), interrupted, work, tuple(lines))


def about_plan(scene: Scene, before: Sequence[Scene]) -> dict[str, Any]:
    """What determines the results of a plan, for its journal: the scene, and the earlier plan that it goes on from."""
    return about_scene(scene) | ({"before": [about_scene(each) for each in before]} if before else {})


def best(found: Sequence[Assessment], minimise: str) -> Assessment:
    """Of motions that keep to all limits the one with least of what is minimised, preferring those planned for all robots; without one the
    motion whose worst excess is least."""
    return min(found, key=lambda each: (each.excess, each.candidate.is_rough, each.worst(minimise)))
