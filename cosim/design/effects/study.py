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

from flexfmu.cosim.design.effects.choice import EXACT, Observed, choose_verified, named_metrics, observe, requirements
from flexfmu.cosim.design.effects.estimator import Estimator, MetricValues, scales
from flexfmu.cosim.design.effects.runs import followed
from flexfmu.cosim.design.effects.search import absent_effects, effects_of_loads, estimated_errors, neighbours, richer
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.showing import ShowProgress, quiet
from flexfmu.cosim.experiment.timing import fastest_in_turns
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.reports.summary import choice_summary
from flexfmu.cosim.reports.terminal import titled_table
from flexfmu.model.choice_text import choice_sentence, percent, set_text
from flexfmu.model.enrichment import Neighbour
from flexfmu.model.numeric import NumericModel, numeric_model
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.choice import (
    INTEGRATOR_SHARE,
    ChoiceSection,
    EstimatedEffect,
    MeasureName,
    integrator_tolerance,
)
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
        scene: with the chosen set; ``scene.effects.choice`` has the estimates.
        estimator: of the scene.
        cost: of the chosen set.
        rows: every effect: those in the set, those out of it, then the loads.
    """

    scene: Scene
    estimator: Estimator
    cost: Cost
    rows: tuple[EffectRow, ...]

    def __str__(self) -> str:
        """The chosen effects and their estimated errors, in one line."""
        return choice_sentence(self.scene)

    @property
    def choice(self) -> ChoiceSection:
        """How the effects were chosen: tolerance, metrics, estimated errors and contributions."""
        choice = self.scene.effects.choice
        assert choice is not None  # `choose_effects` sets it
        return choice


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
    limit, names = requirements(scene, tolerance, of)
    stated = scene.effects.tolerance
    if stated is None or scene.cosimulation.tolerance == integrator_tolerance(stated):
        # an integrator's tolerance that belongs to another choice, or to none, is replaced
        scene = scene.replace({"cosimulation.tolerance": integrator_tolerance(limit)})
    # the choice, and every set that differs by one effect or load
    joints = followed(scene)
    chosen, estimator = choose_verified(scene, joints, limit, names, named_metrics(scene, of), show, journal)
    show("looking at what the robot gives", None)
    choice = chosen.effects.choice
    assert choice is not None  # `choose_effects` sets it
    elastic = zip(neighbours(estimator, chosen), choice.effects, strict=True)

    def measured(each: Scene) -> MetricValues | None:
        """Metrics of a run in the loop, whose motors don't follow exactly; a loop may need the load that is left out."""
        if not chosen.controller or choice.verified_in == "motion":
            return None
        with suppress(CosimError):
            return observe(each, names, EXACT).metrics
        return None

    loads = effects_of_loads(estimator, chosen, joints, measured)
    found: list[tuple[Place, Scene, EstimatedEffect]] = [
        *(("in" if estimate.chosen else "out", each.scene, estimate) for (each, _), estimate in elastic),
        *(("given", each.scene, estimate) for each, estimate in loads),
    ]
    show("timing the equations", None)
    own, *others = costs([chosen, *(other for _, other, _ in found)])
    rows = tuple(EffectRow(place, each, cost) for (place, _, each), cost in zip(found, others, strict=True))
    return EffectStudy(chosen, estimator, own, rows)


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
        estimated: estimated change of each metric.
        observed: change of each metric between the two runs.
        slower: processor time of the richer set's run divided by that of the chosen set's.
    """

    effect: str
    change: str
    estimated: Mapping[MeasureName, float]
    observed: Mapping[MeasureName, float]
    slower: float

    @property
    def effectivity(self) -> float | None:
        """Effectivity index: largest estimated change divided by the largest observed one; None where none was observed."""
        observed = max(self.observed.values())
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
    # the runs to compare with
    chosen, estimator = study.scene, study.estimator
    names, is_alone = tuple(estimator.reference), study.choice.verified_in == "motion"
    show("running the chosen set", None)
    base = observe(chosen, names, EXACT, is_alone=is_alone)
    show("running the richest set", None)
    full = observe(estimator.richest, (*names, "peak_position_error"), EXACT, is_alone=is_alone)
    units = scales(full.metrics, estimator.named)

    def compare(effect: str, change: str, estimated: Mapping[MeasureName, float], other: Observed) -> EffectComparison:
        observed = {name: abs(other.metrics[name] - base.metrics[name]) / units[name] for name in names}
        own, longer = fastest_in_turns([base.run, other.run])
        return EffectComparison(effect, change, estimated, observed, longer / own)

    def one_more(each: Neighbour) -> EffectComparison:
        estimated = estimator.changes(chosen.effects, each.scene.effects)
        return compare(each.effect, each.change, estimated, observe(each.scene, names, EXACT, is_alone=is_alone))

    yield compare(EVERYTHING, "the richest set", estimated_errors(estimator, chosen), full)
    # one more of each effect within the estimator's richest set
    for each in richer(chosen):
        if estimator.covers(each.scene.effects):
            show(f"running with {each.effect}: {each.change}", None)
            unit = "check", chosen.effects.model_dump_json(), each.scene.effects.model_dump_json()
            yield journal.kept(unit, EffectComparison, partial(one_more, each))


def contribution_table(study: EffectStudy) -> Table:
    """Tabulate every effect with its contribution to each metric and its cost."""
    metrics = [f"{METRICS[name].label} {name}" for name in study.choice.of]
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
        estimated, observed = max(each.estimated.values()), max(each.observed.values())
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
        "scales": dict(study.estimator.scales),
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
            f"{METRICS[name].label.lower()} {percent(each)}" for name, each in zip(choice.of, values, strict=True)
        )
        for values in (choice.error, choice.verified or choice.error)
    )
    limit = (1.0 - INTEGRATOR_SHARE) * choice.tolerance
    # tables, then sentences
    lines = [
        *([f"the scene has no {absent}: it alone could say how large they are"] if absent else []),
        f"chosen for {percent(choice.tolerance)}: {set_text(study.scene)}",
        f"estimated error of this set: {worst}; it may be {percent(limit)}",
        f"error of its run beside the richest set, integration included: {verified}",
        f"tolerance of the FMU: {study.scene.cosimulation.tolerance:g}",
    ]
    return [contribution_table(study), *map(Text, lines)]
