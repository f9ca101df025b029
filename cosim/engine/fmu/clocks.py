"""Clocks of FMI 3.0: which of them tick when, and the variables that are set and read in their ticks.

Time-based clocks tick at their own instants, for which steps of the FMU end. From a tick at a communication point on the FMU stays in event
mode until its next step begins: inputs set at this point are those of the tick, and outputs read at it are theirs, without delay. A tick within
a communication step takes the inputs set last. A triggered clock is a variable that counts its ticks: an input clock ticks where its number
changes, from 0 at the start.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_bool, c_double, c_int, c_uint
from functools import partial
from itertools import groupby
from math import inf
from typing import Any

import numpy as np

from flexfmu.cosim.engine.fmu.calls import INTERVAL_CHANGED, OK, FmuMode
from flexfmu.cosim.engine.fmu.exchange import MOST_ROUNDS
from flexfmu.cosim.engine.fmu.variables import Handle
from flexfmu.cosim.engine.slave import RealArray, SlaveVariable
from flexfmu.fmu_build.fmi_clock import PERIODIC, TRIGGERED, FmiClock


class Clocks:
    """The clocks of an instance, none by default.

    Args:
        instance: the `Instance`, in whose event mode they tick.
        clocks: the clocks.
        transfers: its `Transfers`.
        variables, handles: variables that the master knows.

    Attributes:
        active: clocks that tick at this instant, by value reference.
        now: time reached [s].
        places: value reference and index of the element → place in `values`, for clocked variables and triggered clocks.
        values: what has been set for the next tick, and read in the last one.
    """

    def __init__(
        self,
        instance: Any,
        clocks: Sequence[FmiClock] = (),
        transfers: Any = None,
        variables: Sequence[SlaveVariable] = (),
        handles: Sequence[Handle] = (),
    ) -> None:
        self._instance, self._clocks = instance, {each.reference: each for each in clocks}
        self._outputs = [each.reference for each in clocks if each.is_output]
        # variables of the same clocks side by side, apart from the clocks
        own = [
            (each.type == "Clock", each.clocks, variable.causality == "output", each, variable.start or 0.0)
            for variable, each in zip(variables, handles, strict=True)
            if each.clocks or each.type == "Clock"
        ]
        own.sort(key=lambda each: each[:3])
        self.places = {(handle.reference, handle.place): k for k, (*_, handle, _) in enumerate(own)}
        self._starts = np.array([start for *_, start in own])
        self.values = self._starts.copy()
        self._transfers: list[tuple[frozenset[int], bool, Any]] = []
        end = 0
        for (is_clock, of, is_output), group in groupby(own, key=lambda each: each[:3]):
            members = [handle for *_, handle, _ in group]
            begin, end = end, end + len(members)
            if not is_clock:
                bind = transfers.get if is_output else transfers.set
                self._transfers.append((frozenset(of), is_output, bind(members, self.values[begin:end], in_tick=True)))
        self.reset()

    def reset(self) -> None:
        """Go back to the start values, for a new instance."""
        self.now = 0.0
        self.active: set[int] = set()
        self.values[:] = self._starts
        # of time-based clocks the first tick, number of ticks and interval, 0 for a single tick; and partitions to be activated
        self._plan: dict[int, tuple[float, int, float]] = {}
        self._due: list[int] = []
        # ticks of output clocks before this instant
        self._counts = dict.fromkeys(self._outputs, 0.0)

    def save(self) -> object:
        """Return the ticks and values, for `restore`."""
        return self.now, set(self.active), self.values.copy(), dict(self._plan), [*self._due], dict(self._counts)

    def restore(self, saved: Any) -> None:
        """Go back to what `save` returned."""
        self.now, active, self.values[:], plan, due, counts = saved
        self.active, self._plan, self._due, self._counts = set(active), dict(plan), [*due], dict(counts)

    def find(self, handles: Sequence[Handle]) -> tuple[list[int], list[int]]:
        """Return the columns of clocked variables among the handles, and their places."""
        columns = [k for k, each in enumerate(handles) if (each.reference, each.place) in self.places]
        return columns, [self.places[handles[k].reference, handles[k].place] for k in columns]

    def begin(self, time: float) -> None:
        """Set clocked inputs, read clocked outputs and plan the first ticks, in initialisation mode."""
        self.now = time
        for _, is_output, call in sorted(self._transfers, key=lambda each: each[1]):
            if is_output:
                self._instance.accepts(call)
            else:
                self._instance.check("setting clocked inputs", call)
        for reference, each in self._clocks.items():
            place = self.places.get((reference, 0))
            if each.variability in PERIODIC and each.interval is not None:
                self._plan[reference] = time + each.shift, 0, each.interval
                if each.variability != "constant":
                    where = byref(c_uint(reference)), 1, byref(c_double(each.interval))
                    self._instance.accepts(partial(self._instance.call, "SetIntervalDecimal", *where))
            elif each.variability != TRIGGERED:
                self._ask(each, first=True)
            elif not each.is_output and place is not None and self.values[place]:
                self._plan[reference] = time, 0, 0.0

    def _ask(self, clock: FmiClock, *, first: bool = False) -> None:
        """Plan the next tick of a clock whose interval the FMU knows."""
        interval, qualifier, shift = c_double(), c_int(), c_double()
        where = byref(c_uint(clock.reference)), 1
        must = self._instance.must
        must("the interval of a clock", "GetIntervalDecimal", *where, byref(interval), byref(qualifier))
        changes = qualifier.value == INTERVAL_CHANGED
        if clock.variability in PERIODIC and (changes or first):
            if first:
                must("the shift of a clock", "GetShiftDecimal", *where, byref(shift))
            self._plan[clock.reference] = self.now + (shift if first else interval).value, 0, interval.value
        elif changes or (clock.variability == "changing" and qualifier.value):
            self._plan[clock.reference] = self.now + interval.value, 0, 0.0

    @property
    def next(self) -> float:
        """The instant of the next tick [s]; infinite without one."""
        return min((first + count * interval for first, count, interval in self._plan.values()), default=inf)

    def put(self, places: Sequence[int], values: RealArray) -> int:
        """Set clocked inputs for the next tick; triggered clocks whose numbers change tick now. Return the status."""
        changed = self.values[places] != values
        self.values[places] = values
        if not changed.any() or not self._instance.initialized:
            return OK
        numbers = {place: reference for (reference, _), place in self.places.items() if reference in self._clocks}
        ticking = [numbers[p] for p, new in zip(places, changed.tolist(), strict=True) if new and p in numbers]
        if ticking:
            self._instance.open_event()
        return self._activate(ticking)

    def tick(self, time: float, near: float = 0.0) -> int:
        """Let the clocks tick that are due at ``time`` [s]; return the status."""
        self.now, due = time, []
        for reference, (first, count, interval) in [*self._plan.items()]:
            if first + count * interval <= time + near:
                due.append(reference)
                self._plan[reference] = first, count + 1, interval
                if not interval:
                    del self._plan[reference]
        return self._activate(due)

    def _activate(self, references: list[int]) -> int:
        """Activate clocks in event mode; model partitions of scheduled execution wait for their inputs."""
        self.active.update(references)
        if self._instance.kind == "ScheduledExecution":
            self._due += references
            return OK
        count = len(references)
        array, ones = (c_uint * count)(*references), (c_bool * count)(*[True] * count)
        return int(self._instance.call("SetClock", array, count, ones)) if count else OK

    def refresh(self) -> int:
        """Set the inputs of active clocks and read their outputs, in event mode; return the worst status."""
        if self._instance.mode not in (FmuMode.EVENT, FmuMode.OPEN_EVENT):
            return OK
        statuses = [call() for of, is_output, call in self._transfers if not is_output and of & self.active]
        # model partitions, those included whose countdown ends at once
        for _ in range(MOST_ROUNDS):
            if not self._due:
                break
            self._due.sort(key=lambda reference: self._clocks[reference].priority)
            partition = self._due.pop(0)
            statuses.append(self._instance.call("ActivateModelPartition", partition, self.now))
            self._plan_after({partition})
        else:
            raise self._instance.hangs("activates model partitions", self.now)
        # output clocks that tick with them
        count, ticks = len(self._outputs), (c_bool * len(self._outputs))()
        if count:
            statuses.append(self._instance.call("GetClock", (c_uint * count)(*self._outputs), count, ticks))
        for reference, ticking in zip(self._outputs, ticks, strict=True):
            self.active |= {reference} if ticking else set()
            if (place := self.places.get((reference, 0))) is not None:
                self.values[place] = self._counts[reference] + (reference in self.active)
        statuses += [call() for of, is_output, call in self._transfers if is_output and of & self.active]
        return max(statuses, default=OK)

    def updated(self) -> bool:
        """Plan the next ticks after an update of discrete states, with which all ticks end; return whether clocks tick at once."""
        ticked, self.active = self.active, set()
        for reference in self._outputs:
            self._counts[reference] += reference in ticked
        return self._instance.kind != "ScheduledExecution" and self._plan_after(ticked)

    def _plan_after(self, ticked: set[int]) -> bool:
        """Plan the next ticks after those of some clocks; return whether clocks tick at once."""
        for reference, each in self._clocks.items():
            asks = each.variability == "countdown" or (each.variability == "tunable" and each.interval is None)
            if asks or (each.variability == "changing" and reference in ticked):
                self._ask(each)
        if self.next > self.now:
            return False
        self._instance.check("activating clocks", lambda: self.tick(self.now))
        return True
