"""Transfers between variables of an FMI 3.0 FMU and numpy buffers, as calls with all arguments bound.

FMI 3.0 transfers whole arrays: if only some elements of an array are set, the others keep the values set last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import addressof, c_char_p
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.fmu.calls import DTYPES, OK, WARNING, address, value_references
from flexfmu.cosim.engine.fmu.fmi3 import Fmi3Instance
from flexfmu.cosim.engine.fmu.fmi3_variables import ElementHandle
from flexfmu.cosim.engine.fmu.instance import StatusCall
from flexfmu.cosim.engine.fmu.variables import Handle, Setting, Value
from flexfmu.cosim.engine.slave import TEXTS, RealArray


class Fmi3Transfers:
    """Makes calls that transfer values between variables of an instance and buffers, as `Transfers` for FMI 2.0.

    Buffers are doubles for all types of variables; integers beyond 2^53 are rounded.

    Args:
        instance: the instance; calls stay valid for the next ones.
    """

    def __init__(self, instance: Fmi3Instance) -> None:
        self._instance = instance
        self._arrays: dict[int, NDArray[Any]] = {}
        self._seen_instance = 0

    def get(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """Return a call that reads the variables into ``values`` (n,)."""
        # one FMI call for each type
        groups = [_Group(each, columns) for each, columns in _groups(handles, by_event=False)]
        fmi, component = self._instance.fmi, self._instance.component
        reads = [(fmi[f"fmi3Get{group.type}"], group) for group in groups]

        # return the worst status; values of failed calls are not copied
        def call() -> int:
            worst = OK
            for read, group in reads:
                worst = max(worst, read(component, *group.arguments))
                if worst <= WARNING:
                    values[group.columns] = group.read()
            return worst

        return call

    def set(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """Return a call that sets the variables from ``values`` (n,); at events discrete ones only if they change."""
        groups = [_Group(each, columns) for each, columns in _groups(handles, by_event=True)]
        # continuous variables are set in step mode, discrete ones at an event
        continuous, discrete = ([each for each in groups if each.discrete is kind] for kind in (False, True))
        instance = self._instance

        def call() -> int:
            worst = max((self._send(group, values) for group in continuous), default=OK)
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

        Elements of other types than floats, and those that are ``absent`` (orders, n), keep their values.
        """
        # the elements to read, order by order
        wanted = [
            (row, column, cast(ElementHandle, handle))
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
        flat = [row * len(handles) + column for row, column, _ in wanted]
        # arguments of the function, and the target of the elements
        references = value_references([reference for _, reference in sizes])
        orders = np.array([row + 1 for row, _ in sizes], np.int32)
        buffer, target = np.zeros(sum(sizes.values())), derivatives.reshape(-1)
        read, component = self._instance.fmi["fmi3GetOutputDerivatives"], self._instance.component
        where = address(references), len(references), address(orders), address(buffer), buffer.size

        def call() -> int:
            if (status := int(read(component, *where))) <= WARNING:
                target[flat] = buffer[places]
            return status

        call.__dict__["arrays"] = references, orders
        return call

    def set_derivatives(self, handles: Sequence[Handle], derivatives: RealArray) -> StatusCall:
        """Return a call that does nothing: FMI 3.0 has no input derivatives."""
        return lambda: OK

    def setting(self, setting: Setting) -> StatusCall:
        """Return a call that sets a start value; a structural parameter in configuration mode."""
        value, handle = setting.value, cast(ElementHandle, setting.handle)
        send = self.set([handle], np.array([TEXTS.code(value) if isinstance(value, str) else float(value)]))
        return (lambda: self._instance.configure(send)) if handle.structural else send

    def reading(self, setting: Setting) -> tuple[StatusCall, Callable[[], Value]]:
        """Return a call that reads a start value back, and a function that returns the value read."""
        found = np.zeros(1)
        call = self.get([setting.handle], found)
        if setting.handle.kind == "String":
            return call, lambda: TEXTS.known()[int(found[0])]
        return call, lambda: float(found[0])

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
        return int(self._instance.fmi[f"fmi3Set{group.type}"](self._instance.component, *group.arguments))

    def _array(self, handle: ElementHandle) -> NDArray[Any]:
        """Return the values last set of an array in this instance; at first its start values."""
        if self._seen_instance != self._instance.instances:
            self._seen_instance = self._instance.instances
            self._arrays.clear()
        if handle.reference not in self._arrays:
            # start values; without any in the description, the present values
            group = _Group([replace(handle, place=place) for place in range(handle.size)], [])
            if handle.start is not None:
                self._arrays[handle.reference] = np.array(handle.start, group.buffer.dtype)
            else:
                self._instance.fmi[f"fmi3Get{group.type}"](self._instance.component, *group.arguments)
                self._arrays[handle.reference] = group.read()
        return self._arrays[handle.reference]


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

    def __init__(self, handles: Sequence[ElementHandle], columns: Sequence[int]) -> None:
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
        self.buffer = np.zeros(total, np.float64 if self._texts is not None else DTYPES[self.type])
        where = address(self.buffer) if self._texts is None else addressof(self._texts)
        self.arguments = address(self._references), len(own), where, total
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


def _groups(handles: Sequence[Handle], *, by_event: bool) -> list[tuple[list[ElementHandle], list[int]]]:
    """Return (handles, columns) for each type; with ``by_event`` discrete variables have groups of their own."""
    found: dict[tuple[str, bool], tuple[list[ElementHandle], list[int]]] = {}
    for column, handle in enumerate(cast(Sequence[ElementHandle], handles)):
        members, columns = found.setdefault((handle.type, handle.discrete and by_event), ([], []))
        members.append(handle)
        columns.append(column)
    return list(found.values())
