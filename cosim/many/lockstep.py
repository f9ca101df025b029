"""Variants of a motion-driven scene side by side: which variants can, and what is measured of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import inf
from numbers import Real
from pathlib import Path
from sys import float_info
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from flexfmu.cosim.engine.errors import CosimError
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.scene_run import Health, RestPositions, Run, Timing
from flexfmu.cosim.experiment.system import REFERENCES, scene_system
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.fmu_build.choices import FIXED_STEP, INTEGRATOR
from flexfmu.model.scene.schema import Scene

T = TypeVar("T", covariant=True)

KINDS = ("position", "velocity", "acceleration")
"""Last part of the references' names, by the order of the time derivative."""

EXPLICIT = ("dopri5", "rk4")
"""Integration methods whose steps have one time for all variants."""

RECORDED = 32
"""Number of variants whose recordings are in memory at the same time."""


class NotTogetherError(CosimError):
    """Variants of a scene can't be simulated in lockstep."""


@runtime_checkable
class SignalMeasure(Protocol[T]):
    """A measure that needs only some of the robot's outputs.

    Attributes:
        signals: names of the outputs, recorded with two derivatives; a robot may lack some.
    """

    @property
    def signals(self) -> Sequence[str]: ...

    def __call__(self, run: Run) -> T:
        """Measure a run."""
        ...


@runtime_checkable
class PeakMeasure(Protocol[T]):
    """A measure that needs only the largest magnitudes of some of the robot's outputs over the motion.

    Attributes:
        outputs: names of the outputs.
    """

    @property
    def outputs(self) -> Sequence[str]: ...

    def __call__(self, run: Run) -> T:
        """Measure a run of the FMU."""
        ...

    def of_peaks(self, peaks: Mapping[str, float]) -> T:
        """The measure from the peaks, name of an output → largest magnitude."""
        ...


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
        solver = Lockstep(
            self._fmu_path,
            self._settings,
            self._course,
            changed,
            known,
            tolerance=self._run.tolerance,
            lanes=self._lanes,
        )
        return able, solver, values, known

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
