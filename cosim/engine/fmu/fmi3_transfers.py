"""Transfers between variables of an FMI 3.0 FMU and numpy buffers, as calls with all arguments bound.

FMI 3.0 transfers whole arrays: of an array that is set in part, the other elements keep what they were given last.
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
    """Calls that move values between variables of an instance and buffers, as those of `Transfers`.

    Buffers of doubles hold all types of variables; integers beyond 2^53 are rounded.

    Args:
        instance: whose variables they are.
    """

    def __init__(self, instance: Fmi3Instance) -> None:
        self._instance = instance
        self._arrays: dict[int, NDArray[Any]] = {}
        self._seen_instance = 0

    def get(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """A call that fills ``values`` (n,)."""
        # one FMI call for each type
        groups = [_Group(each, columns) for each, columns in _groups(handles, by_event=False)]
        fmi, component = self._instance.fmi, self._instance.component
        reads = [(fmi[f"fmi3Get{group.type}"], group) for group in groups]

        # the worst status counts; values are taken where the call gave some
        def call() -> int:
            worst = OK
            for read, group in reads:
                worst = max(worst, read(component, *group.arguments))
                if worst <= WARNING:
                    values[group.columns] = group.read()
            return worst

        return call

    def set(self, handles: Sequence[Handle], values: RealArray) -> StatusCall:
        """A call that sets the variables from ``values`` (n,); discrete ones at an event, and only if they change."""
        groups = [_Group(each, columns) for each, columns in _groups(handles, by_event=True)]
        continuous, discrete = ([each for each in groups if each.discrete is kind] for kind in (False, True))
        instance = self._instance

        def call() -> int:
            worst = max((self._send(group, values) for group in continuous), default=OK)
            if not discrete or worst > WARNING:
                return worst
            # an event, if any discrete input is another than before
            changed = [each for each in discrete if each.changes(values, instance.epoch) or not instance.at_events]
            if changed:
                worst = max(worst, instance.at_event(lambda: max(self._send(each, values) for each in changed)))
            return worst

        return call

    def get_derivatives(
        self, handles: Sequence[Handle], derivatives: RealArray, absent: NDArray[np.bool_] | None = None
    ) -> StatusCall:
        """A call that fills ``derivatives`` (orders, n), row k - 1 for order k; what isn't a float, or is ``absent``
        (orders, n), is left as it is."""
        # elements that are wanted, in rows of orders
        wanted = [
            (row, column, cast(ElementHandle, handle))
            for row in range(len(derivatives))
            for column, handle in enumerate(handles)
            if handle.kind == "Real" and (absent is None or not absent[row, column])
        ]
        if not wanted:
            return lambda: OK
        # each array once per order, one after the other in a buffer of their own
        sizes = {(row, handle.reference): handle.size for row, _, handle in wanted}
        begins = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
        places = [begins[row, handle.reference] + handle.place for row, _, handle in wanted]
        flat = [row * len(handles) + column for row, column, _ in wanted]
        # arguments of the function, and where the wanted elements go
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
        """FMI 3.0 has no derivatives of inputs."""
        return lambda: OK

    def setting(self, setting: Setting) -> StatusCall:
        """A call that gives a variable its start value."""
        value, handle = setting.value, cast(ElementHandle, setting.handle)
        send = self.set([handle], np.array([TEXTS.code(value) if isinstance(value, str) else float(value)]))
        return (lambda: self._instance.configure(send)) if handle.structural else send

    def reading(self, setting: Setting) -> tuple[StatusCall, Callable[[], Value]]:
        """A call that reads back what was set, and what it has read."""
        found = np.zeros(1)
        call = self.get([setting.handle], found)
        if setting.handle.kind == "String":
            return call, lambda: TEXTS.known()[int(found[0])]
        return call, lambda: float(found[0])

    def _send(self, group: _Group, values: RealArray) -> int:
        """Set the variables of a group."""
        # the other elements of an array keep their values
        for handle, place in group.arrays:
            group.buffer[place] = self._array(handle)
        if (misfit := group.fill(values)) is not None:
            name, value = misfit
            raise SlaveError(self._instance.name, f"{name} is of type {group.type} and can't be {value:.12g}")
        for handle, place in group.arrays:
            self._array(handle)[:] = group.buffer[place]
        return int(self._instance.fmi[f"fmi3Set{group.type}"](self._instance.component, *group.arguments))

    def _array(self, handle: ElementHandle) -> NDArray[Any]:
        """All that an array was given last in this life of the instance; its start values at first."""
        if self._seen_instance != self._instance.instances:
            self._seen_instance = self._instance.instances
            self._arrays.clear()
        if handle.reference not in self._arrays:
            # start values, or what it is where the description doesn't say
            group = _Group([replace(handle, place=place) for place in range(handle.size)], [])
            if handle.start is not None:
                self._arrays[handle.reference] = np.array(handle.start, group.buffer.dtype)
            else:
                self._instance.fmi[f"fmi3Get{group.type}"](self._instance.component, *group.arguments)
                self._arrays[handle.reference] = group.read()
        return self._arrays[handle.reference]


class _Group:
    """Variables of one type, whole arrays, in a buffer as the FMI functions take them.

    Attributes:
        type: of the variables.
        discrete: whether they change at events alone.
        columns: where elements that are wanted are in the buffer of doubles.
        buffer: all values.
        arguments: references and buffer.
        arrays: (any element, place in the buffer) for each array.
    """

    def __init__(self, handles: Sequence[ElementHandle], columns: Sequence[int]) -> None:
        first = handles[0]
        self.type, self.discrete, self.columns = first.type, first.discrete, np.array(columns, np.intp)
        self._names = [each.name for each in handles]
        # a place in the buffer for each array as a whole
        own = {each.reference: each for each in handles}
        begins = dict(zip(own, np.cumsum([0, *(each.size for each in own.values())]).tolist(), strict=False))
        self._places = np.array([begins[each.reference] + each.place for each in handles], np.intp)
        total = sum(each.size for each in own.values())
        self.arrays = [(each, slice(begins[n], begins[n] + each.size)) for n, each in own.items() if each.size > 1]
        # buffers as the functions take them: texts as pointers, and as codes here
        self._references = value_references(list(own))
        self._texts = (c_char_p * total)() if self.type == "String" else None
        self.buffer = np.zeros(total, np.float64 if self._texts is not None else DTYPES[self.type])
        where = address(self.buffer) if self._texts is None else addressof(self._texts)
        self.arguments = address(self._references), len(own), where, total
        self._sent = np.full(len(columns), np.nan)
        self._epoch = -1

    def read(self) -> NDArray[Any]:
        """The elements that are wanted, from the buffer."""
        if self._texts is not None:
            for place in self._places.tolist():
                self.buffer[place] = TEXTS.code((self._texts[place] or b"").decode("utf-8", "replace"))
        return self.buffer[self._places]

    def fill(self, values: RealArray) -> tuple[str, float] | None:
        """Put values into the buffer; name and value of one that doesn't suit the type, if there is any."""
        new = values[self.columns]
        # whole numbers are rounded, and must fit their type
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
        """Whether the variables are others than those that were set last."""
        new = values[self.columns]
        if self._epoch == epoch and np.array_equal(new, self._sent):
            return False
        self._epoch, self._sent = epoch, new
        return True


def _groups(handles: Sequence[Handle], *, by_event: bool) -> list[tuple[list[ElementHandle], list[int]]]:
    """Handles and columns of the variables of each type; discrete ones apart if they are set at events."""
    found: dict[tuple[str, bool], tuple[list[ElementHandle], list[int]]] = {}
    for column, handle in enumerate(cast(Sequence[ElementHandle], handles)):
        members, columns = found.setdefault((handle.type, handle.discrete and by_event), ([], []))
        members.append(handle)
        columns.append(column)
    return list(found.values())
