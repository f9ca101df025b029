"""A sweep of a model from equations: variants of its parameters and starts side by side in the processor's lanes, or one by one."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import inf
from pathlib import Path

import numpy as np

from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.fmu.lockstep import Lockstep, SampledInputs
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Column, Recording, Selection
from flexfmu.cosim.studies.sweep.cases import Cases
from flexfmu.cosim.studies.sweep.result import Results, SweepResult
from flexfmu.cosim.studies.sweep.work import Row
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.model.symbolic import SymbolicModel


def sweep_model(
    model: SymbolicModel,
    cases: Cases,
    stop_time: float,
    step: float,
    *,
    record: Collection[str] | None = None,
    tolerance: float = 1e-6,
    folder: Path | None = None,
    restart: bool = False,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> SweepResult:
    """Simulate variants of a model from equations, record them, and measure smallest, largest and last value of each output.

    Variants go side by side in lanes, with common steps: each result agrees with that of the variant's own run within the tolerance.
    Models with events, dry friction or equations that branch go one by one, as do variants that fail beside others.

    Args:
        model: the model; its inputs have their start values.
        cases: changes of its parameters, ``start.NAME`` among them.
        stop_time: [s].
        step: communication step [s], at which outputs are recorded.
        record: names of outputs; None for all, of which a folder keeps the measures alone.
        tolerance: relative tolerance.
        folder, restart: of the results, see `flexfmu.cosim.studies.sweep.result.Results`.
        show: called with the numbers of finished cases and of all.

    Raises:
        InputError: a parameter or output doesn't exist, a value is no number, times don't fit, or the folder has another sweep.
        ResultsError: the folder can't be read or written.
        BuildError: the FMU can't be built.
    """
    parameters = {each.name: each for each in model.parameters}
    outputs = {each.name: each for each in model.outputs}
    names, keys = list(outputs if record is None else record), cases.keys
    for what, given, known in (("parameter", keys, parameters), ("output", names, outputs)):
        if unknown := [each for each in given if each not in known]:
            raise InputError(f"model '{model.name}' has no {what} '{unknown[0]}'; {suggestion(unknown[0], known)}")
    chosen = [parameters[key] for key in keys]
    rows = [[p.start if v is None else v for p, v in zip(chosen, row, strict=True)] for row in cases.rows]
    try:
        values = np.array(rows, dtype=float).reshape(len(rows), len(keys))
    except (TypeError, ValueError):
        raise InputError(f"the values of {', '.join(keys)} must be numbers") from None
    built, times = build_fmu(model), time_grid(0.0, stop_time, step).times
    # those in lanes; the others, with what a run of the FMU says
    low = [-inf if p.minimum is None else p.minimum for p in chosen]
    high = [inf if p.maximum is None else p.maximum for p in chosen]
    within = (values >= low) & (values <= high)
    alone = np.asarray(~within.all(axis=1), dtype=np.bool_)
    if model.events or model.frictions:
        alone[:] = True
    found = np.empty((len(rows), len(names), 1, times.size))
    inputs = np.array([each.start or 0.0 for each in model.inputs])
    course = SampledInputs(
        times,
        np.zeros(times.size, dtype=np.bool_),
        [each.name for each in model.inputs],
        inputs,
        np.tile(inputs, (times.size - 1, 1, 1)),
        [0] * inputs.size,
        times.size - 1,
    )
    selection = Selection([f"{model.name}.{each}" for each in names], order=0)

    def measured(k: int) -> Row:
        """A case, run alone unless it is there already."""
        message = ""
        if alone[k]:
            try:
                slave = fmu_slave(built.path, model.name, dict(zip(keys, values[k].tolist(), strict=True)))
                run = simulate(connect([slave], []), stop_time, step, tolerance=tolerance, record=selection)
            except InputError as error:
                return Row(k, (None,) * len(metrics), str(error))
            signals = {name.partition(".")[2]: each for name, each in run.recording.items()}
            recording = Recording(run.recording.time, signals)
            message = "" if run.outcome is Outcome.COMPLETED else run.message
        else:
            columns = {n: Column(outputs[n].unit, v) for n, v in zip(names, found[k, :, 0], strict=True)}
            recording = Recording(times, columns)
        courses = [] if message else [recording[each].values for each in names]
        figures = [float(value) for each in courses for value in (each.min(), each.max(), each[-1])]
        is_kept = folder is None or record is not None
        return Row(k, tuple(figures) or (None,) * len(metrics), message, recording if is_kept else None)

    metrics = tuple(f"{name}.{which}" for name in names for which in ("min", "max", "end"))
    units = {p.name: p.unit for p in chosen} | {each: outputs[each.rpartition(".")[0]].unit for each in metrics}
    about = {"model": built.guid, "cases": cases.described(), "record": names, "times": [stop_time, step, tolerance]}
    with Results(cases, metrics, units, folder, about, restart=restart) as kept:
        show(int(kept.finished.sum()), len(rows))
        together = np.flatnonzero(~alone & ~kept.finished)
        try:
            if together.size:
                lanes = Lockstep(built.path, {}, course, keys, names, order=0, tolerance=tolerance)
                found[together], alone[together] = lanes.record(values[together])
        except ModelError:  # the equations branch
            alone[:] = True
        for k in np.flatnonzero(~kept.finished).tolist():
            kept.add([measured(k)])
            show(int(kept.finished.sum()), len(rows))
        kept.finish()
    return SweepResult(model.name, cases, metrics, kept.values, kept.messages, units, kept.recordings, folder)
