"""Whether a reset, a saved state, another instance and a second run leave everything as it was, to the last bit.

The same calls with the same values are the same arithmetic, so recordings are compared bit by bit; a difference shows memory that
is not part of the state.

    python -m flexfmu.fmu_build.validation.replay FOLDER KIND PACE STATE RESULT    # in a process of its own
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType
from flexfmu.fmu_build.validation.instance import RealArray
from flexfmu.fmu_build.validation.variables import moved, start_of

FRACTIONS = (0.0, 0.25, 0.75)
"""Parts of the run at which states are saved."""

OTHER_PROCESS_TIMEOUT = 60.0
"""Longest wait for a process that replays a state [s]."""

PERTURBATION = 0.02
"""Change of parameters relative to their size."""

READS = 10
"""Further readings of all outputs in each step."""

NEGLIGIBLE = 1e-9
"""Differences, relative to an output's largest value, that give only a warning."""


def repeats_itself(fmu: FmuUnderTest) -> Iterator[Finding]:
    """A second instance does what the first did; outputs that differ from process to process are left out from then on."""
    with fmu.instance("first") as instance:
        first = instance.run()
    with fmu.instance("second") as instance:
        second = instance.run()
    differing = _differing(fmu, first, second)
    if not differing:
        return
    # random by intent, or by memory that instances share?
    fresh = [_in_new_process(fmu, "run") for _ in range(2)]  # where no instance has been before
    random = [variable for variable in differing if variable in _differing(fmu, *fresh)]
    if random and set(random) == set(differing):
        names = ", ".join(variable.name for variable in random)
        message = f"{names}: different at each run, not looked at any further"
        yield Finding("repeatability", message, "the same inputs should give the same outputs", Severity.WARNING)
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
    """Outputs that are not the same in two recordings."""
    rows = min(len(first), len(second))
    offset = first.shape[1] - len(fmu.outputs)
    same = [np.array_equal(a, b, equal_nan=True) for a, b in zip(first[:rows].T, second[:rows].T, strict=True)]
    return [variable for n, variable in enumerate(fmu.outputs) if not same[offset + n]]


def repeats_after_reset(fmu: FmuUnderTest) -> Iterator[Finding]:
    """fmi2Reset brings back the state after instantiation, all of it, parameters and inputs too."""
    remedy = "fmi2Reset has to restore everything, starts included"
    with fmu.instance("reset") as instance:
        first = instance.run()
        instance.reset()
        again = instance.run()
        findings = list(_compare(fmu, "reset", first, again, "after fmi2Reset", remedy))
        # again after a run that has changed all it could
        if not findings:
            instance.reset()
            _run_changed(fmu, instance)
            instance.reset()
            again = instance.run()
            findings = list(
                _compare(fmu, "reset", first, again, "after other parameters and inputs and fmi2Reset", remedy)
            )
    yield from findings


def _run_changed(fmu: FmuUnderTest, instance: Any) -> RealArray:
    """A run with other parameters and inputs; it ends where the FMU can't go on with them."""
    try:
        instance.initialize({variable: moved(variable, PERTURBATION) for variable in changeable(fmu)})
        return np.asarray(instance.advance(0, fmu.steps, size=-3.0))
    except Exception:  # fmpy's own kinds of errors: these values may be impossible
        return np.zeros((0, 1))


def changeable(fmu: FmuUnderTest) -> list[Any]:
    """Real parameters that have another value than their start within their bounds."""
    parameters = [variable for variable in fmu.settable("parameter") if variable.type == "Real"]
    return [variable for variable in parameters if moved(variable, PERTURBATION) != start_of(variable)]


def replays_saved_states(fmu: FmuUnderTest) -> Iterator[Finding]:
    """States contain everything that the future depends on, in whatever order they are used; saving changes nothing."""
    if not fmu.can_save:
        return
    with fmu.instance("undisturbed") as instance:
        undisturbed = instance.run()
    # a run in parts, with states saved between them
    marks = [round(fraction * fmu.steps) for fraction in FRACTIONS]
    with fmu.instance("save") as instance:
        instance.initialize()
        states, parts = [], []
        for mark, end in zip(marks, [*marks[1:], fmu.steps], strict=True):
            states.append(instance.save())
            parts.append(instance.advance(mark, end))
        saving = list(_compare(fmu, "state", undisturbed, np.vstack(parts), _ON_THE_WAY, _SAVING))
        yield from saving
        # from each state, in both orders, the future is the same
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
            yield from _saving_in_used_memory(fmu, instance, states, marks[1], undisturbed)
        # freed states leave no pointer behind
        for state in states:
            instance.discard(state)
        if any(state[0].value for state in states):
            message = "fmi2FreeFMUstate leaves the pointer to the state as it was"
            remedy = "set it to null: a second call would free the state twice"
            yield Finding("state", message, remedy, Severity.WARNING)
    if not saving:
        yield from _saving_in_each_step(fmu, undisturbed)


def _saving_in_used_memory(
    fmu: FmuUnderTest, instance: Any, states: list[Any], mark: int, undisturbed: RealArray
) -> Iterator[Finding]:
    """A finding if a state at ``mark`` differs where it is saved in the memory of the first of ``states``, which it replaces."""
    instance.restore(states[0])
    instance.advance(0, mark)
    states[0] = instance.save(states[0])
    instance.advance(mark, fmu.steps)
    instance.restore(states[0])
    rows = instance.advance(mark, fmu.steps)
    yield from _compare(fmu, "state", undisturbed[mark:], rows, _AGAIN, _STATE_REMEDY)


def _saving_in_each_step(fmu: FmuUnderTest, undisturbed: RealArray) -> Iterator[Finding]:
    """A finding if a run is another one where the state is saved and freed in each step."""
    with fmu.instance("saving") as instance:
        instance.initialize()
        rows = instance.advance(0, min(fmu.steps, 20), between=lambda: instance.discard(instance.save()))
    yield from _compare(fmu, "state", undisturbed[: len(rows)], rows, _ON_THE_WAY, _SAVING)


def brings_inputs_back(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Inputs and time are part of the state: restored after others were set, they have the values that they had."""
    if not fmu.can_save:
        return
    # inputs that may be set to something else
    inputs = list(fmu.inputs)
    if fmu.kind is InterfaceType.COSIMULATION:  # in model exchange discrete ones are set at events alone
        inputs = [v for v in fmu.description.modelVariables if v.causality == "input" and v.type == "Real"]
    inputs = [variable for variable in inputs if moved(variable, PERTURBATION) != start_of(variable)]
    times = [v for v in fmu.description.modelVariables if v.causality == "independent" and v.type == "Real"][:1]
    with fmu.instance("inputs") as instance:
        instance.initialize()
        half = fmu.steps // 2
        instance.advance(0, half)
        if instance.finished:
            return
        # save, go on, restore, set, restore
        state, values, time = instance.save(), instance.get(inputs), instance.get(times)
        instance.advance(half, fmu.steps)  # first of all this sets the inputs, which have been read
        instance.restore(state)
        instance.set(inputs, np.array([moved(variable, PERTURBATION) for variable in inputs]))
        instance.restore(state)
        again, then = instance.get(inputs), instance.get(times)
        instance.discard(state)
    # inputs and time are what they were
    for variable, before, after in zip([*inputs, *times], [*values, *time], [*again, *then], strict=True):
        if not np.isclose(before, after, rtol=1e-9, atol=1e-12 * fmu.step, equal_nan=True):
            message = (
                f"{variable.name} was {before:.9g} when the state was saved, and is {after:.9g} after fmi2SetFMUstate"
            )
            severity = Severity.WARNING if variable in times else Severity.ERROR
            yield Finding("inputs in the state", message, _STATE_REMEDY, severity, variable.name)


def reads_leave_the_state_alone(fmu: FmuUnderTest) -> Iterator[Finding]:
    """A run in which variables are read repeatedly equals one in which they are read once a step."""
    with fmu.instance("read_once") as instance:
        once = instance.run()
    with fmu.instance("read_often") as instance:
        instance.initialize()

        def read() -> None:
            for _ in range(READS):
                instance.get(fmu.outputs)

        often = instance.advance(0, fmu.steps, between=read)
    # an inner iteration that goes on at each reading changes less than the solver's tolerance
    when, room = f"where outputs are read {READS} times more a step", (NEGLIGIBLE, fmu.accuracy)
    yield from _compare(fmu, "reading", once, often, when, _READING, *room)


def replays_serialized_state(fmu: FmuUnderTest) -> Iterator[Finding]:
    """A serialised state works in another instance and in another process."""
    if not fmu.can_serialize:
        return
    half = fmu.steps // 2
    # the rest of a run from the middle, in the same instance and in another one
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
    # in another process, where addresses differ
    slave, model = fmu.description.coSimulation, fmu.description.modelExchange
    both = slave is not None and model is not None and slave.modelIdentifier == model.modelIdentifier
    if findings or (both and fmu.kind is InterfaceType.EXCHANGE):  # the same code has been tried with co-simulation
        return
    when = "with a serialised state in another process"
    remedy = "serialised states must hold values, no addresses"
    yield from _compare(fmu, "serialisation", rows, _in_new_process(fmu, "continue", data), when, remedy)


def _continue_from(fmu: FmuUnderTest, data: bytes) -> RealArray:
    """The second half of the run from a serialised state; without one, all of it."""
    with fmu.instance("other process") as instance:
        if not data:
            return np.asarray(instance.run())
        instance.initialize()
        instance.restore_serialized(data)
        return np.asarray(instance.advance(fmu.steps // 2, fmu.steps))


def _in_new_process(fmu: FmuUnderTest, what: str, data: bytes = b"") -> RealArray:
    """`_continue_from` in a new process.

    Raises:
        RuntimeError: it ends in another way than it should.
    """
    with TemporaryDirectory(prefix="flexfmu-replay-") as home:
        state, result = Path(home) / "state", Path(home) / "rows.npy"
        state.write_bytes(data)
        module = "flexfmu.fmu_build.validation.replay"
        command = [sys.executable, "-m", module, str(fmu.folder), fmu.kind.name, repr(fmu.pace)]
        outcome = subprocess.run(
            [*command, str(state), str(result)], capture_output=True, timeout=OTHER_PROCESS_TIMEOUT, check=False
        )
        if outcome.returncode != 0 or not result.exists():
            last = (outcome.stderr.decode(errors="replace").strip().splitlines() or ["no message"])[-1]
            raise RuntimeError(f"another process that has to {what} ends with {outcome.returncode}: {last}")
        rows: RealArray = np.load(result)
        return rows


def two_instances_are_independent(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Two instances with different parameters and inputs that take turns do what each does alone."""
    if fmu.is_single:
        return
    # each alone, the second one with other values if the FMU runs with them
    with fmu.instance("alone") as instance:
        alone = instance.run()
    with fmu.instance("changed") as instance:
        changed = _run_changed(fmu, instance)
    values = {variable: moved(variable, PERTURBATION) for variable in changeable(fmu)} if len(changed) else {}
    size = -3.0 if len(changed) else 1.0
    # both step by step in turns
    with fmu.instance("one") as one, fmu.instance("two") as two:
        one.initialize()
        two.initialize(values)
        steps = min(len(alone), len(changed) or len(alone))
        turns = [(one.advance(n, n + 1), two.advance(n, n + 1, size)) for n in range(steps)]
    # the first contradiction is enough
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
    """A finding if two recordings differ at all: the arithmetic is the same, so the results must be.

    Relative to a column's largest value, differences up to ``least`` are none, those up to ``negligible`` a warning.
    """
    if len(first) != len(second):
        ends = " and ".join(f"{fmu.start + len(rows) * fmu.step:.6g} s" for rows in (first, second))
        # hardly any tool resets an FMU that has ended the simulation by itself
        severity = Severity.WARNING if check == "reset" else Severity.ERROR
        yield Finding(check, f"the run ends at different times {when}: {ends}", remedy, severity)
        return
    offset = first.shape[1] - len(fmu.outputs)
    if first.shape != second.shape or offset < 0 or np.array_equal(first, second, equal_nan=True):
        return
    # the column that differs most for its size
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
    yield Finding(check, f"{name} differs by up to {worst:.3g} {when}; it should be identical", remedy, severity)


def _main() -> None:
    """Write what the FMU outputs in this process: ``FOLDER KIND PACE STATE RESULT``, see `_in_new_process`."""
    folder, kind, pace, state, result = sys.argv[1:]
    fmu = FmuUnderTest(read_model_description(folder, validate=False), Path(folder), InterfaceType[kind], float(pace))
    np.save(result, _continue_from(fmu, Path(state).read_bytes()))


if __name__ == "__main__":
    _main()
