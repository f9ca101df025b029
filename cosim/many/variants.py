"""Runs many variants of a scene with one FMU: other payloads, trajectories and FMU parameters; and those of a motion-driven scene side by side:
which variants can, and what is measured of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, inf
from numbers import Real
from pathlib import Path
from sys import float_info
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import Progress
from flexfmu.cosim.engine.results import Column, Recording, Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Health, RestPositions, Run, Timing
from flexfmu.cosim.experiment.system import REFERENCES, scene_system
from flexfmu.cosim.many.executor import mapping
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.fmu_build.choices import FIXED_STEP, INTEGRATOR
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
    task = VariantTask(scene, build_scene(scene, shared=True).path, measure, communication_step, tolerance, record)
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


V = TypeVar("V", covariant=True)

KINDS = ("position", "velocity", "acceleration")
"""Last part of the references' names, by the order of the time derivative."""

EXPLICIT = ("dopri5", "rk4")
"""Integration methods whose steps have one time for all variants."""

RECORDED = 32
"""Number of variants whose recordings are in memory at the same time."""


class NotTogetherError(CosimError):
    """Variants of a scene can't be simulated in lockstep."""


@runtime_checkable
class SignalMeasure(Protocol[V]):
    """A measure that needs only some of the robot's outputs.

    Attributes:
        signals: names of the outputs, recorded with two derivatives; a robot may lack some.
    """

    @property
    def signals(self) -> Sequence[str]: ...

    def __call__(self, run: Run) -> V:
        """Measure a run."""


@runtime_checkable
class PeakMeasure(Protocol[V]):
    """A measure that needs only the largest magnitudes of some of the robot's outputs over the motion.

    Attributes:
        outputs: names of the outputs.
    """

    @property
    def outputs(self) -> Sequence[str]: ...

    def __call__(self, run: Run) -> V:
        """Measure a run of the FMU."""

    def of_peaks(self, peaks: Mapping[str, float]) -> V:
        """The measure from the peaks, name of an output → largest magnitude."""


class SideBySide:
    """A motion of a scene, ready for variants of the robot's parameters in lockstep.

    Args:
        scene: the scene.
        fmu_path: its FMU.
        communication_step, tolerance: as for `flexfmu.cosim.many.prepared_scene.run_scene`.
        lanes: variants side by side, 1, 4 or 8; None for as many as the processor has.

    Raises:
        NotTogetherError: the scene has controllers or other slaves, torque drive or step control.
    """

    def __init__(
        self,
        scene: Scene,
        fmu_path: Path,
        communication_step: float | None = None,
        tolerance: float | None = None,
        lanes: int | None = None,
    ) -> None:
        section = scene.cosimulation
        loop = loop_of(scene)
        parts = scene_system(scene, loop, fmu_path)
        self._variables = {each.name: each for each in open_fmu(fmu_path).description.modelVariables}
        inputs = [name for name, each in self._variables.items() if each.causality == "input"]
        # all inputs of the robot come from the planned motion
        feeding = parts.wiring.feeding
        alone = not parts.others and all(feeding.get(name) == f"{REFERENCES}.{name}" for name in inputs)
        if section.drive != "motion" or section.step_control is not None or not alone:
            raise NotTogetherError(f"the robot of scene {scene.name} doesn't follow its planned motion alone")
        self._fmu_path, self._settings = fmu_path, dict(parts.plant.parameters)
        step = section.communication_step if communication_step is None else communication_step
        self._course = _course(parts.references, loop.motion.duration, loop.motion.stop_time, step)
        self._end, self._lanes = loop.motion.duration, lanes
        self._solver: tuple[tuple[str, ...], Lockstep] | None = None
        # what the runs of all variants share
        self._run = Run(
            plan=loop.motion,
            recording=Recording(self._course.instants, {}),
            outcome=Outcome.COMPLETED,
            message="",
            fmu_path=fmu_path,
            communication_step=step,
            tolerance=section.tolerance if tolerance is None else tolerance,
            input_order=parts.references.announced_order,
            health=Health({}, ()),
            timing=Timing(0.0, 0.0, 0.0, 0.0),
            rests=RestPositions(loop.motion, fmu_path),
            measure=measure_run,
        )

    def peaks(
        self,
        variants: Sequence[Mapping[str, Any]],
        outputs: Sequence[str],
        progress: Callable[[int], None] = lambda count: None,
        durations: Sequence[float] | None = None,
    ) -> list[dict[str, float] | None]:
        """The largest magnitudes of outputs over the motion, for each variant; None for one that the FMU must simulate.

        Args:
            variants: changed parameters of each variant.
            outputs: names of outputs; those that the robot lacks are zero.
            progress: called now and then with the number of variants that were completed since the last call.
            durations: of each variant's motion, of the same shape [s]; None for the scene's own.

        Raises:
            BuildError: there is no C compiler, or the model's functions branch.
            NotTogetherError: the durations differ, and the processor has no lanes, or steps are fixed or explicit.
        """
        able, solver, values, known = self._prepare(variants, outputs)
        own_steps = FIXED_STEP in self._settings or self._settings.get(INTEGRATOR.name) in EXPLICIT
        if durations is not None and (solver.lanes == 1 or own_steps):
            raise NotTogetherError(
                "other durations need a processor with AVX2, and a collocation method with error control"
            )
        time_scales = None if durations is None else np.array(durations)[able] / self._end
        found, failed = solver.peaks(values, self._end, progress, time_scales)
        # back to the order of all variants
        lacking = dict.fromkeys(outputs, 0.0)
        rows = zip(found.tolist(), failed.tolist(), strict=True)
        results = iter([None if lost else lacking | dict(zip(known, row, strict=True)) for row, lost in rows])
        return [next(results) if plain else None for plain in able]

    def runs(self, variants: Sequence[Mapping[str, Any]], outputs: Sequence[str]) -> Iterator[Run | None]:
        """Yield the run of each variant with these outputs and two derivatives; None for one that the FMU must simulate.

        Arguments and errors: as for `peaks`.
        """
        able, solver, values, known = self._prepare(variants, outputs)
        recorded = iter(self._recordings(solver, values, known))
        for variant, plain in zip(variants, able, strict=True):
            recording = next(recorded) if plain else None
            yield None if recording is None else replace(self._run, recording=recording, parameters=dict(variant))

    def _recordings(self, solver: Lockstep, values: RealArray, names: Sequence[str]) -> Iterator[Recording | None]:
        """Yield the recordings of variants; None for one that failed."""
        time, units = self._course.instants, [self._variables[name].unit or "" for name in names]
        for first in range(0, len(values), RECORDED):
            for arrays, lost in zip(*solver.record(values[first : first + RECORDED]), strict=True):
                columns = (Column(unit, *each) for unit, each in zip(units, arrays, strict=True))
                yield None if lost else Recording(time, dict(zip(names, columns, strict=True)))

    def _prepare(
        self, variants: Sequence[Mapping[str, Any]], outputs: Sequence[str]
    ) -> tuple[list[bool], Lockstep, RealArray, list[str]]:
        """Whether each variant can go along, the solver, changed values of those that can, and the outputs that exist."""
        able = [_is_plain(variant, self._variables) for variant in variants]
        changed, values = self._values([each for each, plain in zip(variants, able, strict=True) if plain])
        known = [name for name in outputs if name in self._variables]
        key = (*changed, "", *known)
        if self._solver is None or self._solver[0] != key:
            solver = Lockstep(
                self._fmu_path,
                self._settings,
                self._course,
                changed,
                known,
                tolerance=self._run.tolerance,
                lanes=self._lanes,
            )
            self._solver = key, solver
        return able, self._solver[1], values, known

    def _values(self, variants: Sequence[Mapping[str, float]]) -> tuple[list[str], RealArray]:
        """Names of the k parameters that any variant changes, and their values (N, k)."""
        changed = sorted({name for variant in variants for name in variant})
        shared = {name: self._settings.get(name, self._variables[name].start) for name in changed}
        values = [[float(variant.get(name, shared[name])) for name in changed] for variant in variants]
        return changed, np.array(values, dtype=float).reshape(len(variants), len(changed))


def _course(references: TrajectorySlave, end: float, stop: float, step: float) -> SampledInputs:
    """The references at the communication points from 0 over the motion's end to ``stop`` [s]."""
    grid = time_grid(0.0, stop, step, references.breakpoints)
    references.prepare(grid.times)
    names = [each.name for each in references.variables]
    kinds = [KINDS.index(name.rpartition(".")[2]) for name in names]
    motion = int(grid.times.searchsorted(end))
    return SampledInputs(
        grid.times, grid.marked, names, references.ended[0, 0], references.announced[:-1], kinds, motion
    )


def _is_plain(variant: Mapping[str, Any], variables: Mapping[str, Any]) -> bool:
    """Whether a variant changes only real parameters of the robot, within their limits; if not, its FMU says what is wrong."""
    for name, value in variant.items():
        known = variables.get(name)
        if known is None or known.type != "Real" or known.causality != "parameter" or name == FIXED_STEP:
            return False
        low, high = (-inf if known.min is None else float(known.min)), (inf if known.max is None else float(known.max))
        if not isinstance(value, Real) or not max(low, -float_info.max) <= float(value) <= min(high, float_info.max):
            return False
    return True
