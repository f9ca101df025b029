"""Values of an FMU's variables: transfers between FMI 2.0 and numpy buffers, as calls with all arguments bound; and start values, set
before initialisation and read back after it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from ctypes import c_char_p, c_void_p
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.fmu.calls import OK, WARNING, Calls, address, value_references
from flexfmu.cosim.engine.fmu.file import UnpackedFmu
from flexfmu.cosim.engine.fmu.fmi3_transfers import Fmi3Transfers
from flexfmu.cosim.engine.fmu.fmi3_variables import by_elements
from flexfmu.cosim.engine.fmu.instance import Checked, Instance, StatusCall
from flexfmu.cosim.engine.fmu.variables import (
    FmiType,
    Handle,
    Setting,
    Value,
    in_words,
    same,
    settable_variables,
    settings,
)
from flexfmu.cosim.engine.slave import TEXTS, RealArray

DTYPES = {"Integer": np.int32, "Boolean": np.int32}
"""Element types of the C arrays of Integer and Boolean variables; fmi2Boolean is an int."""


class Transfers:
    """Makes calls that transfer values between variables of an instance and buffers; a call returns its fmi2Status.

    Buffers are doubles for all types: integers, booleans (0 or 1) and texts (codes in `TEXTS`) are converted.

    Args:
        fmi: the FMI functions.
        component: pointer to the instance; every call reads its current value.
    """

    def __init__(self, fmi: Calls, component: c_void_p) -> None:
        self._fmi = fmi
        self._component = component

    def get(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """Return a call that reads the variables into ``values`` (n,)."""
        return _all(
            [self._get_kind(kind, columns, references, values) for kind, columns, references in _by_kind(handles)]
        )

    def set(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """Return a call that sets the variables from ``values`` (n,)."""
        return _all(
            [self._set_kind(kind, columns, references, values) for kind, columns, references in _by_kind(handles)]
        )

    def get_derivatives(
        self, handles: Sequence[Handle], derivatives: RealArray, absent: NDArray[np.bool_] | None = None
    ) -> StatusCall:
        """Return a call that reads output derivatives into ``derivatives`` (orders, n), row k - 1 for order k.

        Elements of other types than Real, and those that are ``absent`` (orders, n), keep their values.
        """
        return self._derivatives("fmi2GetRealOutputDerivatives", handles, derivatives, absent)

    def set_derivatives(self, handles: Sequence[Handle], derivatives: RealArray) -> StatusCall:
        """Return a call that sets input derivatives from ``derivatives`` (orders, n), of Real inputs only."""
        return self._derivatives("fmi2SetRealInputDerivatives", handles, derivatives)

    def setting(self, setting: Setting) -> StatusCall:
        """Return a call that sets a start value."""
        value = setting.value
        return self.set([setting.handle], np.array([TEXTS.code(value) if isinstance(value, str) else float(value)]))

    def reading(self, setting: Setting) -> tuple[StatusCall, Callable[[], Value]]:
        """Return a call that reads a start value back, and a function that returns the value read."""
        found = np.zeros(1)
        call = self.get([setting.handle], found)
        if setting.handle.kind == "String":
            return call, lambda: TEXTS.known()[int(found[0])]
        return call, lambda: float(found[0])

    def _get_kind(self, kind: FmiType, columns: list[int], references: list[int], values: RealArray) -> StatusCall:
        """Return a call that reads variables of one kind."""
        if kind == "Real" and len(columns) == values.size:
            return self._bind("fmi2GetReal", references, values)
        # other kinds, or some of the columns, through a buffer of their own
        if kind == "String":
            return self._get_texts(columns, references, values)
        buffer = np.zeros(len(columns), DTYPES.get(kind, np.float64))
        read = self._bind(f"fmi2Get{kind}", references, buffer)

        def call() -> int:
            status = read()
            values[columns] = buffer
            return status

        return call

    def _set_kind(self, kind: FmiType, columns: list[int], references: list[int], values: RealArray) -> StatusCall:
        """Return a call that sets variables of one kind."""
        if kind == "Real" and len(columns) == values.size:
            return self._bind("fmi2SetReal", references, values)
        # other kinds, rounded, or some of the columns, through a buffer of their own
        if kind == "String":
            return self._set_texts(columns, references, values)
        buffer = np.zeros(len(columns), DTYPES.get(kind, np.float64))
        write = self._bind(f"fmi2Set{kind}", references, buffer)

        def call() -> int:
            buffer[:] = np.rint(values[columns]) if kind != "Real" else values[columns]
            return write()

        return call

    def _get_texts(self, columns: list[int], references: list[int], values: RealArray) -> StatusCall:
        """Return a call that reads variables of type String, as codes."""
        array, texts = value_references(references), (c_char_p * len(columns))()

        def call() -> int:
            status = int(self._fmi["fmi2GetString"](self._component, address(array), array.size, texts))
            if status <= WARNING:
                values[columns] = [TEXTS.code((text or b"").decode("utf-8", "replace")) for text in texts]
            return status

        return call

    def _set_texts(self, columns: list[int], references: list[int], values: RealArray) -> StatusCall:
        """Return a call that sets variables of type String from codes."""
        array, texts = value_references(references), (c_char_p * len(columns))()

        def call() -> int:
            known = TEXTS.known()
            texts[:] = [known[int(code)].encode() for code in values[columns]]
            return int(self._fmi["fmi2SetString"](self._component, address(array), array.size, texts))

        return call

    def _bind(self, function: str, references: list[int], buffer: NDArray[np.generic]) -> StatusCall:
        """Return the function bound to value references and a buffer; the call keeps both alive."""
        array = value_references(references)
        call = partial(self._fmi[function], self._component, address(array), array.size, address(buffer))
        return _keeping(call, array, buffer)

    def _derivatives(
        self, function: str, handles: Sequence[Handle], derivatives: RealArray, absent: NDArray[np.bool_] | None = None
    ) -> StatusCall:
        """Return one call for all orders of all Real variables that aren't absent."""
        # the derivatives to transfer, order by order
        orders = np.repeat(np.arange(1, len(derivatives) + 1, dtype=np.int32), len(handles))
        references = value_references([handle.reference for handle in handles] * len(derivatives))
        real = np.tile([handle.kind == "Real" for handle in handles], len(derivatives))
        if absent is not None:
            real &= ~absent.ravel()
        if not real.any():
            return lambda: OK
        if real.all():
            return self._bind_derivatives(function, references, orders, derivatives)
        # if some are left out, through a buffer of the others
        buffer = np.zeros(int(real.sum()))
        transfer = self._bind_derivatives(function, references[real], orders[real], buffer)
        flat, getting = derivatives.reshape(-1), function.startswith("fmi2Get")

        def call() -> int:
            if getting:
                status = transfer()
                flat[real] = buffer
                return status
            buffer[:] = flat[real]
            return transfer()

        return call

    def _bind_derivatives(
        self, function: str, references: NDArray[np.uint32], orders: NDArray[np.int32], buffer: RealArray
    ) -> StatusCall:
        """Return the function bound to these arrays; the call keeps them alive."""
        arguments = (address(references), references.size, address(orders), address(buffer))
        return _keeping(partial(self._fmi[function], self._component, *arguments), references, orders, buffer)


def _keeping(call: partial[int], *arrays: NDArray[np.generic]) -> StatusCall:
    """Return the call with references to the arrays whose addresses it uses, so that they stay alive."""
    call.__dict__["arrays"] = arrays
    return call


def _by_kind(handles: Sequence[Handle]) -> list[tuple[FmiType, list[int], list[int]]]:
    """Return (kind, columns, value references) for each kind of variable."""
    kinds = dict.fromkeys(handle.kind for handle in handles)
    columns = {kind: [i for i, handle in enumerate(handles) if handle.kind == kind] for kind in kinds}
    return [(kind, columns[kind], [handles[i].reference for i in columns[kind]]) for kind in kinds]


def _all(calls: Sequence[Callable[[], int]]) -> StatusCall:
    """Return a call that makes all calls and returns the worst status."""
    if len(calls) == 1:
        return calls[0]
    return lambda: max((call() for call in calls), default=OK)


PREFIX = "statistics."
"""Prefix of the names of the counters."""


class Statistics:
    """Counters of an FMU's run: its Integer variables ``statistics.*``.

    Args:
        variables: name → handle of the variables, the counters among them.
        get: function that makes a call which reads variables into a buffer.
    """

    def __init__(
        self, variables: Mapping[str, Handle], get: Callable[[Sequence[Handle], RealArray], StatusCall]
    ) -> None:
        counters = {n: each for n, each in variables.items() if n.startswith(PREFIX) and each.kind == "Integer"}
        self._names = [name.removeprefix(PREFIX) for name in counters]
        self._values = np.zeros(len(counters))
        self._read = get([*counters.values()], self._values)

    def read(self) -> dict[str, int]:
        """Return name without prefix → value; empty if the FMU has no counters or they can't be read."""
        if not self._names or self._read() > WARNING:
            return {}
        return {name: int(value) for name, value in zip(self._names, self._values.tolist(), strict=True)}


@dataclass(frozen=True)
class _Start:
    """A start value and the call that sets it."""

    setting: Setting
    set: Checked


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

    def __init__(
        self, fmu: UnpackedFmu, instance: Instance, transfers: Transfers | Fmi3Transfers, given: Mapping[str, Value]
    ) -> None:
        self._fmu, self._instance, self._transfers = fmu, instance, transfers
        self._readings: dict[str, tuple[StatusCall, Callable[[], Value]]] = {}
        self._starts = self._given = self._starting(given)
        # those that are set together, by name, and whether their values are to be taken over
        self._batch: _BatchSetter | None = None
        self._is_new = True

    def vary(self, changes: Mapping[str, Value]) -> None:
        """Change start values for the next runs; all others are those of the constructor.

        Raises:
            InputError: as for the constructor.
        """
        self._starts, self._is_new = {**self._given, **self._starting(changes)}, True

    def _starting(self, parameters: Mapping[str, Value]) -> dict[str, _Start]:
        """Return name → start value and the call that sets it."""
        transfers, checked = self._transfers, self._instance.checked
        return {
            each.name: _Start(each, checked(f"setting {each.name} = {each.value}", transfers.setting(each)))
            for each in settings(_settable(self._fmu), by_elements(self._fmu.description, parameters))
        }

    def set(self) -> None:
        """Set all start values.

        Raises:
            SlaveError: the FMU refuses one, with its message.
        """
        if self._fmu.is_ours and self._is_new:
            real = {name: each.setting for name, each in self._starts.items() if each.setting.handle.kind == "Real"}
            if self._batch is None or self._batch.names != real.keys():
                self._batch = _BatchSetter([*real.values()], self._transfers)
            self._batch.values[:] = [float(each.value) for each in real.values()]
            self._is_new = False
        done = self._batch.set() if self._batch is not None else frozenset[str]()
        for name, start in self._starts.items():
            if name not in done:
                start.set()

    def set_lost(self) -> None:
        """Set those again, in initialisation mode, that the FMU has lost."""
        for start in self._starts.values():
            found = self._read_back(start.setting)
            if start.setting.lasting and (found is None or not same(start.setting.value, found)):
                self._instance.accepts(start.set.call)

    def differences(self) -> Iterator[tuple[str, str]]:
        """Yield name and a sentence for each start value that differs from the value read back."""
        equal = self._batch.read_equal() if self._batch is not None else frozenset[str]()
        for name, start in self._starts.items():
            # leave out guesses, and variables that can't be read
            if name in equal or not start.setting.lasting:
                continue
            value, found = start.setting.value, self._read_back(start.setting)
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


class _BatchSetter:
    """Start values of type Real that are set and read by one call each; where one fails nothing is said of any of them.

    Args:
        wanted: which variables, in the order of their values.
        transfers: transfers of the FMU's variables.

    Attributes:
        names: names of the variables.
        values: (n,) start values.
    """

    def __init__(self, wanted: list[Setting], transfers: Transfers | Fmi3Transfers) -> None:
        self.names = frozenset(each.name for each in wanted)
        self.values, self._found = np.empty((2, len(wanted)))
        handles = [each.handle for each in wanted]
        self._set, self._get = transfers.set(handles, self.values), transfers.get(handles, self._found)

    def set(self) -> frozenset[str]:
        """Set them; return the names of those that are set."""
        return self.names if self._set() <= WARNING else frozenset()

    def read_equal(self) -> frozenset[str]:
        """Read them; return the names, none of them if one can't be read or differs."""
        equal = self._get() <= WARNING and bool((self._found == self.values).all())
        return self.names if equal else frozenset()


@cache
def _settable(fmu: UnpackedFmu) -> Mapping[str, Any]:
    """Return the FMU's variables whose start values can be set, read once."""
    return settable_variables(fmu.description)
