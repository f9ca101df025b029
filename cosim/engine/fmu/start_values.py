"""Start values of an FMU's variables: set before initialisation, and read back after it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from flexfmu.cosim.engine.fmu.calls import WARNING
from flexfmu.cosim.engine.fmu.file import UnpackedFmu
from flexfmu.cosim.engine.fmu.fmi3_transfers import Fmi3Transfers
from flexfmu.cosim.engine.fmu.fmi3_variables import by_elements
from flexfmu.cosim.engine.fmu.instance import Checked, Instance, StatusCall
from flexfmu.cosim.engine.fmu.transfers import Transfers
from flexfmu.cosim.engine.fmu.variables import Setting, Value, in_words, same, settable_variables, settings


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
