"""A run on its way, from point to point of its grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from flexfmu.cosim.controlled_steps import ControlledSteps
from flexfmu.cosim.coupling_error import CouplingError
from flexfmu.cosim.grid import TimeGrid
from flexfmu.cosim.recorder import Recorder
from flexfmu.cosim.schedule import Schedule
from flexfmu.cosim.step_control import StepDoubling

Progress = Callable[[float], None]
"""Called now and then with the simulated fraction, 0..1."""

PROGRESS_CALLS = 100
"""How often progress is told in a run."""


@dataclass(frozen=True)
class Reached:
    """How far a run came.

    Attributes:
        time: end of the last completed step [s].
        steps: completed communication steps.
        rejected: steps that were taken back.
        largest_step: [s].
    """

    time: float
    steps: int
    rejected: int
    largest_step: float


class Run:
    """Goes from point to point of a grid and records them.

    Attributes:
        recorder: what has been recorded.
        initialized: whether all slaves have been initialised.
    """

    def __init__(self, schedule: Schedule, grid: TimeGrid, progress: Progress | None) -> None:
        self.recorder = Recorder(schedule.outputs, grid.times.size + int(grid.marked.sum()))
        self.initialized = False
        self._schedule = schedule
        self._cross = schedule.advance
        self._controlled: ControlledSteps | None = None
        self._times: list[float] = grid.times.tolist()
        self._marked: list[bool] = grid.marked.tolist()
        self._largest = float(np.diff(grid.times).max())
        self._passed = 0
        self._progress = progress

    def control_steps(self, control: StepDoubling, error: CouplingError, first: float) -> None:
        """Take as many steps between the grid's points as a tolerance needs, the first one of length ``first`` [s]."""
        self._controlled = ControlledSteps(self._schedule, self.recorder, control, error, first)
        self._cross = self._controlled.cross

    def go(self, tolerance: float | None) -> None:
        """Initialise, then go from point to point."""
        self._schedule.initialize(tolerance)
        self.initialized = True
        self._exchange_and_record(0)
        count = len(self._times) - 1
        every = max(1, count // PROGRESS_CALLS)
        for n in range(count):
            self._cross(self._times[n], self._times[n + 1])
            self._passed += 1
            self._exchange_and_record(n + 1)
            if self._progress is not None and (self._passed % every == 0 or self._passed == count):
                self._progress((self._times[n + 1] - self._times[0]) / (self._times[-1] - self._times[0]))

    @property
    def reached(self) -> Reached:
        """How far the run came."""
        time, steps = self._times[self._passed], self._passed
        if self._controlled is None:
            return Reached(time, steps, 0, self._largest)
        taken = self._controlled
        return Reached(max(time, taken.time), taken.accepted, taken.rejected, taken.largest or self._largest)

    def _exchange_and_record(self, point: int) -> None:
        """Record the instant: once where signals are continuous, on both sides where they may jump."""
        time, jump = self._times[point], self._marked[point]
        if jump:
            self.recorder.append(time)
        self._schedule.exchange(point, time, jump or point == 0)
        self.recorder.append(time)
