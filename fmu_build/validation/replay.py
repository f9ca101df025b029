"""Checks that a second run, a reset, a restored state and another instance reproduce the results bit by bit.

The same calls with the same values run the same arithmetic. A difference reveals memory that is not part of the state.

    python -m flexfmu.fmu_build.validation.replay FOLDER KIND STEP_SECONDS RESULT < STATE    # in a separate process
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmi3 import described
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import MisbehaviourError, RealArray
from flexfmu.fmu_build.validation.variables import moved, start_of

FRACTIONS = (0.0, 0.25, 0.75)
"""Instants at which states are saved, as fractions of the run."""

OTHER_PROCESS_TIMEOUT = 60.0
"""Time limit of a process that replays a state [s]."""

PERTURBATION = 0.02
"""Change of parameters and inputs, relative to their size."""

FEW_STEPS = 20
"""Steps of the runs with parameters set in Initialization Mode."""

READS = 10
"""Additional readings of all outputs in each step."""

NEGLIGIBLE = 1e-9
"""Largest difference, relative to an output's largest value, that is a warning instead of an error."""


def repeats_itself(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that a second instance reproduces the first; exclude outputs that are random from all later checks."""
    first = fmu.record("first")
    second = fmu.record("second")
    differing = _differing(fmu, first, second)
    if not differing:
        return
    # outputs that differ between new processes too are random; otherwise instances share memory
    fresh = [_in_new_process(fmu, "run") for _ in range(2)]  # without earlier instances
    random = _differing(fmu, *fresh)
    if set(differing) <= set(random):
        message = (
            f"{', '.join(variable.name for variable in differing)}: different at each run, not looked at any further"
        )
        yield Finding(message, "the same inputs should give the same outputs", Severity.WARNING)
        fmu.outputs = [variable for variable in fmu.outputs if variable not in differing]
    else:
        remedy = "keep all data in the instance, none in static variables; initialise all of it"
        yield from _compare(fmu, first, second, "in a second instance after the first is freed", remedy)


def _differing(fmu: FmuUnderTest, first: RealArray, second: RealArray) -> list[Any]:
    """Outputs whose values differ between two recordings."""
    rows = min(len(first), len(second))
    offset = first.shape[1] - len(fmu.outputs)
    same = [np.array_equal(a, b, equal_nan=True) for a, b in zip(first[:rows].T, second[:rows].T, strict=True)]
    return [variable for n, variable in enumerate(fmu.outputs) if not same[offset + n]]


def repeats_after_reset(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2Reset restores the state after instantiation, including parameters and inputs."""
    remedy, findings = "fmi2Reset has to restore everything, starts included", list[Finding]()
    with fmu.instance("reset") as instance:
        first = instance.run()
        # after the same run, and after one with other parameters and inputs
        for when in ("after fmi2Reset", "after other parameters and inputs and fmi2Reset"):
            if findings:
                break
            instance.library.reset()
            if when != "after fmi2Reset":
                _run_changed(fmu, instance)
                instance.library.reset()
            # tools hardly ever reset an FMU that has terminated the simulation: different ends are a warning
            findings += _compare(fmu, first, instance.run(), when, remedy, severity=Severity.WARNING)
    yield from findings


def _run_changed(fmu: FmuUnderTest, instance: Any) -> RealArray:
    """Results of a run with other parameters and inputs; no rows if the FMU rejects these values."""
    try:
        instance.initialize({variable: moved(variable, PERTURBATION) for variable in changeable(fmu)})
        return np.asarray(instance.advance(0, fmu.steps, size=-3.0))
    except Exception:  # fmpy raises several types; the FMU may reject these values
        return np.zeros((0, 1))


def changeable(fmu: FmuUnderTest) -> list[Any]:
    """Real parameters whose bounds allow another value than their start."""
    parameters = [variable for variable in fmu.settable("parameter") if variable.type == "Real"]
    return [variable for variable in parameters if moved(variable, PERTURBATION) != start_of(variable)]


def initializes_alike(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that parameters set in Initialization Mode act as those that are set before it."""
    values = {variable: moved(variable, PERTURBATION) for variable in changeable(fmu)}
    runs: list[RealArray] = []
    for late in (False, True) if values else ():
        with fmu.instance("parameters") as instance:
            try:
                instance.initialize(values, late)
                runs.append(instance.advance(0, min(fmu.steps, FEW_STEPS)))
            except (FMICallException, MisbehaviourError) as error:
                if late and runs:
                    message = f"with parameters set in Initialization Mode, as legal before it: {error}"
                    yield Finding(message, _LATE, Severity.WARNING)
                return
    if runs:
        when = "where parameters are set in Initialization Mode instead of before it"
        yield from _compare(fmu, runs[0], runs[1], when, _LATE, fmu.accuracy)


_LATE = "take parameters until Initialization Mode ends, and use them"


def replays_saved_states(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that runs continue identically from restored states, in any order, and that saving has no side effect."""
    if not fmu.can_save:
        return
    undisturbed = fmu.record("undisturbed")
    # one run, interrupted to save states
    marks = [round(fraction * fmu.steps) for fraction in FRACTIONS]
    with fmu.initialized("save") as instance:
        states, parts = [], []
        for mark, end in zip(marks, [*marks[1:], fmu.steps], strict=True):
            states.append(instance.save())
            parts.append(instance.advance(mark, end))
        saving = list(_compare(fmu, undisturbed, np.vstack(parts), _ON_THE_WAY, _SAVING))
        yield from saving
        # the run continues identically from each state, restored in both orders
        futures: dict[int, RealArray] = {}
        found: list[Finding] = []
        for turn in (0, 1):
            for mark, state in list(zip(marks, states, strict=True))[:: 1 - 2 * turn]:
                if found:
                    break
                instance.restore(state)
                rows = instance.advance(mark, fmu.steps)
                expected = futures.setdefault(mark, rows if saving else undisturbed[mark:])
                found += _compare(fmu, expected, rows, "after fmi2SetFMUstate", _STATE_REMEDY)
        yield from found
        if not saving and not found:
            # a state that is written into the memory of an earlier one, which it replaces
            mark = marks[1]
            instance.restore(states[0])
            instance.advance(0, mark)
            states[0] = instance.save(states[0])
            instance.advance(mark, fmu.steps)
            instance.restore(states[0])
            rows = instance.advance(mark, fmu.steps)
            yield from _compare(fmu, undisturbed[mark:], rows, _AGAIN, _STATE_REMEDY)
        # freed states leave no pointer behind
        for state in states:
            instance.discard(state)
        if any(state[0].value for state in states):
            message = "fmi2FreeFMUstate leaves the pointer to the state as it was"
            remedy = "set it to null: a second call would free the state twice"
            yield Finding(message, remedy, Severity.WARNING)
    # saving and freeing the state in each step changes nothing
    if not saving:
        with fmu.initialized("saving") as instance:
            rows = instance.advance(0, min(fmu.steps, 20), between=lambda: instance.discard(instance.save()))
        yield from _compare(fmu, undisturbed[: len(rows)], rows, _ON_THE_WAY, _SAVING)


def brings_inputs_back(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2SetFMUstate restores inputs and time, which belong to the state."""
    if not fmu.can_save:
        return
    # inputs whose bounds allow another value
    inputs = [variable for variable in fmu.real_inputs if moved(variable, PERTURBATION) != start_of(variable)]
    times = fmu.times
    with fmu.initialized("inputs") as instance:
        half = fmu.steps // 2
        instance.advance(0, half)
        if instance.finished:
            return
        # save; continue and restore; set other inputs and restore
        state, values, time = instance.save(), instance.get(inputs), instance.get(times)
        instance.advance(half, fmu.steps)  # sets other inputs first
        instance.restore(state)
        instance.set(inputs, np.array([moved(variable, PERTURBATION) for variable in inputs]))
        instance.restore(state)
        again, then = instance.get(inputs), instance.get(times)
        instance.discard(state)
    # inputs and time have their saved values
    for variable, before, after in zip([*inputs, *times], [*values, *time], [*again, *then], strict=True):
        if not np.isclose(before, after, rtol=1e-9, atol=1e-12 * fmu.step, equal_nan=True):
            message = (
                f"{variable.name} was {before:.9g} when the state was saved, and is {after:.9g} after fmi2SetFMUstate"
            )
            severity = Severity.WARNING if variable in times else Severity.ERROR
            yield Finding(message, _STATE_REMEDY, severity, variable.name)


def reads_leave_the_state_alone(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that reading outputs repeatedly in each step does not change the results."""
    once = fmu.record("read_once")
    with fmu.initialized("read_often") as instance:

        def read() -> None:
            for _ in range(READS):
                instance.get(fmu.outputs)

        often = instance.advance(0, fmu.steps, between=read)
    # an inner iteration that continues at each reading may change outputs within the solver's tolerance
    when, room = f"where outputs are read {READS} times more a step", (NEGLIGIBLE, fmu.accuracy)
    yield from _compare(fmu, once, often, when, _READING, *room)


def replays_serialized_state(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that a run continues identically from a serialised state in another instance and in another process."""
    if not fmu.can_serialize:
        return
    half = fmu.steps // 2
    # second half of the run, in the same instance and in another one
    with fmu.instance("writer") as writer:
        writer.initialize()
        writer.advance(0, half)
        data = writer.serialize()
        rows = writer.advance(half, fmu.steps)
    with fmu.instance("reader") as reader:
        reader.initialize()
        reader.restore_serialized(data)
        again = reader.advance(half, fmu.steps)
    when = "with a serialised state in another instance"
    findings = list(_compare(fmu, rows, again, when, _STATE_REMEDY))
    yield from findings
    # in another process, at other addresses
    slave, model = fmu.description.coSimulation, fmu.description.modelExchange
    both = slave is not None and model is not None and slave.modelIdentifier == model.modelIdentifier
    if findings or (both and fmu.kind is InterfaceType.EXCHANGE):  # co-simulation has already tested this code
        return
    when = "with a serialised state in another process"
    remedy = "serialised states must hold values, no addresses"
    yield from _compare(fmu, rows, _in_new_process(fmu, "continue", data), when, remedy)


def _in_new_process(fmu: FmuUnderTest, what: str, data: bytes = b"") -> RealArray:
    """Results of a run in a new process; of its second half from a serialised state, if there is one.

    Raises:
        RuntimeError: the process fails or writes no result.
    """
    with temporary_folder("replay", fmu.folder.parent) as home:
        result = Path(home) / "rows.npy"
        module = "flexfmu.fmu_build.validation.replay"
        command = [sys.executable, "-m", module, str(fmu.folder), fmu.kind.name, repr(fmu.step_seconds), str(result)]
        outcome = subprocess.run(command, input=data, capture_output=True, timeout=OTHER_PROCESS_TIMEOUT, check=False)
        if outcome.returncode != 0 or not result.exists():
            last = (outcome.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise RuntimeError(f"another process that has to {what} ends with {outcome.returncode}: {last}")
        return np.asarray(np.load(result))


def two_instances_are_independent(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that two instances with different parameters and inputs, stepped in turns, reproduce their separate runs."""
    # separate runs, the second one with other values if the FMU accepts them
    alone = fmu.record("alone")
    with fmu.instance("changed") as instance:
        changed = _run_changed(fmu, instance)
    values = {variable: moved(variable, PERTURBATION) for variable in changeable(fmu)} if len(changed) else {}
    size = -3.0 if len(changed) else 1.0
    # both instances, step by step in turns
    with fmu.instance("one") as one, fmu.instance("two") as two:
        one.initialize()
        two.initialize(values)
        steps = min(len(alone), len(changed) or len(alone))
        turns = [(one.advance(n, n + 1), two.advance(n, n + 1, size)) for n in range(steps)]
    # report the first difference only
    when, remedy = "with two instances that take turns", "keep all data in the instance, none in static variables"
    findings: list[Finding] = []
    for which, expected in enumerate((alone, changed if len(changed) else alone)):
        rows = np.vstack([turn[which] for turn in turns]) if turns else expected[:0]
        findings = findings or list(_compare(fmu, expected[: len(rows)], rows, when, remedy))
    yield from findings


_AGAIN = "after fmi2SetFMUstate of a state that fmi2GetFMUstate wrote into the memory of an earlier one"
_ON_THE_WAY, _SAVING = "where fmi2GetFMUstate was called on the way", "saving a state must not change it"
_READING = "fmi2GetXXX must neither change the state nor depend on what was read before"
_STATE_REMEDY = "the state must hold everything that the future depends on: internal variables, inputs, time"


def _compare(
    fmu: FmuUnderTest,
    first: RealArray,
    second: RealArray,
    when: str,
    remedy: str,
    least: float = 0.0,
    negligible: float = NEGLIGIBLE,
    severity: Severity = Severity.ERROR,
) -> Iterator[Finding]:
    """Yield a finding if two recordings of the same calls differ.

    Differences are relative to the column's largest value: up to ``least`` they are ignored, up to ``negligible`` they
    are a warning. ``severity`` is that of runs of different lengths.
    """
    if len(first) != len(second):
        ends = " and ".join(f"{fmu.start + len(rows) * fmu.step:.6g} s" for rows in (first, second))
        yield Finding(f"the run ends at different times {when}: {ends}", remedy, severity)
        return
    offset = first.shape[1] - len(fmu.outputs)
    if first.shape != second.shape or offset < 0 or np.array_equal(first, second, equal_nan=True):
        return
    # the column with the largest relative difference
    difference = np.abs(first - second)
    difference = np.where(
        np.isnan(difference) & (np.isnan(first) != np.isnan(second)), np.inf, np.nan_to_num(difference)
    )
    scale = np.maximum(np.nan_to_num(np.abs(first)).max(axis=0), 1e-300)
    column = int(np.argmax(difference.max(axis=0) / scale))
    name = fmu.outputs[column - offset].name if column >= offset else f"derivative {column + 1}"
    worst = difference[:, column].max()
    if worst <= least * scale[column]:
        return
    severity = Severity.ERROR if worst > negligible * scale[column] else Severity.WARNING
    yield Finding(f"{name} differs by up to {worst:.3g} {when}; it should be identical", remedy, severity)


def _main() -> None:
    """Write the results of `_in_new_process` to a file; arguments FOLDER KIND STEP_SECONDS RESULT, the state on standard input."""
    folder, kind, step_seconds, result = sys.argv[1:]
    description, data = described(Path(folder)), sys.stdin.buffer.read()
    fmu = FmuUnderTest(description, Path(folder), InterfaceType[kind], float(step_seconds))
    with fmu.instance("other process") as instance:
        if data:
            instance.initialize()
            instance.restore_serialized(data)
            rows = instance.advance(fmu.steps // 2, fmu.steps)
        else:
            rows = instance.run()
    np.save(result, rows)


if __name__ == "__main__":
    _main()
