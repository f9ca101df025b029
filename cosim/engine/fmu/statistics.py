"""How an FMU fared: its integer variables ``statistics.*``."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexfmu.cosim.engine.fmu.calls import WARNING
from flexfmu.cosim.engine.fmu.fmi3_transfers import Fmi3Transfers
from flexfmu.cosim.engine.fmu.transfers import Transfers
from flexfmu.cosim.engine.fmu.variables import Handle

PREFIX = "statistics."
"""How the names of the variables begin."""


class Statistics:
    """The counters of an FMU.

    Args:
        variables: all variables that can be read; among them the counters.
        transfers: reach the instance.
    """

    def __init__(self, variables: Mapping[str, Handle], transfers: Transfers | Fmi3Transfers) -> None:
        counters = {n: each for n, each in variables.items() if n.startswith(PREFIX) and each.kind == "Integer"}
        self._names = [name.removeprefix(PREFIX) for name in counters]
        self._values = np.zeros(len(counters))
        self._read = transfers.get([*counters.values()], self._values)

    def read(self) -> dict[str, int]:
        """Name without prefix → value; nothing where they can't be read."""
        if not self._names or self._read() > WARNING:
            return {}
        return {name: int(value) for name, value in zip(self._names, self._values.tolist(), strict=True)}
