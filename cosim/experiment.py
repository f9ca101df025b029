"""One experiment: a scene's motion through its FMU, from the plan to the recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from flexfmu.cosim.master import Outcome
from flexfmu.cosim.planning import MotionPlan
from flexfmu.cosim.results import Recording
from flexfmu.model.scene import Scene

Progress = Callable[[float], None]
"""Called with the simulated fraction, 0..1."""


@dataclass(frozen=True)
class Timing:
    """Wall times [s] of planning, building (or finding) the FMU, loading it, and simulating."""

    plan: float
    build: float
    load: float
    simulate: float


@dataclass(frozen=True)
class Health:
    """How the FMU fared.

    Attributes:
        statistics: the FMU's Integer variables ``statistics.*`` at the end, without that prefix: steps, rejections,
            evaluations, iterations, factorisations; empty for an FMU without them.
        messages: what the FMU logged, in its own words.
    """

    statistics: Mapping[str, int]
    messages: tuple[str, ...]


@dataclass(frozen=True)
class Run:
    """A simulated scene.

    Attributes:
        plan: the scene and its planned motion.
        recording: every output of the FMU with first and second derivatives, the joint references that drove it
            (``joint1.reference.position`` and so on) and the rigid end-effector motion
            (``end_effector.reference.position.x`` and so on: position, velocity, acceleration), over motion and dwell,
            up to where the run came. The first instant appears twice (standstill, motion), so does every breakpoint.
        outcome: how the run ended; `Outcome.COMPLETED` when all went well.
        message: what happened, in one line.
        fmu_path: the FMU that was simulated.
        communication_step: communication step [s].
        tolerance: relative tolerance passed to the FMU.
        input_order: degree of the input polynomials.
        health: statistics and messages of the FMU.
        timing: wall times.
    """

    plan: MotionPlan
    recording: Recording
    outcome: Outcome
    message: str
    fmu_path: Path
    communication_step: float
    tolerance: float
    input_order: int
    health: Health
    timing: Timing

    @property
    def scene(self) -> Scene:
        """The scene that was simulated."""
        return self.plan.scene

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.outcome is Outcome.COMPLETED


def run_scene(
    scene: Scene,
    *,
    communication_step: float | None = None,
    tolerance: float | None = None,
    input_order: int = 9,
    fmu_path: Path | None = None,
    progress: Progress | None = None,
    parameters: Mapping[str, float] | None = None,
    initial: str | None = None,
) -> Run:
    """Plan the scene's motion, build its FMU or take it from the cache, and co-simulate motion and dwell.

    Args:
        scene: what to simulate.
        communication_step: communication step [s]; the scene's own when None.
        tolerance: relative tolerance for the FMU; the scene's own when None.
        input_order: degree of the input polynomials, 0 (values only) to 9.
        fmu_path: an FMU to use as it is instead of building one, made from a scene with the same effects; its
            parameters are set from this scene.
        progress: called now and then with the simulated fraction, 0..1.
        parameters: FMU parameters that differ from the scene's, for example ``{"payload.mass": 0.1}``.
        initial: ``static`` or ``undeformed``; the scene's own when None.

    Returns:
        The run; when the FMU fails on the way, with all that was recorded until then and the outcome.

    Raises:
        TrajectoryError: the motion is not feasible.
        InputError: the FMU can't be loaded or lacks a variable; a parameter doesn't exist.
        BuildError: the FMU can't be built (no compiler, for example).
    """
    raise NotImplementedError
