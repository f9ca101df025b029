"""Effect study: the choice of effects with contribution and cost of each effect, and runs of the chosen set beside richer sets; as data
and as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import casadi
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from flexfmu.cosim.design.effects.choice import EffectChoice, choose_effects, requirements
from flexfmu.cosim.design.effects.estimator import Estimator
from flexfmu.cosim.design.effects.runs import followed, with_settled
from flexfmu.cosim.design.effects.search import SAFETY, neighbours, richer
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.timing import fastest_in_turns
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import definition
from flexfmu.cosim.reports.summary import choice_summary
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.model.choice_text import choice_sentence, percent, set_text
from flexfmu.model.enrichment import Neighbour, reductions
from flexfmu.model.numeric import NumericModel, numeric_model
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.choice import INTEGRATOR_SHARE, ChoiceSection, EstimatedEffect, integrator_tolerance
from flexfmu.model.scene.effects import LOADS
from flexfmu.model.scene.schema import Scene

Place = Literal["in", "out", "given"]
"""In the chosen set, out of it, or given: a load of the robot, which can't be chosen."""

EVALUATIONS = 1000
"""Evaluations in one timed run."""

POSE = (2.5, 0.5, 0.0, 0.0, 0.0, 0.0)
"""Motor angles, rates and accelerations of the timed evaluations: a regular pose at rest."""


@dataclass(frozen=True)
class Cost:
    """Cost of one evaluation of the equations of motion and of the outputs.

    Attributes:
        states: number of elastic coordinates.
        operations: number of elementary operations.
        time: CPU time [s] in CasADi's interpreter; compiled C is faster by a factor common to all sets.
    """

    states: int
    operations: int
    time: float


@dataclass(frozen=True)
class EffectRow:
    """An effect and the neighbouring set: the chosen set without the effect, or with it where it is out of the set.

    Attributes:
        place: in the chosen set, out of it, or given.
        estimate: the effect and its contribution to each metric.
        cost: of the neighbouring set.
    """

    place: Place
    estimate: EstimatedEffect
    cost: Cost


@dataclass(frozen=True)
class EffectStudy:
    """A choice of effects, with contribution and cost of each effect.

    Attributes:
        chosen: the choice, with its runs and estimates.
        cost: of the chosen set.
        rows: every effect: those in the set, those out of it, then the loads.
    """

    chosen: EffectChoice
    cost: Cost
    rows: tuple[EffectRow, ...]

    def __str__(self) -> str:
        """The chosen effects and their errors, in one line."""
        return choice_sentence(self.scene)

    @property
    def scene(self) -> Scene:
        """The scene with the chosen set."""
        return self.chosen.scene

    @property
    def choice(self) -> ChoiceSection:
        """How the effects were chosen: tolerance, metrics, errors and contributions."""
        return self.chosen.section


@one_blas_thread()
def study_effects(
    scene: Scene,
    tolerance: float | None = None,
    of: tuple[str, ...] = (),
    show: ShowProgress = quiet,
    journal: WorkJournal = NOWHERE,
) -> EffectStudy:
    """Choose a scene's effects and study each of them.

    Args:
        scene: any scene; its own elastic effects are ignored.
        tolerance: relative tolerance; default as for `requirements`.
        of: metrics; default as for `requirements`.
        show: called with the current activity and the finished fraction.
        journal: where the metrics of estimates and runs are kept, also from an earlier call for the same scene and metrics.

    Raises:
        BuildError, ResultsError: as for `resolved`.
        SceneError: the tolerance or a metric is impossible.
        TrajectoryError: the motion isn't feasible.
    """
    limit, _ = requirements(scene, tolerance, of)
    stated = scene.effects.tolerance
    if stated is None or scene.cosimulation.tolerance == integrator_tolerance(stated):
        # an integrator's tolerance that belongs to another choice, or to none, is replaced
        scene = scene.replace({"cosimulation.tolerance": integrator_tolerance(limit)})
    # the choice, and every set that differs by one effect or load
    choice = choose_effects(scene, tolerance, of, show, journal)
    show("looking at what the robot gives", None)
    elastic = zip(neighbours(choice.chooser.estimates, choice.scene), choice.section.effects, strict=True)
    found: list[tuple[Place, Scene, EstimatedEffect]] = [
        *(("in" if estimate.chosen else "out", each.scene, estimate) for (each, _), estimate in elastic),
        *(("given", each.scene, estimate) for each, estimate in effects_of_loads(choice)),
    ]
    show("timing the equations", None)
    own, *others = costs([choice.scene, *(other for _, other, _ in found)])
    rows = tuple(EffectRow(place, each, cost) for (place, _, each), cost in zip(found, others, strict=True))
    return EffectStudy(choice, own, rows)


def effects_of_loads(choice: EffectChoice) -> Iterator[tuple[Neighbour, EstimatedEffect]]:
    """Yield, for each load of the robot, the scene without it and the change of the metrics.

    It is that of runs where a controller acts, whose motors don't follow exactly, and of estimates where the loop can't run without the
    load, as often without the motors' inertia.
    """
    chosen, estimates = choice.scene, choice.chooser.estimates
    metrics, scales = estimates.metrics(chosen.effects), choice.scales
    for without in (each for each in reductions(chosen) if each.effect in LOADS):
        found = dict[str, float]()
        if chosen.controller and choice.section.verified_in == "scene":
            with suppress(CosimError):
                found = choice.change(chosen, without.scene)
        if not found:
            others = Estimator(without.scene, followed(chosen), tuple(metrics), without.scene).reference
            found = {name: abs(others[name] - metrics[name]) / scales[name] for name in metrics if name in scales}
        shares = tuple(found.get(name) for name in choice.section.of)
        yield (without, EstimatedEffect(effect=without.effect, change=without.change, chosen=True, contribution=shares))


def absent_effects(scene: Scene) -> tuple[str, ...]:
    """Return the keys of loads that the robot doesn't have."""
    return tuple(key for key in LOADS if key not in scene.loads)


def costs(scenes: Sequence[Scene]) -> list[Cost]:
    """The costs of the scenes' sets of effects."""
    models = [numeric_model(scene) for scene in scenes]

    def evaluation(model: NumericModel) -> Callable[[], object]:
        mapped = [function.map(EVALUATIONS) for function in (model.elastic_forces, model.motion)]
        at_rest = casadi.DM.zeros(model.n, EVALUATIONS)
        arguments = [at_rest, at_rest, at_rest, casadi.repmat(casadi.DM(POSE), 1, EVALUATIONS)]
        return lambda: [function.call(arguments) for function in mapped]

    times = fastest_in_turns([evaluation(model) for model in models])
    return [
        Cost(model.n, model.elastic_forces.n_instructions() + model.motion.n_instructions(), time / EVALUATIONS)
        for model, time in zip(models, times, strict=True)
    ]


@dataclass(frozen=True)
class EffectComparison:
    """The chosen set compared with a richer one; changes of the metrics are relative to their scales.

    Attributes:
        effect, change: effect that the richer set adds, and how.
        estimated: estimated change of each metric that has an estimate.
        observed: change of each metric between the two runs.
        slower: processor time of the richer set's run divided by that of the chosen set's.
    """

    effect: str
    change: str
    estimated: Mapping[str, float]
    observed: Mapping[str, float]
    slower: float

    @property
    def effectivity(self) -> float | None:
        """Effectivity index: largest estimated change divided by the largest observed one; None where none was observed."""
        observed = max((self.observed[name] for name in self.estimated), default=0.0)
        return max(self.estimated.values()) / observed if observed else None


EVERYTHING = "everything"
"""Effect in the comparison with the richest set; its estimated change includes the safety factor."""


def comparisons(
    study: EffectStudy, show: ShowProgress = quiet, journal: WorkJournal = NOWHERE
) -> Iterator[EffectComparison]:
    """Compare runs of the chosen set with the richest one, then with each next richer one; runs are made on demand.

    Args:
        study: the choice.
        show: called with the current activity and the finished fraction.
        journal: where comparisons are kept.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    chosen, chooser = study.chosen, study.chosen.chooser
    estimates, tolerance = chooser.estimates, study.choice.tolerance

    def compare(effect: str, change: str, other: Scene, factor: float = 1.0) -> EffectComparison:
        # estimated errors are in units of what is allowed
        most = other if estimates.covers(other.effects) else estimates.richest
        estimated = estimates.changes(study.scene.effects, most.effects)
        observed = chosen.change(study.scene, other)
        settled = (with_settled(chooser.exact(chosen.as_run(each))) for each in (study.scene, other))
        own, longer = fastest_in_turns([PreparedScene(each).run for each in settled])
        shares: dict[str, float] = {
            name: factor * tolerance * each for name, each in estimated.items() if name in observed
        }
        return EffectComparison(effect, change, shares, observed, longer / own)

    show("running the richest set", None)
    yield compare(EVERYTHING, "the richest set", chooser.richest, SAFETY)
    # one more of each effect within the richest set
    for each in richer(study.scene):
        if estimates.covers(each.scene.effects):
            show(f"running with {each.effect}: {each.change}", None)
            unit = "check", study.scene.effects.model_dump_json(), each.scene.effects.model_dump_json()
            yield journal.kept(unit, EffectComparison, partial(compare, each.effect, each.change, each.scene))


def contribution_table(study: EffectStudy) -> Table:
    """Tabulate every effect with its contribution to each metric and its cost."""
    metrics = [f"{definition(name).label} {name}" for name in study.choice.of]
    table = titled_table(
        f"{study.scene.name}: what each effect is worth, as relative change of each metric, and what it costs",
        *(" ", "Effect", "Change"),
        numbers=(*metrics, "states", "operations", "time"),
    )
    # the chosen set, then the extra cost of each neighbouring set
    cost = study.cost
    own = f"{cost.states}", f"{cost.operations}", f"{1e6 * cost.time:.3g} µs"
    table.add_row("", "the set itself", "", *("" for _ in metrics), *own)
    for row in study.rows:
        states, operations = row.cost.states - cost.states, row.cost.operations - cost.operations
        slower, each = 100.0 * (row.cost.time / cost.time - 1.0), row.estimate
        more = f"{states:+d}" if states else "", f"{operations:+d}", f"{slower:+.0f} %"
        table.add_row(row.place, each.effect, each.change, *map(percent, each.contribution), *more)
    return table


def comparison_table(comparisons: Iterable[EffectComparison]) -> Table:
    """Tabulate estimated and observed changes of the metrics."""
    table = titled_table(
        "the chosen set beside richer ones: largest change over the metrics",
        *("Effect", "Change"),
        numbers=("estimated", "observed", "effectivity", "time of a run"),
    )
    # the largest change over the metrics of each comparison
    for each in comparisons:
        estimated, observed = max(each.estimated.values(), default=None), max(each.observed.values())
        ratio = "–" if each.effectivity is None else f"{each.effectivity:.2f}"
        table.add_row(each.effect, each.change, percent(estimated), percent(observed), ratio, f"{each.slower:.2f} x")
    return table


def study_data(study: EffectStudy, comparisons: Iterable[EffectComparison]) -> dict[str, Any]:
    """Return study and comparisons as plain data in SI units; errors and contributions are relative to `scales`."""
    choice = study.choice
    data: dict[str, Any] = {
        "scene": study.scene.name,
        **choice_summary(study.scene),
        "limit": (1.0 - INTEGRATOR_SHARE) * choice.tolerance,
        "scales": study.chosen.scales,
        "cost": vars(study.cost),
        "absent": absent_effects(study.scene),
        "effects": [
            {
                "effect": row.estimate.effect,
                "change": row.estimate.change,
                "place": row.place,
                "contribution": dict(zip(choice.of, row.estimate.contribution, strict=True)),
                "cost": vars(row.cost),
            }
            for row in study.rows
        ],
    }
    # comparisons with richer sets, where there are any
    keys = ("effect", "change", "estimated", "observed", "effectivity", "slower")
    found = [{key: getattr(each, key) for key in keys} for each in comparisons]
    return data | ({"check": found} if found else {})


def report(study: EffectStudy) -> list[RenderableType]:
    """Return the tables of all effects, and the choice in sentences."""
    # values for the sentences
    choice, absent = study.choice, ", ".join(absent_effects(study.scene))
    worst, verified = (
        ", ".join(
            f"{definition(name).label.lower()} {percent(each)}" for name, each in zip(choice.of, values, strict=True)
        )
        for values in (choice.error, choice.verified or choice.error)
    )
    limit = f"it may be {percent((1.0 - INTEGRATOR_SHARE) * choice.tolerance)}"
    if not study.chosen.chooser.is_estimated:
        limit = "of motors that follow the motion exactly, or of other metrics: runs have decided"
    # tables, then sentences
    lines = [
        *([f"the scene has no {absent}: it alone could say how large they are"] if absent else []),
        f"chosen for {percent(choice.tolerance)}: {set_text(study.scene)}",
        f"estimated error of this set: {worst}; {limit}",
        f"error of its run beside the richest set, integration included: {verified}",
        f"tolerance of the FMU: {study.scene.cosimulation.tolerance:g}",
    ]
    return [contribution_table(study), *map(Text, lines)]
