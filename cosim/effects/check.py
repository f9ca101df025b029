"""Fidelity on demand: a chosen set of effects beside the next richer ones, in runs of their FMUs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from flexfmu.cosim.effects.choice import Step, quiet
from flexfmu.cosim.effects.study import EffectStudy
from flexfmu.cosim.effects.verified import EXACT, FmuOf, Observed, observe
from flexfmu.cosim.workprec.trial import fastest_in_turns
from flexfmu.model.choice_section import MeasureName
from flexfmu.model.selection.choose import estimated_errors
from flexfmu.model.selection.measures import scales
from flexfmu.model.selection.search import richer


@dataclass(frozen=True)
class Comparison:
    """A chosen set beside a richer one; changes of the metrics are relative to their scales.

    Attributes:
        effect, change: what the richer set has more.
        estimated: change of each metric without a run.
        observed: change of each metric between two runs.
        slower: processor time of the richer set's run over that of the chosen one's.
    """

    effect: str
    change: str
    estimated: Mapping[MeasureName, float]
    observed: Mapping[MeasureName, float]
    slower: float

    @property
    def effectivity(self) -> float | None:
        """Largest estimated over largest observed change; None where nothing was observed."""
        return effectivity(max(self.estimated.values()), max(self.observed.values()))


def effectivity(estimated: float, observed: float) -> float | None:
    """An estimate over what was observed; None where nothing was observed, beside which no estimate has a size."""
    return estimated / observed if observed else None


EVERYTHING = "everything"
"""Effect of the comparison with the richest set, whose estimate is that of the choice, safety included."""


def check_choice(study: EffectStudy, fmu_of: FmuOf | None = None, show: Step = quiet) -> tuple[Comparison, ...]:
    """Run the chosen set, the richest one and each next richer one; all of `comparisons`."""
    return tuple(comparisons(study, fmu_of, show))


def comparisons(study: EffectStudy, fmu_of: FmuOf | None = None, show: Step = quiet) -> Iterator[Comparison]:
    """The chosen set beside the richest one, then beside each next richer one, run when asked for.

    Args:
        study: the choice.
        fmu_of: where the FMUs come from; built, or taken from the cache, when None.
        show: told what is being done.

    Raises:
        BuildError: an FMU can't be built.
        ResultsError: a run failed.
    """
    chosen, estimator = study.scene, study.estimator
    names = tuple(estimator.reference)
    show("running the chosen set", None)
    base = observe(chosen, names, fmu_of, EXACT)
    show("running the richest set", None)
    full = observe(estimator.richest, (*names, "peak_position_error"), fmu_of, EXACT)
    units = scales(full.metrics, estimator.asked)

    def compare(effect: str, change: str, estimated: Mapping[MeasureName, float], other: Observed) -> Comparison:
        observed = {name: abs(other.metrics[name] - base.metrics[name]) / units[name] for name in names}
        own, longer = fastest_in_turns([base.run, other.run])
        return Comparison(effect, change, estimated, observed, longer / own)

    yield compare(EVERYTHING, "the richest set", estimated_errors(estimator, chosen), full)
    for each in richer(chosen):
        if estimator.covers(each.scene.effects):
            show(f"running with {each.effect}: {each.change}", None)
            estimated = estimator.changes(chosen.effects, each.scene.effects)
            yield compare(each.effect, each.change, estimated, observe(each.scene, names, fmu_of, EXACT))
