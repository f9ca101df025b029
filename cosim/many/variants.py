"""Runs many variants of a scene with one FMU: other payloads, trajectories and FMU parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil
from numbers import Real
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.engine.master.simulator import Progress
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.many.lockstep import PeakMeasure, SideBySide, SignalMeasure
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.model.scene.schema import Scene

T = TypeVar("T")

Changes = Mapping[str, Any]
"""Changes of a variant: keys of the scene's section ``trajectory``, such as ``trajectory.duration``, and parameters of
the FMU, such as ``payload.mass``."""

FEW = 16
"""Fewer variants of one motion than this are simulated by the FMU, which needs no library for lockstep."""

DURATION = "trajectory.duration"
"""Key of the motion's duration [s]."""

WAY_BACK = "trajectory.way_back"
"""Key of the way back."""

BAND = 1.25
"""Largest ratio of durations side by side: their communication points are at the same places of the motion."""

SHARES, LARGEST_SHARE = 4, 1000
"""Shares of the variants for each process, and the largest number of variants in a share."""

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


class Variant(NamedTuple):
    """A variant of a scene: keys of the scene that are planned anew, and parameters of its FMU."""

    scene: Changes
    parameters: Changes


class VariantError(CosimError):
    """The run of a variant didn't reach its stop time; the message is that of the run."""


def run_variants(
    scene: Scene,
    variants: Sequence[Changes],
    measure: Callable[[Run], T],
    *,
    communication_step: float | None = None,
    tolerance: float | None = None,
    record: Selection | None = None,
    progress: Progress | None = None,
    processes: int = 1,
) -> list[VariantResult[T]]:
    """Simulate variants of a scene and measure each run.

    The FMU is built once; each motion is planned, and its references calculated, once for all variants with this motion.

    Variants that differ in parameters of a motion-driven robot (for peaks also in the motion's duration) are simulated side by
    side in the lanes of the processor's vector registers if ``measure`` tells which outputs it needs, as
    `flexfmu.cosim.metrics.metrics.measuring` does. They have common steps, chosen by the variant with the largest error: each
    result agrees with that of the variant's own run within the tolerance. Motions of other durations have communication points
    at the same places of the motion, at most ``communication_step`` apart. All other variants are runs of the FMU, to the last
    bit.

    Args:
        scene: the scene.
        variants: changes of each variant.
        measure: function from a completed run to the result, `flexfmu.cosim.metrics.metrics.metrics_of` for example.
        communication_step: as for `flexfmu.cosim.many.prepared_scene.run_scene`.
        tolerance: as for `flexfmu.cosim.many.prepared_scene.run_scene`.
        record: signals that ``measure`` needs, how often, and with how many derivatives; fewer take less time. None for
            the scene's keys.
        progress: called now and then with the completed fraction, 0..1.
        processes: number of processes; with more than one, ``measure`` must be picklable, such as a function of a module.

    Returns:
        The results in the order of the variants. A variant that can't be planned, simulated or measured has an error instead
        of a value and doesn't affect the others.

    Raises:
        BuildError: the FMU can't be built.
        InputError: the number of processes isn't whole or is below 1.
    """
    if not isinstance(processes, int) or processes < 1:
        raise InputError(
            f"variants need a whole number of processes from 1 on, got {processes}; give the number of processors to use"
        )
    task = VariantTask(scene, build_scene(scene).path, measure, communication_step, tolerance, record)
    split = [Variant(_part(each, motion=True), _part(each, motion=False)) for each in variants]
    done = 0

    def add(count: int) -> None:
        nonlocal done
        done += count
        if progress is not None and count:
            progress(done / len(variants))

    if processes == 1 or len(variants) < 2:
        found = task.outcomes(split, add)
    else:
        # shares of equal size: a few for each process, so that all finish at about the same time
        size = max(1, min(LARGEST_SHARE, ceil(len(variants) / (SHARES * processes))))
        found = []
        with mapping(task.outcomes, processes) as simulated:
            for outcomes in simulated(split[first : first + size] for first in range(0, len(split), size)):
                found += outcomes
                add(len(outcomes))
    return [
        VariantResult(changes, None, each) if isinstance(each, Exception) else VariantResult(changes, each)
        for changes, each in zip(variants, found, strict=True)
    ]


@dataclass(frozen=True)
class VariantTask(Generic[T]):
    """What to do with each variant; attributes as the arguments of `run_variants`, ``fmu_path`` the built FMU.

    What is planned, loaded and connected for a variant is kept for those that follow, also of later calls.
    """

    scene: Scene
    fmu_path: Path
    measure: Callable[[Run], T]
    communication_step: float | None = None
    tolerance: float | None = None
    record: Selection | None = None
    _last: list[PreparedScene] = field(default_factory=list, init=False, repr=False, compare=False)

    def outcomes(
        self, variants: Sequence[Variant], done: Callable[[int], None] = lambda count: None
    ) -> list[T | Exception]:
        """The results, or errors, in the order of the variants; ``done`` is called with numbers of completed variants."""
        # side by side what can be, and what is left by the FMU
        found: dict[int, T | Exception] = {}
        for members in self._bands(variants):
            found |= self._in_lockstep({i: variants[i] for i in members}, done)
        left = {i: variant for i, variant in enumerate(variants) if i not in found}
        for members in bands(left, lambda i: variants[i].scene):
            ready = _attempt(self._ready, variants[members[0]].scene)
            for i in members:
                found[i] = ready if isinstance(ready, Exception) else _attempt(self._single, ready, variants[i])
                done(1)
        return [found[i] for i in range(len(variants))]

    def _ready(self, changes: Changes) -> PreparedScene:
        """The prepared scene with these changes; where the motion alone is new, everything else is used again."""
        if not (self._last and self._last[0].replan(self._changed(changes))):
            self._last[:] = [self._prepared(changes)]
        return self._last[0]

    def _single(self, ready: PreparedScene, variant: Variant) -> T:
        """Simulate and measure one variant."""
        run = ready.run(variant.parameters)
        if not run.completed:
            raise VariantError(run.message)
        return self.measure(run)

    def _bands(self, variants: Sequence[Variant]) -> Iterator[list[int]]:
        """Yield the indices of variants that may be simulated side by side.

        They have the same motion; for peaks also motions of one shape, in bands of similar durations, the longest first.
        """
        measure = self.measure
        if not isinstance(measure, PeakMeasure | SignalMeasure):
            return
        # shapers, pauses, vibrations and ways back last as long in motions of other durations
        trajectory = self.scene.trajectory
        is_single = all(each.scene.get(WAY_BACK, trajectory.way_back) == "none" for each in variants)
        rigid = not self.scene.shaper and trajectory.references is None and is_single
        duration = (lambda i: self._duration(variants[i])) if isinstance(measure, PeakMeasure) and rigid else None
        found = bands(range(len(variants)), lambda i: variants[i].scene, duration)
        yield from (members for members in found if len(members) >= FEW)

    def _duration(self, variant: Variant) -> Any:
        """Duration of a variant's motion [s]."""
        return variant.scene.get(DURATION, self.scene.trajectory.duration)

    def _changed(self, changes: Changes) -> Scene:
        return self.scene.replace(dict(changes)) if changes else self.scene

    def _prepared(self, changes: Changes) -> PreparedScene:
        prepared = PreparedScene(
            self._changed(changes),
            communication_step=self.communication_step,
            tolerance=self.tolerance,
            fmu_path=self.fmu_path,
            record=self.record,
        )
        prepared.check_size(companion=False)
        return prepared

    def _in_lockstep(self, variants: Mapping[int, Variant], done: Callable[[int], None]) -> dict[int, T | Exception]:
        """The outcomes of those variants of a band that can be simulated in lockstep, by their keys."""
        measure, members = self.measure, [*variants.values()]
        changes = [each.parameters for each in members]
        durations = [self._duration(each) for each in members]

        def simulated() -> Iterable[T | Exception | None]:
            # the scene has the longest duration; the shortest must be valid too
            self._changed(members[-1].scene)
            together = SideBySide(
                self._changed(members[0].scene), self.fmu_path, self.communication_step, self.tolerance
            )
            if isinstance(measure, PeakMeasure):
                peaks = together.peaks(changes, measure.outputs, done, None if len(set(durations)) == 1 else durations)
                return [None if each is None else measure.of_peaks(each) for each in peaks]
            assert isinstance(measure, SignalMeasure)
            runs = together.runs(changes, measure.signals)
            return [None if run is None else self._measured(run, done) for run in runs]

        # where they can't be planned or simulated, the FMU tells why
        found = _attempt(simulated)
        if isinstance(found, Exception):
            return {}
        return {i: each for i, each in zip(variants, found, strict=True) if each is not None}

    def _measured(self, run: Run, done: Callable[[int], None]) -> T | Exception:
        """The outcome of a variant that was simulated."""
        outcome = _attempt(self.measure, run)
        done(1)
        return outcome


def bands(
    members: Iterable[int], motion: Callable[[int], Changes], duration: Callable[[int], Any] | None = None
) -> Iterator[list[int]]:
    """Yield members that can be simulated side by side, in their order.

    Args:
        members: numbers of variants.
        motion: number → changes of the scene, which members have in common.
        duration: number → the motion's duration, which may then differ, in bands of similar ones, the longest first; None where
            it must be the same.
    """
    groups: dict[str, list[int]] = {}
    for i in members:
        shape = sorted((key, value) for key, value in motion(i).items() if duration is None or key != DURATION)
        groups.setdefault(repr(shape), []).append(i)
    if duration is None:
        yield from groups.values()
        return
    for group in groups.values():
        # a duration that is no number is wrong, as the run of the FMU says
        lasting = {i: float(value) if isinstance(value := duration(i), Real) else 0.0 for i in group}
        ordered, first = sorted(group, key=lambda i: -lasting[i]), 0
        for k in range(1, len(ordered) + 1):
            if k == len(ordered) or lasting[ordered[first]] > BAND * lasting[ordered[k]]:
                yield ordered[first:k]
                first = k


def _part(changes: Changes, *, motion: bool) -> Changes:
    """The changes of the motion, or all others."""
    return {key: value for key, value in changes.items() if key.startswith(MOTION) == motion}


def _attempt(action: Callable[..., T], *arguments: Any) -> T | Exception:
    """The result of an action, or its exception, so that one failing variant doesn't end the sweep."""
    try:
        return action(*arguments)
    except Exception as error:
        return error
