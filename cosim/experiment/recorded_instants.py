"""The recorded instants of a scene's runs: communication points, or instants between them.

A robot that the references alone drive moves smoothly between breakpoints, so that values between communication points
follow from the derivatives there; with controllers or imperfections every recorded instant is a communication point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from flexfmu.cosim.engine.dense_output import DenseOutput, resampled
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.outcome import Outcome, Simulation
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.motion_steps import INTEGRATION, ChosenSteps
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import SceneSystem
from flexfmu.model.scene.cosimulation import RECORD_STEP

DERIVATIVES = 2
"""Derivatives that values between communication points are calculated from."""

WHOLE = 1e-9
"""Rounding error of the ratio of two steps that users have typed in or calculated."""

Simulate = Callable[[RealArray | None, float], Simulation]
"""Function from communication points, None for the fixed step, and a tolerance to a simulation."""


class RecordedInstants:
    """Chooses communication points where there is no fixed step, and interpolates what is recorded between them.

    Args:
        parts: the slaves.
        motion: the planned motion.
        step: communication step [s]; None if it is chosen.
        wanted: which signals are recorded, how often, with how many derivatives.

    Attributes:
        recorded: what is recorded at the communication points.

    Raises:
        InputError: the step is open, but other slaves than the references drive the robot.
    """

    def __init__(self, parts: SceneSystem, motion: MotionPlan, step: float | None, wanted: Selection) -> None:
        self._motion, self._wanted = motion, wanted
        self._chooses = step is None
        smooth = (
            not parts.others
            and motion.scene.cosimulation.drive == "motion"
            and parts.plant.max_output_order >= DERIVATIVES
            and parts.references.ends_exactly
        )
        if self._chooses and not smooth:
            raise InputError(
                "communication steps are chosen where the planned motion alone drives the robot and its FMU takes and gives all "
                "derivatives; else name one: `cosimulation.step` (--step), 1e-3 s for example"
            )
        # between the points only where the interval isn't a whole number of steps
        ratio = 0.0 if step is None or wanted.step is None else wanted.step / step
        whole = ratio > 0.5 and abs(ratio - round(ratio)) <= WHOLE * ratio
        self._is_between = self._chooses or (smooth and wanted.step is not None and not whole)
        self.recorded = replace(wanted, order=DERIVATIVES, step=None) if self._is_between else wanted
        self._steps: ChosenSteps | None = None
        self._dense: tuple[RealArray, DenseOutput] | None = None

    @property
    def is_open(self) -> bool:
        """Whether communication points have to be chosen first."""
        return self._chooses and self._steps is None

    def follow(self, motion: MotionPlan) -> None:
        """Record runs of another motion from now on."""
        self._motion, self._steps = motion, None

    def forget(self) -> None:
        """Choose the communication points anew."""
        self._steps = None

    def choose(self, simulate: Simulate, stop: float, tolerance: float) -> None:
        """Choose the communication points by runs up to ``stop`` [s]."""
        steps = ChosenSteps(self._motion.joints, stop, tolerance)
        while (found := simulate(steps.points, INTEGRATION * tolerance)).outcome is Outcome.COMPLETED:
            if not steps.improve(found.recording):
                break
        self._steps = steps

    def run(self, simulate: Simulate, tolerance: float, *, own: bool) -> Simulation:
        """Simulate and interpolate.

        Args:
            simulate: simulates.
            tolerance: of the FMU.
            own: whether the run has the parameters for which the points were chosen.
        """
        if self._steps is None:
            found = simulate(None, tolerance)
        else:
            found = simulate(self._steps.points, INTEGRATION * tolerance)
            steps = None if own else self._steps.copy()
            while steps is not None and found.outcome is Outcome.COMPLETED and steps.improve(found.recording):
                found = simulate(steps.points, INTEGRATION * tolerance)
        return replace(found, recording=self._interpolated(found.recording)) if self._is_between else found

    def _interpolated(self, recording: Recording) -> Recording:
        """The recording at the wanted instants."""
        points = recording.time
        if points.size < 2:
            return recording
        if self._dense is None or not np.array_equal(self._dense[0], points):
            step = self._wanted.step or RECORD_STEP
            instants = points[0] + step * np.arange(int((points[-1] - points[0]) / step) + 1)
            self._dense = points, DenseOutput(points, instants, self._wanted.order + DERIVATIVES)
        return resampled(recording, self._dense[1], self._wanted.order)
