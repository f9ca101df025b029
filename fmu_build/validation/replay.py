"""Checks that a second run, a reset, a restored state and another instance reproduce the results bit by bit.

The same calls with the same values run the same arithmetic. A difference reveals memory that is not part of the state.

    python -m flexfmu.fmu_build.validation.replay FOLDER KIND STEP_SECONDS STATE RESULT    # in a separate process
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.variables import moved, start_of

FRACTIONS = (0.0, 0.25, 0.75)
"""Instants at which states are saved, as fractions of the run."""

OTHER_PROCESS_TIMEOUT = 60.0
"""Time limit of a process that replays a state [s]."""

PERTURBATION = 0.02
"""Change of parameters and inputs, relative to their size."""

READS = 10
"""Additional readings of all outputs in each step."""

NEGLIGIBLE = 1e-9
"""Largest difference, relative to an output's largest value, that is a warning instead of an error."""


def repeats_itself(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that a second instance reproduces the first; exclude outputs that are random from all later checks."""
    with fmu.instance("first") as instance:
        first = instance.run()
    with fmu.instance("second") as instance:
        second = instance.run()
    differing = _differing(fmu, first, second)
    if not differing:
        return
    # outputs that differ between new processes too are random; otherwise instances share memory
    fresh = [_in_new_process(fmu, "run") for _ in range(2)]  # without earlier instances
    random = [variable for variable in differing if variable in _differing(fmu, *fresh)]
    if random and set(random) == set(differing):
        names = ", ".join(variable.name for variable in random)
        message = f"{names}: different at each run, not looked at any further"
        yield Finding(message, "the same inputs should give the same outputs", Severity.WARNING)
        fmu.outputs = [variable for variable in fmu.outputs if variable not in random]
    else:
        yield from _compare(
            fmu,
            "repeatability",
            first,
            second,
            "in a second instance after the first is freed",
            "keep all data in the instance, none in static variables; initialise all of it",
        )


def _differing(fmu: FmuUnderTest, first: RealArray, second: RealArray) -> list[Any]:
    """Outputs whose values differ between two recordings."""
    rows = min(len(first), len(second))
    offset = first.shape[1] - len(fmu.outputs)
    same = [np.array_equal(a, b, equal_nan=True) for a, b in zip(first[:rows].T, second[:rows].T, strict=True)]
    return [variable for n, variable in enumerate(fmu.outputs) if not same[offset + n]]


def repeats_after_reset(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2Reset restores the state after instantiation, including parameters and inputs."""
    remedy = "fmi2Reset has to restore everything, starts included"
    with fmu.instance("reset") as instance:
        first = instance.run()
        instance.library.reset()
        again = instance.run()
        findings = list(_compare(fmu, "reset", first, again, "after fmi2Reset", remedy))
        # once more, after a run with other parameters and inputs
        if not findings:
            instance.library.reset()
            _run_changed(fmu, instance)
            instance.library.reset()
            again = instance.run()
            findings = list(
                _compare(fmu, "reset", first, again, "after other parameters and inputs and fmi2Reset", remedy)
            )
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


def replays_saved_states(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that runs continue identically from restored states, in any order, and that saving has no side effect."""
    if not fmu.can_save:
        return
    with fmu.instance("undisturbed") as instance:
        undisturbed = instance.run()
    # one run, interrupted to save states
    marks = [round(fraction * fmu.steps) for fraction in FRACTIONS]
    with fmu.instance("save") as instance:
        instance.initialize()
        states, parts = [], []
        for mark, end in zip(marks, [*marks[1:], fmu.steps], strict=True):
            states.append(instance.save())
            parts.append(instance.advance(mark, end))
        saving = list(_compare(fmu, "state", undisturbed, np.vstack(parts), _ON_THE_WAY, _SAVING))
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
                found += _compare(fmu, "state", expected, rows, "after fmi2SetFMUstate", _STATE_REMEDY)
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
            yield from _compare(fmu, "state", undisturbed[mark:], rows, _AGAIN, _STATE_REMEDY)
        # freed states leave no pointer behind
        for state in states:
            instance.discard(state)
        if any(state[0].value for state in states):
            message = "fmi2FreeFMUstate leaves the pointer to the state as it was"
            remedy = "set it to null: a second call would free the state twice"
            yield Finding(message, remedy, Severity.WARNING)
    # saving and freeing the state in each step changes nothing
    if not saving:
        with fmu.instance("saving") as instance:
            instance.initialize()
            rows = instance.advance(0, min(fmu.steps, 20), between=lambda: instance.discard(instance.save()))
        yield from _compare(fmu, "state", undisturbed[: len(rows)], rows, _ON_THE_WAY, _SAVING)


def brings_inputs_back(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2SetFMUstate restores inputs and time, which belong to the state."""
    if not fmu.can_save:
        return
    # inputs whose bounds allow another value
    inputs = [variable for variable in fmu.real_inputs if moved(variable, PERTURBATION) != start_of(variable)]
    times = fmu.times
    with fmu.instance("inputs") as instance:
        instance.initialize()
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
    with fmu.instance("read_once") as instance:
        once = instance.run()
    with fmu.instance("read_often") as instance:
        instance.initialize()

        def read() -> None:
            for _ in range(READS):
                instance.get(fmu.outputs)

        often = instance.advance(0, fmu.steps, between=read)
    # an inner iteration that continues at each reading may change outputs within the solver's tolerance
    when, room = f"where outputs are read {READS} times more a step", (NEGLIGIBLE, fmu.accuracy)
    yield from _compare(fmu, "reading", once, often, when, _READING, *room)


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
    findings = list(_compare(fmu, "serialisation", rows, again, when, _STATE_REMEDY))
    yield from findings
    # in another process, at other addresses
    slave, model = fmu.description.coSimulation, fmu.description.modelExchange
    both = slave is not None and model is not None and slave.modelIdentifier == model.modelIdentifier
    if findings or (both and fmu.kind is InterfaceType.EXCHANGE):  # co-simulation has already tested this code
        return
    when = "with a serialised state in another process"
    remedy = "serialised states must hold values, no addresses"
    yield from _compare(fmu, "serialisation", rows, _in_new_process(fmu, "continue", data), when, remedy)


def _continue_from(fmu: FmuUnderTest, data: bytes) -> RealArray:
    """Results of the second half of the run from a serialised state; of the whole run if ``data`` is empty."""
    with fmu.instance("other process") as instance:
        if not data:
            return np.asarray(instance.run())
        instance.initialize()
        instance.restore_serialized(data)
        return np.asarray(instance.advance(fmu.steps // 2, fmu.steps))


def _in_new_process(fmu: FmuUnderTest, what: str, data: bytes = b"") -> RealArray:
    """Results of `_continue_from` in a new process.

    Raises:
        RuntimeError: the process fails or writes no result.
    """
    with temporary_folder("replay", fmu.folder.parent) as home:
        state, result = Path(home) / "state", Path(home) / "rows.npy"
        state.write_bytes(data)
        module = "flexfmu.fmu_build.validation.replay"
        command = [sys.executable, "-m", module, str(fmu.folder), fmu.kind.name, repr(fmu.step_seconds)]
        outcome = subprocess.run(
            [*command, str(state), str(result)], capture_output=True, timeout=OTHER_PROCESS_TIMEOUT, check=False
        )
        if outcome.returncode != 0 or not result.exists():
            last = (outcome.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise RuntimeError(f"another process that has to {what} ends with {outcome.returncode}: {last}")
        rows: RealArray = np.load(result)
        return rows


def two_instances_are_independent(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that two instances with different parameters and inputs, stepped in turns, reproduce their separate runs."""
    # separate runs, the second one with other values if the FMU accepts them
    with fmu.instance("alone") as instance:
        alone = instance.run()
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
    remedy = "keep all data in the instance, none in static variables"
    for which, expected in enumerate((alone, changed if len(changed) else alone)):
        rows = np.vstack([turn[which] for turn in turns]) if turns else expected[:0]
        findings = list(
            _compare(fmu, "instances", expected[: len(rows)], rows, "with two instances that take turns", remedy)
        )
        if findings:
            yield from findings
            return


_AGAIN = "after fmi2SetFMUstate of a state that fmi2GetFMUstate wrote into the memory of an earlier one"
_ON_THE_WAY, _SAVING = "where fmi2GetFMUstate was called on the way", "saving a state must not change it"
_READING = "fmi2GetXXX must neither change the state nor depend on what was read before"
_STATE_REMEDY = "the state must hold everything that the future depends on: internal variables, inputs, time"


def _compare(
    fmu: FmuUnderTest,
    check: str,
    first: RealArray,
    second: RealArray,
    when: str,
    remedy: str,
    least: float = 0.0,
    negligible: float = NEGLIGIBLE,
) -> Iterator[Finding]:
    """Yield a finding if two recordings of the same calls differ.

    Differences are relative to the column's largest value: up to ``least`` they are ignored, up to ``negligible`` they
    are a warning.
    """
    if len(first) != len(second):
        ends = " and ".join(f"{fmu.start + len(rows) * fmu.step:.6g} s" for rows in (first, second))
        # tools hardly ever reset an FMU that has terminated the simulation
        severity = Severity.WARNING if check == "reset" else Severity.ERROR
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
    """Write the results of `_continue_from` to a file; arguments FOLDER KIND STEP_SECONDS STATE RESULT, see `_in_new_process`."""
    folder, kind, step_seconds, state, result = sys.argv[1:]
    fmu = FmuUnderTest(
        read_model_description(folder, validate=False), Path(folder), InterfaceType[kind], float(step_seconds)
    )
    np.save(result, _continue_from(fmu, Path(state).read_bytes()))


if __name__ == "__main__":
    _main()
