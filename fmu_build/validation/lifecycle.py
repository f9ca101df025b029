"""Checks of an instance's life cycle: instantiation, a run over the default experiment, memory after it is freed.

Illegal FMI calls must return an error, and calls without variables must succeed.
"""

from __future__ import annotations

import ctypes
import gc
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from copy import copy
from ctypes import c_double, c_uint
from pathlib import Path
from time import monotonic
from typing import Any
from urllib.parse import quote

import numpy as np
from fmpy.fmi1 import FMICallException

from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.fmu import FmuUnderTest, InterfaceType, NoMoreInstancesError, OnlyOnceError
from flexfmu.fmu_build.validation.instance import CANARY, MisbehaviourError, Watch, announce, is_guarded
from flexfmu.fmu_build.validation.variables import attribute, start_of

WHOLE_RUN = 5.0
"""Time limit of the run over the whole default experiment [s]."""

LAG = 0.2
"""Largest error of the independent variable, as a share of the default experiment."""

MORE_SAVINGS = 4
"""Number of times that a state is saved again into the memory of the earlier one."""

STATES = 16
"""Number of states that an instance saves and frees to detect memory leaks: more than what Python itself allocates."""

MEMORY_RUNS = 12
"""Number of instances that are made and freed to detect memory leaks."""

_OUTSIDE = 1e-6
"""Tolerance of an output's range for rounding, relative to its largest value."""


def instantiates(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that the FMU can be instantiated and its binary is for FMI 2.0; all other checks need this."""
    with fmu.instance("version") as instance:
        version, types = instance.library.getVersion(), "default"
        types = types if fmu.is_fmi3 else instance.library.getTypesPlatform()
    if (version, types) != (fmu.description.fmiVersion, "default"):
        message = f"the binary says version {version}, types platform {types}"
        yield Finding(message, f"say {fmu.description.fmiVersion} and default", section="2.1.4")


def refuses_wrong_guid(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2Instantiate refuses the GUID of another FMU."""
    with suppress(RuntimeError), fmu.instance("wrong_guid", guid="{00000000-0000-0000-0000-000000000000}"):
        yield Finding("fmi2Instantiate accepts a wrong GUID", "compare it with the one of the description")


def accepts_odd_uris(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2Instantiate accepts all spellings of the resource location that RFC 3986 and RFC 8089 allow."""
    if fmu.is_fmi3:  # it gives a path
        return
    path = quote(str(fmu.folder / "resources"))
    with temporary_folder("with space") as home:
        copy = shutil.copytree(fmu.folder / "resources", Path(home) / "resources", dirs_exist_ok=True)
        tries = (  # the standard requires the first three; some tools use the others
            (f"file://{path}", "", Severity.ERROR),
            (f"file:{path}", "the authority may be left out", Severity.ERROR),
            (f"file://{quote(str(copy))}", "decode percent signs", Severity.ERROR),
            (f"file://{path}/", "ignore a slash at the end", Severity.WARNING),
            (f"file://localhost{path}", "localhost is this machine (RFC 8089)", Severity.WARNING),
        )
        # instantiate and initialise with each of them
        for uri, remedy, severity in tries:
            shown = uri.replace(str(fmu.folder), "/FOLDER").replace(quote(home), "/with%20space")
            announce(shown)
            try:
                with fmu.instance("uri", uri=uri) as instance:
                    instance.initialize()
            except (OnlyOnceError, NoMoreInstancesError):
                raise
            except Exception as error:  # fmpy's own kinds of errors
                message = f"with {shown} the FMU fails: {' '.join(str(error).split())}"
                yield Finding(message, remedy or "take the resources from there", severity)


def outputs_are_finite(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that outputs are finite and within range over the default experiment; measure the wall time per step."""
    Watch.calls.clear()
    Watch.warnings.clear()
    with fmu.initialized("finite") as instance:
        # variables other than outputs after the initialisation
        for variable in fmu.description.modelVariables:
            if variable.type in ("Real", "Integer") and variable not in fmu.outputs:
                with suppress(FMICallException):
                    values = np.array(instance.read([variable]), dtype=float)
                    yield from _beyond_bounds(variable, values, lambda _: "after the initialisation")
        # the whole experiment, as far as the time limit allows
        begin, rows, done = monotonic(), [], 0
        while done < fmu.all_steps and monotonic() - begin < WHOLE_RUN and not instance.finished:
            rows.append(instance.advance(done, min(done + 10, fmu.all_steps), size=0.0))
            done += len(rows[-1])
        fmu.step_seconds = (monotonic() - begin) / max(done, 1)
        if not instance.finished:
            # an FMU with an internal step may lag behind
            expected, times = fmu.start + done * fmu.step, fmu.times
            value = float(instance.get(times)[0]) if times else expected
            if not abs(value - expected) <= 1.5 * fmu.step + LAG * (fmu.stop - fmu.start):
                name, remedy = times[0].name, "give the time of the communication point"
                message = f"{name} is {value:.9g} s after a run to {expected:.9g} s"
                yield Finding(message, remedy, Severity.WARNING, name, check="time")
            instance.library.terminate()
    # a warning at every second call carries no information
    for function in ("fmi2DoStep", "fmi2GetDerivatives", "fmi2GetReal", "fmi3DoStep", "fmi3GetFloat64"):
        if Watch.warnings[function] > 0.5 * Watch.calls[function]:
            logged = f": {fmu.messages[-1]}" if fmu.messages else ""
            often = f"in {Watch.warnings[function]} of {Watch.calls[function]} calls"
            message = " ".join(f"{function} returns fmi2Warning {often}{logged}".split())
            yield Finding(message, "keep fmi2Warning for what is unusual", Severity.NOTE)
    # a slow FMU may not reach the end
    if done < fmu.all_steps and not instance.finished:
        until, end = (fmu.start + n * fmu.step for n in (done, fmu.all_steps))
        message = f"simulated to {until:.6g} s of {end:.6g} s: a step of {fmu.step:g} s takes {fmu.step_seconds:.2g} s"
        yield Finding(message, "what comes later was not checked", Severity.NOTE)
    if rows:
        yield from _judged(fmu, np.vstack(rows))


def _judged(fmu: FmuUnderTest, rows: Any) -> Iterator[Finding]:
    """Yield findings about values that are not finite, or outside their range."""
    names = [variable.name for variable in fmu.outputs]
    first = rows.shape[1] - len(names)
    # values that are not finite
    bad = ~np.isfinite(rows)
    for column in np.flatnonzero(bad.any(axis=0)):
        row = int(np.argmax(bad[:, column]))
        what = names[column - first] if column >= first else f"derivative {column + 1}"
        message = f"{what} is {rows[row, column]} at {fmu.start + (row + 1) * fmu.step:.6g} s"
        yield Finding(message, "give a number, or return fmi2Error", subject=what)
    # ranges
    for variable, values in zip(fmu.outputs, rows[:, first:].T, strict=True):
        yield from _beyond_bounds(variable, values, lambda n: f"at {fmu.start + (n + 1) * fmu.step:.6g} s")
        if variable.type == "Boolean" and not np.isin(values, (0.0, 1.0)).all():
            message = f"{variable.name} is neither fmi2True nor fmi2False"
            yield Finding(message, "give 1 or 0", subject=variable.name, check="range")


def _beyond_bounds(variable: Any, values: Any, when: Callable[[int], str]) -> Iterator[Finding]:
    """Yield a finding about the first value beyond each bound of the variable, with a tolerance for rounding."""
    room = _OUTSIDE * float(np.abs(values).max(initial=0.0))
    for name, sign in (("min", -1.0), ("max", 1.0)):
        bound = attribute(variable, name)
        if bound is not None and (outside := sign * (values - bound) > room).any():
            n = int(np.argmax(outside))
            message = f"{variable.name} is {values[n]:.6g} {when(n)}, beyond its bound {bound:g}"
            yield Finding(message, "correct min and max, or the value", Severity.WARNING, variable.name, check="range")


def starts_at_the_start_time(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that the independent variable follows a start time other than that of the default experiment."""
    later, is_slave = copy(fmu), fmu.kind is InterfaceType.COSIMULATION
    shift = 10 * fmu.step + 0.5 * (fmu.stop - fmu.start)
    later.start, later.stop = fmu.start + shift, fmu.stop + shift
    if not fmu.times:
        return
    with suppress(FMICallException, MisbehaviourError), later.initialized("later") as instance:
        if instance.finished or (is_slave and not instance.step(0)):
            return
        time, expected = float(instance.get(fmu.times)[0]), later.start + is_slave * fmu.step
        if abs(time - (expected - shift)) < abs(time - expected):
            message = (
                f"the time is {time:.6g} s, not {expected:.6g} s, where an experiment starts at {later.start:.6g} s"
            )
            yield Finding(message, "begin at the start time that the importing tool gives")


def logs_in_its_categories(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that fmi2SetDebugLogging takes each category of the description, and that messages have no others."""
    declared = [category.name for category in fmu.description.logCategories or ()]
    if not declared:
        return
    fmu.categories.clear()
    with fmu.instance("logging") as instance:
        try:
            for names in (*([name] for name in declared), declared):
                instance.library.setDebugLogging(True, names)
        except FMICallException:
            message = f"fmi2SetDebugLogging refuses {', '.join(names)}, which is in LogCategories"
            yield Finding(message, "take all categories, or don't list them", Severity.WARNING)
            return
        instance.initialize()
        instance.advance(0, min(fmu.steps, 5))
        with suppress(FMICallException):
            instance.library.getReal([NO_VARIABLE])
    for name in sorted(fmu.categories - {*declared, ""}):
        message = f"messages have the category {name}, which is not in LogCategories"
        yield Finding(message, "list it, or use one of the list", Severity.WARNING, name)


def gives_memory_back(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check that the FMU frees all memory of instances and states, and writes within its bounds."""
    # memory from the callbacks: freed once, no write out of bounds
    fmu.memory.clear()
    fmu.misuse.clear()
    _short_run(fmu)
    left = len(fmu.memory)
    if fmu.can_save:
        _short_run(fmu, savings=1)
    for misuse in dict.fromkeys(fmu.misuse):
        yield Finding(f"the FMU {misuse}", "run it under AddressSanitizer")
    if any(not is_guarded(block) for block in fmu.memory.values()):
        yield Finding("the FMU writes beyond a block of allocateMemory", "run it under AddressSanitizer")
    if fmu.memory:
        function = "fmi2FreeInstance" if left else "fmi2FreeFMUstate"
        message = f"{function} leaves {left or len(fmu.memory)} blocks of allocateMemory behind"
        yield Finding(message, "free them all", Severity.WARNING)
    # memory from malloc
    lost = _lost_bytes(fmu)
    if lost and not fmu.memory:
        message = f"each instance leaves {lost} bytes of malloc behind"
        yield Finding(message, "free in fmi2FreeInstance what was allocated", Severity.WARNING)
    if lost or fmu.memory or not fmu.can_save:
        return
    # memory of saved states, and of states saved again into the same memory
    lost, again = (_lost_bytes(fmu, savings) // STATES for savings in (1, 1 + MORE_SAVINGS))
    again -= lost
    if lost:
        message, remedy = f"fmi2FreeFMUstate leaves {lost} bytes of a state behind", "free all of it"
        yield Finding(message, remedy, Severity.WARNING, section="2.1.8")
    if again >= MORE_SAVINGS:
        message = f"fmi2GetFMUstate leaves {again // MORE_SAVINGS} bytes behind where it shall use the memory of an earlier state"
        yield Finding(message, "use its memory, or free it", Severity.WARNING, section="2.1.8")


def _short_run(fmu: FmuUnderTest, savings: int = 0) -> None:
    """Run some steps; then save states, each ``savings`` times into the same memory, and free them."""
    with fmu.initialized("memory") as instance:
        instance.advance(0, min(fmu.steps, 5 if savings else 20))
        for _ in range(STATES if savings else 0):
            state = None
            for _ in range(savings):
                state = instance.save(state)
            instance.discard(state)


def _lost_bytes(fmu: FmuUnderTest, savings: int = 0) -> int:
    """Bytes of malloc that each instance leaks; 0 without mallinfo2 (glibc 2.33) or for a slow FMU."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallinfo2") or fmu.step_seconds * 20 * MEMORY_RUNS > WHOLE_RUN:
        return 0
    libc.mallinfo2.restype = _MallocInfo
    # bytes in use after each of several short runs
    used = []
    gc.collect()
    gc.disable()
    try:
        for _ in range(MEMORY_RUNS):
            fmu.memory.clear()
            fmu.messages.clear()
            _short_run(fmu, savings)
            info = libc.mallinfo2()
            used.append(info.uordblks + info.hblkhd)
    finally:
        gc.enable()
    # a leak grows with each run; the first runs fill caches
    grown = np.diff(used[MEMORY_RUNS // 3 :])
    return int(np.median(grown)) if (grown > 0).all() else 0


class _MallocInfo(ctypes.Structure):
    """struct mallinfo2 of glibc."""

    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


NO_VARIABLE = 0x7FFFFFF1
"""A value reference that no variable has."""


FmiCalls = dict[str, tuple[Any, ...]]
"""Name of a call → method of the library, and its arguments."""

_UNKNOWN: FmiCalls = {
    "fmi2GetReal": ("getReal", [NO_VARIABLE]),
    "fmi2SetReal": ("setReal", [NO_VARIABLE], [0.0]),
    "fmi2GetInteger": ("getInteger", [NO_VARIABLE]),
    "fmi2GetBoolean": ("getBoolean", [NO_VARIABLE]),
}


def refuses_illegal_calls(fmu: FmuUnderTest) -> Iterator[Finding]:
    """Check illegal calls (unknown value references, wrong state), calls without variables, and writes out of bounds."""
    # calls without variables, and writes out of bounds
    with fmu.initialized("calls") as instance:
        try:
            instance.library.getReal([])
        except FMICallException as error:
            yield Finding(f"fmi2GetReal of no variable fails: {error}", "nvr = 0 is legal", Severity.WARNING)
        if variables := [variable for variable in fmu.outputs if variable.type == "Real"][:1]:
            values = (c_double * 4)(*[CANARY] * 4)
            references = (c_uint * 1)(variables[0].valueReference)
            instance.library.fmi2GetReal(instance.library.component, references, 1, values)
            if any(value != CANARY for value in values[1:]):
                message = "fmi2GetReal writes more values than nvr"
                yield Finding(message, "fill nvr values", section="2.1.7", check="memory")
    # unknown value references
    when = f"for the value reference {NO_VARIABLE}, which no variable has"
    yield from _accepted(fmu, _UNKNOWN, 0, when, Severity.WARNING)
    # calls in the wrong state
    early: FmiCalls = {"fmi2ExitInitializationMode": ("exitInitializationMode",)}
    late: FmiCalls = {"fmi2EnterInitializationMode": ("enterInitializationMode",)}
    if fmu.kind is InterfaceType.COSIMULATION:
        early["fmi2DoStep"] = ("doStep", fmu.start, fmu.step)
        late["fmi2DoStep with a negative step"] = ("doStep", fmu.start, -fmu.step)
    else:
        early["fmi2NewDiscreteStates"] = ("newDiscreteStates",)
    if fixed := [v for v in fmu.settable("parameter") if v.type == "Real" and v.variability == "fixed"][:1]:
        name, arguments = fixed[0].name, ([fixed[0].valueReference], [start_of(fixed[0])])
        late[f"fmi2SetReal of the fixed parameter {name}"] = ("setReal", *arguments)
    yield from _accepted(fmu, early, None, "before the initialisation")
    yield from _accepted(fmu, late, 0, "after the initialisation")
    if fmu.kind is InterfaceType.COSIMULATION:
        short = copy(fmu)
        short.stop = fmu.start + 2 * fmu.step
        beyond: FmiCalls = {"fmi2DoStep": ("doStep", short.stop, fmu.step)}
        yield from _accepted(short, beyond, 2, "beyond the stop time")


def _accepted(
    fmu: FmuUnderTest, calls: FmiCalls, steps: int | None, when: str, severity: Severity = Severity.NOTE
) -> Iterator[Finding]:
    """Yield one finding for all accepted calls; each call has a separate instance, since an error may end it.

    ``steps`` are made before the call; None: the instance is not even initialised.
    """
    accepted = []
    for name, (method, *arguments) in calls.items():
        with fmu.instance("illegal") as instance:
            if steps is not None:
                instance.initialize()
                instance.advance(0, steps)
            if instance.finished:
                continue
            announce(f"{name} {when}")
            with suppress(FMICallException):
                getattr(instance.library, method)(*arguments)
                accepted.append(name)
    if accepted:
        remedy = "return fmi2Error: mistakes of the importing tool stay hidden otherwise"
        yield Finding(f"{', '.join(accepted)} gives fmi2OK {when}", remedy, severity)
