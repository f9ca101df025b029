"""What the master holds for each slave during a run: buffers for its outputs and inputs, and bound transfers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.errors import NotFiniteError
from flexfmu.cosim.master.binding import bind_get, bind_set, nothing
from flexfmu.cosim.master.selection import EVERYTHING, Selection
from flexfmu.cosim.slave import Indices, KnowsItsFuture, RealArray, Slave, output_order

if TYPE_CHECKING:
    from flexfmu.cosim.master.links import Link


class OutputPort:
    """Outputs of a slave at the current instant: those that feed others or are recorded.

    Args:
        slave: the slave.
        coupling_order: highest derivative that another slave is fed with.
        fed: indices of the outputs that feed others.
        selection: what is recorded.

    Attributes:
        slave: the slave.
        indices: (n,) the outputs.
        signals: (orders + 1, n) values in row 0, derivatives below.
        recorded: how many rows of ``signals`` go into the recording.
        transfer, read_announced: calls that fill ``signals`` with what has been reached, and with what is announced.
    """

    def __init__(
        self,
        slave: Slave,
        coupling_order: int,
        fed: Collection[int] = (),
        selection: Selection = EVERYTHING,
    ) -> None:
        outputs = [(i, each.name) for i, each in enumerate(slave.variables) if each.causality == "output"]
        wanted = [i for i, name in outputs if i in fed or selection.keeps(f"{slave.name}.{name}")]
        self.slave = slave
        self.indices: Indices = np.array(wanted, np.intp)
        self.recorded = 1 + min(output_order(slave), selection.order)
        self.signals = np.zeros((max(self.recorded, 1 + coupling_order), self.indices.size))
        self._finite = np.ones(self.signals.shape, dtype=np.bool_)
        self.transfer = self.read_announced = nothing
        if self.indices.size:
            # a slave that knows its future gives more derivatives at the beginning of a step than at its end
            rows = self.recorded if isinstance(slave, KnowsItsFuture) else self.signals.shape[0]
            self.transfer = bind_get(slave, self.indices, self.signals[:rows])
            self.read_announced = bind_get(slave, self.indices, self.signals)

    def reset(self) -> None:
        """Forget the signals of a run before."""
        self.signals.fill(0.0)

    @property
    def reads_all(self) -> bool:
        """Whether the slave has outputs alone."""
        return self.indices.size == len(self.slave.variables)

    def read(self, time: float) -> None:
        """Read what the slave has reached at ``time``.

        Raises:
            NotFiniteError: an output or one of its derivatives is infinite or not a number.
        """
        self.transfer()
        np.isfinite(self.signals, self._finite)
        if not self._finite.all():
            raise self.not_finite(time)

    def not_finite(self, time: float) -> NotFiniteError:
        """The error that names the first offending output."""
        order, column = np.argwhere(~np.isfinite(self.signals))[0]
        name = self.slave.variables[self.indices[column]].name
        what = f"der({name},{order})" if order else name
        return NotFiniteError(self.slave.name, f"{what} became {self.signals[order, column]}", time)


class InputPort:
    """The connected inputs of a slave.

    Attributes:
        slave: the slave.
        links: where the inputs come from.
        fed: (orders + 1, n) values in row 0, derivatives below.
        send: a call that hands ``fed`` to the slave.
    """

    def __init__(self, slave: Slave, indices: Indices, links: Sequence[Link]) -> None:
        self.slave = slave
        self.links = tuple(links)
        self.fed = np.zeros((1 + max((link.degree for link in links), default=0), indices.size))
        self.interpolating = tuple(link for link in links if link.interpolates)
        self._begins: list[RealArray] = []
        self._indices = indices
        self.send = bind_set(slave, indices, self.fed) if links else nothing

    def reset(self) -> None:
        """Forget the signals of a run before."""
        self.fed.fill(0.0)

    def preset(self, ready: Collection[OutputPort]) -> None:
        """Set values before the slave is initialised, those whose sources are ready; the others keep their starts."""
        for link in self.links:
            if link.source in ready:
                link.extrapolate(self.fed)
                self.slave.set(self._indices[link.slots], self.fed[0, link.slots])

    def exchange(self) -> None:
        """Set the inputs from the outputs at the current instant."""
        for link in self.links:
            link.extrapolate(self.fed)
        self.send()

    def remember(self) -> None:
        """Keep the interpolated signals at the beginning of a step."""
        self._begins = [link.ended() for link in self.interpolating]

    def interpolate(self, step: float) -> None:
        """Set the inputs whose sources have already been advanced over the step."""
        for link, begin in zip(self.interpolating, self._begins, strict=True):
            link.interpolate(begin, step, self.fed)
        self.send()
