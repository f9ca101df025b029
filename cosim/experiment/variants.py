"""Many variants of one scene through one FMU: payloads, trajectories, and whatever else is a parameter."""

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
"""What a variant changes: keys of the scene's section ``trajectory``, such as ``trajectory.duration``, and parameters of
the FMU, such as ``payload.mass``."""

MOTION = "trajectory."
"""Prefix of keys that change the motion."""


@dataclass(frozen=True)
class VariantResult(Generic[T]):
    """The result of a variant.

    Attributes:
        changes: what it changes.
        value: what was measured; None where there is an error.
        error: what went wrong; None where nothing did.
    """

    changes: Changes
    value: T | None
    error: Exception | None = None


class VariantError(CosimError):
    """A variant's run ended before its time; the message is the run's."""


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
    """Simulate variants of a scene one after the other, and keep of each run what is asked for.

    The FMU is built and loaded once; each motion is planned once, and its references are calculated once for all
    variants that share it.

    Args:
        scene: the scene.
        variants: what each changes.
        measure: what to keep of a completed run, `flexfmu.cosim.metrics.metrics.metrics_of` for example.
        communication_step, tolerance: as for `flexfmu.cosim.experiment.prepared_scene.run_scene`.
        record: which signals ``measure`` needs; less takes less time.
        progress: called after each variant with the fraction that is done.

    Returns:
        The results in the order of the variants. Where one can't be planned, simulated or measured, it has an error
        instead of a value, and the others are as if it weren't there.

    Raises:
        BuildError: the FMU can't be built.
    """
    fmu_path = build_scene(scene).path

    def prepared(motion: Changes) -> PreparedScene:
        changed = scene.replace(dict(motion)) if motion else scene
        return PreparedScene(
            changed, communication_step=communication_step, tolerance=tolerance, fmu_path=fmu_path, record=record
        )

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
    """The changes to the motion, or all others."""
    return {key: value for key, value in variant.items() if key.startswith(MOTION) == motion}


def _result(variant: Changes, ready: PreparedScene | Exception, measure: Callable[[Run], T]) -> VariantResult[T]:
    """Simulate and measure one variant."""
    # the motion itself could not be planned
    if isinstance(ready, Exception):
        return VariantResult(variant, None, ready)

    def measured() -> T:
        run = ready.run(_part(variant, motion=False))
        if not run.completed:
            raise VariantError(run.message)
        return measure(run)

    # an error is the result of this variant alone
    outcome = _attempt(measured)
    return VariantResult(variant, None, outcome) if isinstance(outcome, Exception) else VariantResult(variant, outcome)


def _attempt(action: Callable[..., T], *arguments: Any) -> T | Exception:
    """The result of an action, or its error: one variant that fails must not end a sweep."""
    try:
        return action(*arguments)
    except Exception as error:
        return error
