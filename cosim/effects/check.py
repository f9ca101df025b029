"""Fidelity on demand: a chosen set of effects beside the next richer ones, in runs of their FMUs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from flexfmu.cosim.effects.choice import Step, quiet
from flexfmu.cosim.effects.study import EffectStudy
from flexfmu.cosim.errors import ResultsError
from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.metrics import measure_run
from flexfmu.cosim.workprec.trial import fastest_in_turns
from flexfmu.fmu_build.scene_build import build_scene
from flexfmu.model.choice_section import MeasureName
from flexfmu.model.scene import Scene
from flexfmu.model.selection.choose import estimated_errors
from flexfmu.model.selection.measures import scales
from flexfmu.model.selection.richest import richest
from flexfmu.model.selection.search import richer

FmuOf = Callable[[Scene], Path]
"""Scene → an FMU with its effects."""


@dataclass(frozen=True)
class Observed:
    """Metrics of a run, and the run, to be repeated."""

    metrics: Mapping[MeasureName, float]
    run: Callable[[], object]


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


EXACT = 1e-7
"""Tolerance of the FMUs in comparisons, so that the effects alone make the difference."""

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
    full = observe(richest(chosen), (*names, "peak_position_error"), fmu_of, EXACT)
    units = scales(full.metrics)

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


def observe(
    scene: Scene, of: tuple[MeasureName, ...], fmu_of: FmuOf | None = None, tolerance: float | None = None
) -> Observed:
    """Metrics of a scene's run without its controllers, shapers and imperfections, as the estimates are made.

    Args:
        scene: with its effects chosen.
        of: the metrics.
        fmu_of: where its FMU comes from; built, or taken from the cache, when None.
        tolerance: of the FMU; the scene's own when None.

    Raises:
        ResultsError: the run failed, or a metric doesn't exist.
    """
    bare = scene.replace({"controller": [], "shaper": [], "imperfection": [], "cosimulation.drive": "motion"})
    path = (fmu_of or _built)(bare)
    prepared = PreparedScene(bare, fmu_path=path, tolerance=tolerance)
    run = prepared.run()
    if not run.completed:
        raise ResultsError(f"the comparison with {scene.name} failed: {run.message}")
    measured = measure_run(run, companions=0)
    values = {name: measured[name].value for name in of}
    return Observed({name: value for name, value in values.items() if value is not None}, prepared.run)


def _built(scene: Scene) -> Path:
    """The scene's FMU; what was estimated isn't part of it, so that all choices of one set share it."""
    return build_scene(scene.replace({"effects.choice": None})).path
