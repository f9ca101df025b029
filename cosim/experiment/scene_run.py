"""A simulated scene: its recording, outcome, settings and timing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from flexfmu.cosim.engine.master.delays import SignalDelay
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulation_loop import Progress
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.recording import SlaveFacts
from flexfmu.model.scene.schema import Scene


@dataclass(frozen=True)
class Timing:
    """Wall times [s] of planning, building (or finding) the FMU, loading it, and simulating."""

    plan: float
    build: float
    load: float
    simulate: float


@dataclass(frozen=True)
class Health:
    """Statistics and messages of the FMU.

    Attributes:
        statistics: the FMU's Integer variables ``statistics.*`` at the end, without that prefix: steps, rejections,
            evaluations, iterations, factorisations; empty for an FMU without them.
        messages: what the FMU logged.
    """

    statistics: Mapping[str, int]
    messages: tuple[str, ...]


@dataclass(frozen=True)
class Companion:
    """The same run once more, more precisely: the difference is the error of the first one.

    Attributes:
        communication_step: [s], at most half of the run's, and of every sample time.
        tolerance: for the FMU.
        run: simulates it and reports the simulated fraction to a function, or to None.
    """

    communication_step: float
    tolerance: float
    run: Callable[[Progress | None], Run]


@dataclass(frozen=True)
class Run:
    """A simulated scene.

    Attributes:
        plan: the scene and its planned motion.
        recording: every output of the FMU with first and second derivatives, what acted on it (torques, or joint
            references ``joint1.reference.position`` and so on) and the rigid end-effector motion
            (``end_effector.reference.position.x`` and so on: position, velocity, acceleration), over motion and dwell,
            up to where the run came; what other slaves output as ``slave.variable``. The first instant appears twice
            (standstill, motion), so does every breakpoint and every sample instant.
        outcome: how the run ended; `Outcome.COMPLETED` when all went well.
        message: what happened, in one line.
        fmu_path: the FMU that was simulated.
        communication_step: communication step [s].
        tolerance: relative tolerance passed to the FMU.
        input_order: degree of the input polynomials.
        health: statistics and messages of the FMU.
        timing: wall times.
        slaves: all slaves of the system.
        delays: for each connection how late its signals arrive.
        parameters: parameters of the robot that differ from the scene's.
        companion: a more precise run of the same, to be run when its errors are asked for; None where there is none.
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
    slaves: tuple[SlaveFacts, ...] = ()
    delays: tuple[SignalDelay, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    companion: Companion | None = field(default=None, repr=False, compare=False)

    @property
    def scene(self) -> Scene:
        """The scene that was simulated."""
        return self.plan.scene

    @property
    def robot(self) -> Scene:
        """The scene with the parameters that the robot had."""
        return scene_with_parameters(self.scene, self.parameters)

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.outcome is Outcome.COMPLETED
