"""What is measured: a scene with its motion, its sample instants, and the reference that errors are counted from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.errors import CosimError
from flexfmu.cosim.experiment import PreparedScene, Run
from flexfmu.cosim.planning import MotionPlan
from flexfmu.model.scene import Scene

Array = NDArray[np.float64]

SAMPLING = 1e-3
"""Distance of the instants at which positions are compared [s]."""

REFERENCE_TOLERANCE = 1e-12
REFERENCE_STEP = 2.5e-4


@dataclass(frozen=True, eq=False)
class Subject:
    """A scene under test.

    Attributes:
        scene: as the user gave it.
        motion: its planned motion.
    """

    scene: Scene
    motion: MotionPlan

    @property
    def stop(self) -> float:
        """End of motion and dwell [s]."""
        return self.motion.stop_time

    @cached_property
    def instants(self) -> Array:
        """(N,) whole multiples of `SAMPLING` up to the end [s], at which positions are compared."""
        count = int(self.stop / SAMPLING * (1.0 + 1e-12))
        return np.asarray(SAMPLING * np.arange(1, count + 1), dtype=np.float64)

    @cached_property
    def reference(self) -> Array:
        """(N, 2) positions of the end effector [m] by the FMU at `REFERENCE_TOLERANCE`."""
        prepared = PreparedScene(self.scene, communication_step=REFERENCE_STEP, tolerance=REFERENCE_TOLERANCE)
        return self.positions(completed(prepared.run()))

    @cached_property
    def scale(self) -> float:
        """What elasticity does [m]: largest distance of the end effector from the rigid robot's."""
        rigid = self.motion.task.evaluate(self.instants, 0)[0]
        return float(np.linalg.norm(self.reference - rigid, axis=1).max())

    def positions(self, run: Run) -> Array:
        """(N, 2) positions of the end effector [m] of a run at the instants that it communicates at, NaN elsewhere."""
        time = run.recording.time
        index = np.searchsorted(time, self.instants * (1.0 - 1e-12) - 1e-15).clip(0, time.size - 1)
        position = np.stack([run.recording[f"end_effector.position.{axis}"].values for axis in "xy"], axis=1)
        found: Array = position[index]
        found[np.abs(time[index] - self.instants) > 1e-9] = np.nan
        return found

    def error(self, positions: Array) -> float:
        """Largest distance from the reference, relative to `scale`; instants without a value don't count."""
        distance = np.linalg.norm(positions - self.reference, axis=1)
        return float(np.nanmax(distance)) / self.scale


def subject_of(scene: Scene) -> Subject:
    """A scene with its planned motion, shapers included."""
    from flexfmu.cosim.loop.sections import loop_of

    return Subject(scene, loop_of(scene).motion)


def completed(run: Run) -> Run:
    """The run, if it came to its end.

    Raises:
        RunError: it didn't; the message is the run's.
    """
    if not run.completed:
        raise RunError(run.message)
    return run


class RunError(CosimError):
    """A run under test ended before its time."""
