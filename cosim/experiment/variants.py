"""Runs many variants of a scene with one FMU: other payloads, trajectories and FMU parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.master.master import Progress
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.model.scene.schema import Scene

T = TypeVar("T")

Changes = Mapping[str, Any]
"""Changes of a variant: keys of the scene's section ``trajectory``, such as ``trajectory.duration``, and parameters of
the FMU, such as ``payload.mass``."""

MOTION = "trajectory."
"""Prefix of keys that change the motion."""


@dataclass(frozen=True)
class VariantResult(Generic[T]):
    """The result of a variant.

    Attributes:
        changes: changes of the variant.
        value: result of ``measure``; None after an error.
        error: the exception; None if there was none.
    """

    changes: Changes
    value: T | None
    error: Exception | None = None


class VariantError(CosimError):
    """The run of a variant didn't reach its stop time; the message is that of the run."""


def run_variants(
    scene: Scene,
    variants: Sequence[Changes],
    measure: Callable[[Run], T],
    *,
    communication_step: float | None = None,
    tolerance: float | None = None,
    record: Selection = EVERYTHING,
    progress: Progress | None = None,
) -> list[VariantResult[T]]:
    """Simulate variants of a scene one after the other and measure each run.

    The FMU is built once; each motion is planned, and its references calculated, once for all variants with this motion.

    Args:
        scene: the scene.
        variants: changes of each variant.
        measure: function from a completed run to the result, `flexfmu.cosim.metrics.metrics.metrics_of` for example.
        communication_step, tolerance: as for `flexfmu.cosim.experiment.prepared_scene.run_scene`.
        record: signals that ``measure`` needs; fewer take less time.
        progress: called after each variant with the completed fraction, 0..1.

    Returns:
        The results in the order of the variants. A variant that can't be planned, simulated or measured has an error instead
        of a value and doesn't affect the others.

    Raises:
        BuildError: the FMU can't be built.
    """
    fmu_path = build_scene(scene).path

    last: list[PreparedScene] = []

    def prepared(motion: Changes) -> PreparedScene:
        changed = scene.replace(dict(motion)) if motion else scene
        # where the motion alone is new, everything else is used again
        if not (last and last[0].replan(changed)):
            last[:] = [
                PreparedScene(
                    changed,
                    communication_step=communication_step,
                    tolerance=tolerance,
                    fmu_path=fmu_path,
                    record=record,
                )
            ]
        return last[0]

    # variants with the same motion share a prepared scene
    found: dict[int, VariantResult[T]] = {}
    groups: dict[str, list[int]] = {}
    for i, variant in enumerate(variants):
        groups.setdefault(repr(sorted(_part(variant, motion=True).items())), []).append(i)
    for members in groups.values():
        ready = _attempt(prepared, _part(variants[members[0]], motion=True))
        for i in members:
            found[i] = _result(variants[i], ready, measure)
            if progress is not None:
                progress(len(found) / len(variants))
    return [found[i] for i in range(len(variants))]


def _part(variant: Changes, *, motion: bool) -> dict[str, Any]:
    """The changes of the motion, or all others."""
    return {key: value for key, value in variant.items() if key.startswith(MOTION) == motion}


def _result(variant: Changes, ready: PreparedScene | Exception, measure: Callable[[Run], T]) -> VariantResult[T]:
    """Simulate and measure one variant."""
    # the motion can't be planned
    if isinstance(ready, Exception):
        return VariantResult(variant, None, ready)

    def measured() -> T:
        run = ready.run(_part(variant, motion=False))
        if not run.completed:
            raise VariantError(run.message)
        return measure(run)

    # an error affects only this variant
    outcome = _attempt(measured)
    return VariantResult(variant, None, outcome) if isinstance(outcome, Exception) else VariantResult(variant, outcome)


def _attempt(action: Callable[..., T], *arguments: Any) -> T | Exception:
    """The result of an action, or its exception, so that one failing variant doesn't end the sweep."""
    try:
        return action(*arguments)
    except Exception as error:
        return error
