"""Variants of the parameters of one of our FMUs, simulated side by side along the same inputs.

The library that `flexfmu.fmu_build.batch_build` compiles from the FMU's sources holds one variant in each lane of the processor's
vector registers: 8 with AVX-512, 4 with AVX2, otherwise 1. Common steps are chosen by the variant with the largest error. A
variant that fails leaves the others undisturbed and is reported; its FMU tells why.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from ctypes import CDLL, create_string_buffer
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.fmu.calls import address, close_after_use
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.variables import Value, items
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.fmu_build.batch_build import batch_library, lanes_of_processor
from flexfmu.fmu_build.c_header import structures, typed
from flexfmu.fmu_build.choices import FIXED_STEP, INITIAL, INTEGRATOR, LEAST_TOLERANCE

BATCH = 64
"""Number of variants in one call of the library; Python can be interrupted between two calls."""

Flags = NDArray[np.bool_]

_HEADER = (files("flexfmu.fmu_build") / "c-runtime" / "batch" / "batch.h").read_text(encoding="utf-8")
_STRUCTURES = structures(_HEADER)


@dataclass(frozen=True)
class SampledInputs:
    """The inputs of all variants at their communication points.

    Attributes:
        times: (N,) communication points [s].
        jumps: (N,) whether inputs may jump at the point, which is then recorded twice.
        names: names of the m inputs.
        before: (m,) values before the first point.
        polynomials: (N - 1, orders, m) derivatives, from order 0, at the beginning of each step's polynomials.
        kinds: (m,) for inputs that are time derivatives of others their order, 0 to 2.
        motion: number of steps until the motion's end.
    """

    times: RealArray
    jumps: Flags
    names: Sequence[str]
    before: RealArray
    polynomials: RealArray
    kinds: Sequence[int]
    motion: int

    @property
    def instants(self) -> RealArray:
        """The recorded instants [s]: the communication points, those with jumps twice."""
        return np.repeat(self.times, 1 + self.jumps)


class Lockstep:
    """Simulates variants of an FMU's parameters side by side.

    Args:
        fmu: FMU of a plant, with its sources.
        settings: start values of parameters that all variants share, as for `FmuSlave`.
        course: the inputs.
        changed: names of the k parameters that differ between variants.
        outputs: names of the n outputs to record.
        order: highest order of their derivatives, 0 to 2.
        tolerance: relative tolerance of the integrator.
        lanes: variants side by side, 1, 4 or 8; None for as many as the processor has.

    Raises:
        BuildError: there is no C compiler, or the model can't be simulated in lockstep.
        KeyError: a name isn't one of the FMU's inputs, real parameters or outputs.
    """

    def __init__(
        self,
        fmu: Path,
        settings: Mapping[str, Value],
        course: SampledInputs,
        changed: Sequence[str],
        outputs: Sequence[str],
        *,
        order: int = 2,
        tolerance: float = 1e-6,
        lanes: int | None = None,
    ) -> None:
        self.lanes = lanes_of_processor() if lanes is None else lanes
        self._library = _library(fmu, fmu.stat().st_mtime_ns if fmu.exists() else 0, self.lanes)
        self._instants, self._shape = course.instants.size, (len(outputs), order + 1)
        # value references: inputs, then parameters, then outputs
        variables = {each.name: each for each in open_fmu(fmu).description.modelVariables}
        references = {name: int(each.valueReference) for name, each in variables.items() if each.type == "Real"}
        inputs = [name for name, each in variables.items() if each.causality == "input"]
        first = min(references[name] for name, each in variables.items() if each.causality == "output")
        places = {
            name: reference - len(inputs) for name, reference in references.items() if len(inputs) <= reference < first
        }
        parameters = np.empty(len(places))
        for name, place in places.items():
            parameters[place] = settings.get(name, variables[name].start)
        # arrays that the structure points to
        columns = [course.names.index(name) for name in sorted(inputs, key=references.__getitem__)]
        self._arrays = arrays = {
            "times": np.ascontiguousarray(course.times, dtype=float),
            "jumps": course.jumps.astype(np.intc),
            "before": np.ascontiguousarray(course.before[columns]),
            "polynomials": np.ascontiguousarray(course.polynomials[:, :, columns]),
            "kinds": np.array(course.kinds, dtype=np.intc)[columns],
            "parameters": parameters,
            "changed": np.array([places[name] for name in changed], dtype=np.intc),
            "recorded": np.array([references[name] - first for name in outputs], dtype=np.intc),
        }

        def number(name: str) -> int:
            """The number of a named choice: in the settings, or the FMU's own start."""
            value = settings.get(name, variables[name].start)
            known = items(variables[name])
            return known[value] if value in known else int(value)

        self._task = _STRUCTURES["flex_batch_task"](
            n_points=course.times.size,
            n_orders=course.polynomials.shape[1],
            n_motion=course.motion,
            tolerance=max(tolerance, LEAST_TOLERANCE),
            fixed_step=float(settings.get(FIXED_STEP, 0.0)),
            method=number(INTEGRATOR.name),
            # models without this choice start from the values that their states have
            starts_static=int(INITIAL.name in variables and number(INITIAL.name) == INITIAL.items["static"][0]),
            n_changed=len(changed),
            n_recorded=len(outputs),
            order=order,
            **{name: address(values) for name, values in arrays.items()},
        )

    def record(self, values: RealArray) -> tuple[RealArray, Flags]:
        """Simulate variants of the course's own motion and record them.

        Args:
            values: (N, k) changed parameters of each variant.

        Returns:
            The recordings (N, n, order + 1, instants), and (N,) whether a variant failed.
        """
        recordings = np.empty((len(values), *self._shape, self._instants))
        memory = self._memory(finds_peaks=False)
        values = np.insert(values, 0, 1.0, axis=1)
        return recordings, self._run(values, recordings, self._library.flex_batch_record, (), memory)

    def peaks(
        self,
        values: RealArray,
        end: float,
        progress: Callable[[int], None] = lambda count: None,
        time_scales: RealArray | None = None,
    ) -> tuple[RealArray, Flags]:
        """Simulate variants and find the largest magnitude of each output, by its value and two derivatives.

        Args:
            values: (N, k) changed parameters of each variant.
            end: time up to which magnitudes count, one of the communication points [s].
            progress: called now and then with the number of variants that were simulated since the last call.
            time_scales: (N,) how many times as long as the course's motion each variant's motion of the same shape takes; the
                standstill after it takes the same time. None for the course's own motion.

        Returns:
            The peaks (N, n), and (N,) whether a variant failed.
        """
        peaks, failed = np.empty((len(values), self._shape[0])), np.zeros(len(values), dtype=np.bool_)
        memory = self._memory(finds_peaks=True)
        values = np.insert(values, 0, 1.0 if time_scales is None else time_scales, axis=1)
        for first in range(0, len(values), BATCH):
            piece = slice(first, first + BATCH)
            failed[piece] = self._run(values[piece], peaks[piece], self._library.flex_batch_peaks, (end,), memory)
            progress(int((~failed[piece]).sum()))
        return peaks, failed

    def _memory(self, *, finds_peaks: bool) -> Any:
        """Memory for one batch of the task, with derivatives of outputs at all instants or where peaks may be."""
        self._task.finds_peaks = finds_peaks
        return create_string_buffer(int(self._library.flex_batch_size(self._task)))

    def _run(
        self, values: RealArray, results: RealArray, function: Any, further: tuple[Any, ...], memory: Any
    ) -> Flags:
        """Call a function of the library for all variants; whether each failed."""
        values, failed = np.ascontiguousarray(values, dtype=float), np.zeros(len(values), dtype=np.intc)
        function(self._task, memory, *further, len(values), address(values), address(results), address(failed))
        lost: Flags = failed != 0
        return lost


@lru_cache(maxsize=16)
def _library(fmu: Path, changed: int, lanes: int) -> Any:
    """The library of an FMU that was changed last at some time [ns], found once: its name is the hash of all sources."""
    library: Any = typed(CDLL(str(batch_library(fmu, lanes))), _HEADER, _STRUCTURES)
    close_after_use(library)
    return library
