"""Values of an FMU's variables: transfers between FMI functions and numpy buffers, as calls with all arguments bound; and start values,
set before initialisation and read back after it.

FMI 3.0 transfers whole arrays: if only some elements of an array are set, the others keep the values set last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes import addressof, c_char_p
from dataclasses import replace
from functools import lru_cache, partial
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.fmu.calls import OK, WARNING, Version, address, value_references
from flexfmu.cosim.engine.fmu.clocks import Clocks
from flexfmu.cosim.engine.fmu.exchange import ContinuousTime
from flexfmu.cosim.engine.fmu.file import EXCHANGE_ORDER, KEPT, UnpackedFmu
from flexfmu.cosim.engine.fmu.instance import Checked, Instance, StatusCall
from flexfmu.cosim.engine.fmu.variables import (
    Handle,
    Setting,
    Value,
    by_elements,
    in_words,
    same,
    settable_variables,
    settings,
)
from flexfmu.cosim.engine.slave import TEXTS, RealArray
from flexfmu.fmu_build.interface import FIRST_DERIVATIVES

FACTORIALS = np.array([float(factorial(k)) for k in range(1, EXCHANGE_ORDER + 1)])
"""k! from k = 1 on."""


class Transfers:
    """Makes calls that transfer values between variables of an instance and buffers; a call returns its fmi2Status or fmi3Status.

    Buffers are doubles for all types: integers, booleans (0 or 1) and texts (codes in `TEXTS`) are converted, and integers beyond
    2^53 are rounded. Transfers of nothing but Real variables of FMI 2.0 are `partial` calls of one FMI function on the caller's own
    buffer, which the loop in C makes itself.

    Args:
        instance: the instance; calls stay valid for the next ones.
    """

    def __init__(self, instance: Instance) -> None:
        self._instance = instance
        self._arrays: dict[int, NDArray[Any]] = {}
        self._seen_instance = 0

    def get(self, handles: Sequence[Handle], values: RealArray, *, in_tick: bool = False) -> StatusCall:
        """Return a call that reads the variables into ``values`` (n,); ``in_tick``: clocked ones from the FMU, in a tick of theirs."""
        if (direct := self._directly("fmi2GetReal", handles, values)) is not None:
            return direct
        # one FMI call for each type
        clocks, clocked, places = self._clocked(handles, in_tick=in_tick)
        groups = [self._group(each, columns) for each, columns in _groups(handles, clocked, by_event=False)]
        reads = [(self._function("Get", group), group) for group in groups]
        component = self._instance.component

        # return the worst status; values of failed calls are not copied
        def call() -> int:
            worst = OK
            for read, group in reads:
                if (status := read(component, *group.arguments)) <= WARNING:
                    values[group.columns] = group.read()
                worst = max(worst, status)
            if clocks is not None:
                worst = max(worst, clocks.refresh())
                values[clocked] = clocks.values[places]
            return worst

        return call

    def get_at(self, handles: Sequence[Handle], values: RealArray, places: Sequence[tuple[int, ...]]) -> StatusCall:
        """Return a call that reads the variables into these places of ``values``; all others become zero."""
        buffer, where = np.zeros(len(handles)), tuple(np.array(places, np.intp).reshape(len(handles), -1).T)
        read = self.get(handles, buffer)

        def call() -> int:
            status = read()
            values[:] = 0.0
            values[where] = buffer
            return status

        return call

    def _clocked(self, handles: Sequence[Handle], *, in_tick: bool) -> tuple[Clocks | None, list[int], list[int]]:
        """Return the instance's clocks, the columns of clocked variables and their places there; None without such variables."""
        columns, places = ([], []) if in_tick else self._instance.clocks.find(handles)
        return self._instance.clocks if columns else None, columns, places

    def set(self, handles: Sequence[Handle], values: RealArray, *, in_tick: bool = False) -> StatusCall:
        """Return a call that sets the variables from ``values`` (n,); at events discrete ones only if they change; ``in_tick``: clocked
        ones in the FMU, in a tick of theirs."""
        instance, exchanges = self._instance, self._instance.exchange is not None
        if not exchanges and (direct := self._directly("fmi2SetReal", handles, values)) is not None:
            return direct
        clocks, clocked, places = self._clocked(handles, in_tick=in_tick)
        groups = [self._group(each, columns) for each, columns in _groups(handles, clocked, by_event=True)]
        # continuous variables are set in step mode, discrete ones at an event; in model exchange any jump is one
        continuous, discrete = (
            [each for each in groups if (each.discrete or exchanges) is kind] for kind in (False, True)
        )

        def call() -> int:
            worst = max((self._send(group, values) for group in continuous), default=OK)
            if clocks is not None:
                worst = max(worst, clocks.put(places, values[clocked]))
            if not discrete or worst > WARNING:
                return worst
            # an event, if a discrete variable changes
            changed = [each for each in discrete if each.changes(values, instance.epoch) or not instance.at_events]
            if changed:
                worst = max(worst, instance.at_event(lambda: max(self._send(each, values) for each in changed)))
            return worst

        return call

    def get_derivatives(
        self, handles: Sequence[Handle], derivatives: RealArray, absent: NDArray[np.bool_] | None = None
    ) -> StatusCall:
        """Return a call that reads output derivatives into ``derivatives`` (orders, n), row k - 1 for order k.

        Elements of other types than Real, and those that are ``absent`` (orders, n), keep their values.
        """
        return self._derivatives(self._instance.version.output_derivatives, handles, derivatives, absent)

    def set_derivatives(self, handles: Sequence[Handle], derivatives: RealArray) -> StatusCall:
        """Return a call that sets input derivatives from ``derivatives`` (orders, n), of Real inputs only.

        FMI 3.0 has no function for them; our own FMUs take them as arrays, other FMUs not at all. In model exchange they are
        polynomials, which the integrator follows.
        """
        if self._instance.exchange is not None:
            return self._polynomials(self._instance.exchange, handles, derivatives)
        if self._instance.version.counts_values:
            return self._derivative_arrays(handles, derivatives)
        return self._derivatives("fmi2SetRealInputDerivatives", handles, derivatives)

    def _polynomials(self, exchange: ContinuousTime, handles: Sequence[Handle], derivatives: RealArray) -> StatusCall:
        """Return the call that lets real inputs of double precision follow polynomials from their present values on, until they
        are set again; elements of their arrays that aren't among them are held."""
        columns = [column for column, each in enumerate(handles) if each.type in ("Real", "Float64")]
        own = {handles[column].reference: handles[column] for column in columns}
        whole = [replace(each, place=place) for each in own.values() for place in range(each.size)]
        at = {(each.reference, each.place): index for index, each in enumerate(whole)}
        places = [at[handles[column].reference, handles[column].place] for column in columns]
        start, references = np.empty(len(whole)), value_references([*own])
        read = self.get(whole, start)

        def call() -> int:
            taylor = derivatives[:, columns] / FACTORIALS[: len(derivatives), None]
            if not taylor.any():
                exchange.follow(call, references, None)
                return OK
            status = read()
            coefficients = np.zeros((1 + len(taylor), len(whole)))
            coefficients[0], coefficients[1:, places] = start, taylor
            exchange.follow(call, references, coefficients)
            return status

        return call

    def _derivative_arrays(self, handles: Sequence[Handle], derivatives: RealArray) -> StatusCall:
        """Return the call of FMI 3.0 for input derivatives (orders, n); higher ones are zero."""
        columns = [column for column, each in enumerate(handles) if each.kind == "Real"]
        if not self._instance.input_order or not columns:
            return lambda: OK
        values = np.zeros((len(columns), self._instance.input_order))
        references = value_references([FIRST_DERIVATIVES + handles[column].reference for column in columns])
        send = self._bound("fmi3SetFloat64", references, values)

        def call() -> int:
            values[:, : len(derivatives)] = derivatives[:, columns].T
            return send(values.size)

        return call

    def setting(self, setting: Setting) -> StatusCall:
        """Return a call that sets a start value; a structural parameter in configuration mode."""
        value, handle = setting.value, setting.handle
        send = self.set([handle], np.array([TEXTS.code(value) if isinstance(value, str) else float(value)]))
        return (lambda: self._instance.configure(send)) if handle.structural else send

    def reading(self, setting: Setting) -> tuple[StatusCall, Callable[[], Value]]:
        """Return a call that reads a start value back, and a function that returns the value read."""
        found = np.zeros(1)
        call = self.get([setting.handle], found)
        if setting.handle.kind == "String":
            return call, lambda: TEXTS.known()[int(found[0])]
        return call, lambda: float(found[0])

    def _directly(self, function: str, handles: Sequence[Handle], values: RealArray) -> StatusCall | None:
        """Return the function of FMI 2.0 bound to the buffer, if it takes all of it as it is."""
        if self._instance.version.counts_values or not handles or any(each.kind != "Real" for each in handles):
            return None
        return self._bound(function, value_references([each.reference for each in handles]), values)

    def _bound(self, function: str, references: NDArray[np.uint32], *buffers: NDArray[Any]) -> partial[int]:
        """Return the function bound to value references and buffers; the call keeps them alive."""
        where = map(address, buffers)
        call: partial[int] = partial(
            self._instance.calls[function], self._instance.component, address(references), references.size, *where
        )
        call.__dict__["arrays"] = references, buffers
        return call

    def _function(self, verb: str, group: _Group) -> Callable[..., int]:
        return self._instance.calls[f"{self._instance.version.prefix}{verb}{group.type}"]

    def _group(self, handles: Sequence[Handle], columns: Sequence[int]) -> _Group:
        return _Group(self._instance.version, handles, columns)

    def _send(self, group: _Group, values: RealArray) -> int:
        """Set the variables of a group; return the status.

        Raises:
            SlaveError: a value doesn't fit the type.
        """
        # elements of an array that aren't set keep their values
        for handle, place in group.arrays:
            group.buffer[place] = self._array(handle)
        if (misfit := group.fill(values)) is not None:
            name, value = misfit
            raise SlaveError(self._instance.name, f"{name} is of type {group.type} and can't be {value:.12g}")
        for handle, place in group.arrays:
            self._array(handle)[:] = group.buffer[place]
        return self._function("Set", group)(self._instance.component, *group.arguments)

    def _array(self, handle: Handle) -> NDArray[Any]:
        """Return the values last set of an array in this instance; at first its start values."""
        if self._seen_instance != self._instance.instances:
            self._seen_instance = self._instance.instances
            self._arrays.clear()
        if handle.reference not in self._arrays:
            # start values; without any in the description, the present values
            group = self._group([replace(handle, place=place) for place in range(handle.size)], [])
            if handle.start is not None:
                self._arrays[handle.reference] = np.array(handle.start, group.buffer.dtype)
            else:
                self._function("Get", group)(self._instance.component, *group.arguments)
                self._arrays[handle.reference] = group.read()
        return self._arrays[handle.reference]

    def _derivatives(
        self, function: str, handles: Sequence[Handle], derivatives: RealArray, absent: NDArray[np.bool_] | None = None
    ) -> StatusCall:
        """Return one call for all orders of all Real variables that aren't absent."""
        # the elements to transfer, order by order
        wanted = [
            (row, column, handle)
            for row in range(len(derivatives))
            for column, handle in enumerate(handles)
            if handle.kind == "Real" and (absent is None or not absent[row, column])
        ]
        if not wanted:
            return lambda: OK
        # each array once per order, one after another in one buffer
        sizes = {(row, handle.reference): handle.size for row, _, handle in wanted}
        begins = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
        places = [begins[row, handle.reference] + handle.place for row, _, handle in wanted]
        flat, columns = derivatives.reshape(-1), [row * len(handles) + column for row, column, _ in wanted]
        references = value_references([reference for _, reference in sizes])
        orders = np.array([row + 1 for row, _ in sizes], np.int32)
        counts_values = self._instance.version.counts_values
        if not counts_values and len(sizes) == flat.size:
            return self._bound(function, references, orders, derivatives)
        # through a buffer of these elements
        buffer, getting = np.zeros(sum(sizes.values())), "Get" in function
        transfer, more = self._bound(function, references, orders, buffer), (buffer.size,) if counts_values else ()

        def call() -> int:
            if not getting:
                buffer[places] = flat[columns]
            status = int(transfer(*more))
            if getting and status <= WARNING:
                flat[columns] = buffer[places]
            return status

        return call


class _Group:
    """Variables of one type, as whole arrays, in a buffer for the FMI functions.

    Attributes:
        type: FMI type of the variables.
        discrete: whether they change only at events.
        columns: indices of the requested elements in the caller's buffer of doubles.
        buffer: values of all elements, in the element type of the FMI functions.
        arguments: addresses and sizes of value references and buffer, for the FMI functions.
        arrays: (one of its elements, slice of the buffer) for each array.
    """

    def __init__(self, version: Version, handles: Sequence[Handle], columns: Sequence[int]) -> None:
        first = handles[0]
        self.type, self.discrete, self.columns = first.type, first.discrete, np.array(columns, np.intp)
        self._names = [each.name for each in handles]
        # a slice of the buffer for each whole array
        own = {each.reference: each for each in handles}
        begins = dict(zip(own, np.cumsum([0, *(each.size for each in own.values())]).tolist(), strict=False))
        self._places = np.array([begins[each.reference] + each.place for each in handles], np.intp)
        total = sum(each.size for each in own.values())
        self.arrays = [(each, slice(begins[n], begins[n] + each.size)) for n, each in own.items() if each.size > 1]
        # buffers for the FMI functions: texts as pointers, with their codes in ``buffer``
        self._references = value_references(list(own))
        self._texts = (c_char_p * total)() if self.type == "String" else None
        self.buffer = np.zeros(total, version.dtypes.get(self.type, np.float64))
        where = address(self.buffer) if self._texts is None else addressof(self._texts)
        self.arguments = address(self._references), len(own), where, *([total] if version.counts_values else [])
        self._sent = np.full(len(columns), np.nan)
        self._epoch = -1

    def read(self) -> NDArray[Any]:
        """Return the requested elements of the buffer; texts as codes."""
        if self._texts is not None:
            for place in self._places.tolist():
                self.buffer[place] = TEXTS.code((self._texts[place] or b"").decode("utf-8", "replace"))
        return self.buffer[self._places]

    def fill(self, values: RealArray) -> tuple[str, float] | None:
        """Write values to the buffer; return name and value of the first that doesn't fit the type, None if all do."""
        new = values[self.columns]
        # integers are rounded and must be within the range of their type
        if self.buffer.dtype.kind in "iu":
            new = np.rint(new)
            limits = np.iinfo(self.buffer.dtype)
            fits = (new >= float(limits.min)) & (new < float(limits.max) + 1.0)
            if not fits.all():
                wrong = int(np.argmin(fits))
                return self._names[wrong], float(new[wrong])
        self.buffer[self._places] = new
        if self._texts is not None:
            known = TEXTS.known()
            self._texts[:] = [known[int(code)].encode() for code in self.buffer]
        return None

    def changes(self, values: RealArray, epoch: int) -> bool:
        """Return whether the values differ from those of the last call, or may differ from the FMU's."""
        new = values[self.columns]
        if self._epoch == epoch and np.array_equal(new, self._sent):
            return False
        self._epoch, self._sent = epoch, new
        return True


def _groups(
    handles: Sequence[Handle], without: Sequence[int], *, by_event: bool
) -> list[tuple[list[Handle], list[int]]]:
    """Return (handles, columns) for each type, ``without`` some columns; with ``by_event`` discrete variables have their own groups."""
    found: dict[tuple[str, bool], tuple[list[Handle], list[int]]] = {}
    for column, handle in enumerate(handles):
        if column in without:
            continue
        members, columns = found.setdefault((handle.type, handle.discrete and by_event), ([], []))
        members.append(handle)
        columns.append(column)
    return list(found.values())


class StartValues:
    """Sets start values of parameters and inputs, and compares them with what the FMU makes of them.

    The real ones of our FMUs are set and read by one call; other FMUs may refuse one and take the rest.

    Args:
        fmu: the FMU.
        instance: its current instance.
        transfers: transfers of its variables.
        given: start values by name.

    Raises:
        InputError: a parameter doesn't exist, or its value doesn't fit its type or range.
    """

    def __init__(self, fmu: UnpackedFmu, instance: Instance, transfers: Transfers, given: Mapping[str, Value]) -> None:
        self._fmu, self._instance, self._transfers = fmu, instance, transfers
        self._readings: dict[str, tuple[StatusCall, Callable[[], Value]]] = {}
        self._starts = self._given = self._starting(given)
        # those that are set together: names, values set and read, and the calls; and whether the values are to be taken over
        self._names: frozenset[str] = frozenset()
        self._values = self._found = np.empty(0)
        self._set: StatusCall = lambda: OK
        self._get: StatusCall = lambda: OK
        self._is_new = True

    def vary(self, changes: Mapping[str, Value]) -> None:
        """Change start values for the next runs; all others are those of the constructor.

        Raises:
            InputError: as for the constructor.
        """
        self._starts, self._is_new = {**self._given, **self._starting(changes)}, True

    @property
    def numbers(self) -> Mapping[str, float]:
        """Name → start value, of those that aren't texts."""
        return {name: float(each.value) for name, (each, _) in self._starts.items() if not isinstance(each.value, str)}

    def _starting(self, parameters: Mapping[str, Value]) -> dict[str, tuple[Setting, Checked]]:
        """Return name → start value and the call that sets it."""
        return {
            each.name: (
                each,
                Checked(self._instance, f"setting {each.name} = {each.value}", self._transfers.setting(each)),
            )
            for each in settings(_settable(self._fmu), by_elements(self._fmu.description, parameters))
        }

    def set(self) -> None:
        """Set all start values.

        Raises:
            SlaveError: the FMU refuses one, with its message.
        """
        if self._fmu.is_ours and self._is_new:
            real = {name: each for name, (each, _) in self._starts.items() if each.handle.kind == "Real"}
            if self._names != real.keys():
                handles, self._names = [each.handle for each in real.values()], frozenset(real)
                self._values, self._found = np.empty((2, len(real)))
                self._set, self._get = (
                    self._transfers.set(handles, self._values),
                    self._transfers.get(handles, self._found),
                )
            self._values[:] = [float(each.value) for each in real.values()]
            self._is_new = False
        # one by one where one of them fails
        done = self._names if self._set() <= WARNING else frozenset[str]()
        for name, (_, send) in self._starts.items():
            if name not in done:
                send()

    def set_lost(self) -> None:
        """Set those again, in initialisation mode, that the FMU has lost."""
        for setting, send in self._starts.values():
            found = self._read_back(setting)
            if setting.lasting and (found is None or not same(setting.value, found)):
                self._instance.accepts(send.call)

    def differences(self) -> Iterator[tuple[str, str]]:
        """Yield name and a sentence for each start value that differs from the value read back."""
        equal = self._get() <= WARNING and bool((self._found == self._values).all())
        for name, (setting, _) in self._starts.items():
            # leave out guesses, and variables that can't be read
            if (equal and name in self._names) or not setting.lasting:
                continue
            value, found = setting.value, self._read_back(setting)
            if found is not None and not same(value, found):
                variable = _settable(self._fmu)[name]
                yield (
                    name,
                    f"{name} was set to {in_words(variable, value)}, but is {in_words(variable, found)} after initialisation: "
                    f"{self._fmu.path.name} ignores it or calculates it",
                )

    def _read_back(self, setting: Setting) -> Value | None:
        """Return the present value of a variable with a start value; None if the FMU doesn't provide it."""
        if setting.name not in self._readings:
            self._readings[setting.name] = self._transfers.reading(setting)
        call, value = self._readings[setting.name]
        return value() if self._instance.accepts(call) else None


@lru_cache(maxsize=KEPT)
def _settable(fmu: UnpackedFmu) -> Mapping[str, Any]:
    """Return the FMU's variables whose start values can be set, read once."""
    return settable_variables(fmu.description)
