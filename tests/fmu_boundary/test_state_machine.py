"""Drawn lives of an instance beside a model of it: the standard's states, the values that were set, and what equal histories
have given before."""

from __future__ import annotations

import math
from contextlib import ExitStack
from ctypes import byref, c_int, c_void_p
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from boundary_support.raw import DISCARD, DO_STEP_STATUS, ERROR, OK, RawInstance, raw_instance
from boundary_support.standard import is_allowed
from boundary_support.subjects import FILES
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

KIND = "co-simulation"
STEPS = (1e-3, 2.5e-4, 4e-3)
VALUES = st.sampled_from([0.0, 0.125, -0.25, 0.3, 1e9, -1e9, math.nan, math.inf])
RATES = st.sampled_from([0.0, 0.5, -2.0, math.nan])


@dataclass(frozen=True)
class Expected:
    """What an instance is known to be.

    Attributes:
        state: of the standard.
        time: communication point [s].
        values: settable variables that were set since the start, reference → value; an input with derivatives has none.
        last: status of the last step.
        history: all that was done to it and changes results.
    """

    state: str = "instantiated"
    time: float = 0.0
    values: dict[int, float] = field(default_factory=dict)
    last: int = OK
    history: tuple[object, ...] = ()

    def after(self, *event: object, **changes: object) -> Expected:
        return replace(self, history=(*self.history, event), **changes)  # type: ignore[arg-type]


class Life(RuleBasedStateMachine):
    """One instance, many calls.

    Attributes:
        path, folder: the FMU and where it is unpacked.
    """

    path: Path
    folder: Path

    @initialize(goes_on=st.booleans())
    def begin(self, goes_on: bool) -> None:
        self.stack = ExitStack()
        self.fmu: RawInstance = self.stack.enter_context(raw_instance(self.path, self.folder))
        self.now = Expected()
        self.saved: list[tuple[c_void_p, Expected]] = []
        self.known: dict[tuple[object, ...], tuple[int, list[float]]] = {}
        if goes_on:
            self.enter()
            self.leave()

    def teardown(self) -> None:
        for state, _ in self.saved:
            assert self.fmu.free(state) == OK
        self.stack.close()

    def serves(self, function: str) -> bool:
        return is_allowed(KIND, function, self.now.state)

    def go(self, function: str, state: str, *arguments: object) -> None:
        """A call without a result, which leads to that state where it is legal."""
        status = self.fmu.call(function, *arguments)
        if not self.serves(function):
            assert status == ERROR
        elif status == OK:
            self.now = self.now.after(function, state=state)
        else:
            assert (function, status) == ("fmi2ExitInitializationMode", ERROR)

    @rule(start=st.sampled_from([0.0, 2.0]))
    def set_up(self, start: float) -> None:
        status = self.fmu.call("fmi2SetupExperiment", 1, 1e-7, start, 0, 0.0)
        assert status == (OK if self.serves("fmi2SetupExperiment") else ERROR)
        if status == OK:
            self.now = self.now.after("set up", start, time=start)

    @rule()
    def enter(self) -> None:
        self.go("fmi2EnterInitializationMode", "initialization")

    @rule()
    def leave(self) -> None:
        self.go("fmi2ExitInitializationMode", "step complete")

    @rule(seldom=st.integers(0, 5))
    def terminate(self, seldom: int) -> None:
        if seldom == 0:
            self.go("fmi2Terminate", "terminated")

    @rule(seldom=st.integers(0, 3))
    def reset(self, seldom: int) -> None:
        if seldom == 0:
            assert self.fmu.call("fmi2Reset") == OK
            self.now = Expected()

    @rule(index=st.integers(0, 1000), value=VALUES)
    def set_value(self, index: int, value: float) -> None:
        references = [self.fmu.references[name] for name in self.fmu.settable]
        reference = references[index % len(references)] if references else 0
        status = self.fmu.set([reference], [value])
        if not self.serves("fmi2SetReal") or not references or not math.isfinite(value):
            assert status == ERROR
        elif status == OK:
            self.now = self.now.after("set", reference, value, values={**self.now.values, reference: value})

    @rule(rate=RATES)
    def set_derivative(self, rate: float) -> None:
        reference = self.fmu.references[self.fmu.inputs[0]] if self.fmu.inputs else 0
        status = self.fmu.set_derivative(reference, 1, rate)
        good = self.serves("fmi2SetRealInputDerivatives") and bool(self.fmu.inputs) and math.isfinite(rate)
        assert status == (OK if good else ERROR)
        if good:
            values = {each: value for each, value in self.now.values.items() if each != reference}
            self.now = self.now.after("rate", rate, values=values)

    @rule(size=st.sampled_from(STEPS))
    def step(self, size: float) -> None:
        status = self.fmu.step(self.now.time, size)
        if not self.serves("fmi2DoStep"):
            assert status == ERROR
            return
        assert status in (OK, DISCARD)
        time = self.fmu.last_time()
        assert time == self.now.time + size if status == OK else self.now.time <= time <= self.now.time + size
        state = "step complete" if status == OK else "step failed"
        self.now = self.now.after("step", size, time=time, state=state, last=status)

    @rule(size=st.sampled_from([0.0, -1e-3, math.nan, math.inf]), shift=st.sampled_from([0.0, 0.5]))
    def step_badly(self, size: float, shift: float) -> None:
        assert self.fmu.step(self.now.time + shift, size) == ERROR

    @rule()
    def save(self) -> None:
        self.saved.append((self.fmu.save(), self.now))

    @precondition(lambda self: self.saved)
    @rule(index=st.integers(0, 1000), through_bytes=st.booleans())
    def restore(self, index: int, through_bytes: bool) -> None:
        state, then = self.saved[index % len(self.saved)]
        if through_bytes:
            status, copy = self.fmu.deserialized(self.fmu.serialized(state))
            assert status == OK
            self.saved.append((copy, then))
            state = copy
        assert self.fmu.call("fmi2SetFMUstate", state) == OK
        self.now = then

    @invariant()
    def values_are_those_that_were_set(self) -> None:
        if self.now.values and self.serves("fmi2GetReal"):
            references = list(self.now.values)
            status, values = self.fmu.get(references)
            if status == OK:
                assert values == [self.now.values[each] for each in references]
            else:
                assert self.now.state in ("instantiated", "initialization", "terminated", "step failed")

    @invariant()
    def equal_histories_give_equal_outputs(self) -> None:
        status, values = self.fmu.get([self.fmu.references[name] for name in self.fmu.outputs])
        if self.now.state == "instantiated":
            assert status == ERROR
            return
        if status == OK:
            assert all(map(math.isfinite, values))
        known = self.known.setdefault(self.now.history, (status, values if status == OK else []))
        assert known == (status, values if status == OK else [])

    @invariant()
    def the_status_is_that_of_the_last_step(self) -> None:
        value = c_int(-1)
        status = self.fmu.call("fmi2GetStatus", DO_STEP_STATUS, byref(value))
        assert (status, value.value) == ((OK, self.now.last) if self.serves("fmi2GetStatus") else (ERROR, -1))


LIVES = settings(max_examples=15, stateful_step_count=40, suppress_health_check=list(HealthCheck))


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_drawn_lives_go_as_the_standard_says(name: str, tmp_path: Path) -> None:
    """Hypothesis cuts a sequence that fails down to a few calls that a reader understands."""
    life = type("Life", (Life,), {"path": FILES[name](), "folder": tmp_path / "fmu"})
    run_state_machine_as_test(life, settings=LIVES)
