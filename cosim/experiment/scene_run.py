"""A simulated scene: its recording, outcome, settings and timing."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from flexfmu.cosim.engine.errors import CosimError, ResultsError
from flexfmu.cosim.engine.files import write_whole
from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.fmu.variables import parameter_names
from flexfmu.cosim.engine.master.outcome import Outcome, SignalDelay
from flexfmu.cosim.engine.master.simulator import Progress
from flexfmu.cosim.engine.results import Names, Recording
from flexfmu.cosim.engine.showing import shorten
from flexfmu.cosim.experiment.metric import Metric, RunMetrics
from flexfmu.cosim.experiment.parameters import parameters_for, scene_parameters, scene_with_parameters
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.recording import SlaveFacts
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray

if TYPE_CHECKING:
    import os

    import pandas
    import xarray
    from matplotlib.figure import Figure

    from flexfmu.cosim.experiment.accuracy import AccuracyAnswer

END_EFFECTOR = ("end_effector.position.x", "end_effector.position.y")


NO_ORDER = 4.0
"""Error of a companion in terms of the change to it, where no order is known."""


@dataclass(frozen=True)
class Timing:
    """Wall times [s] of planning, building the FMU (or finding it in the cache), loading it, and simulating."""

    plan: float
    build: float
    load: float
    simulate: float


@dataclass(frozen=True)
class Health:
    """How a run went.

    Attributes:
        statistics: the FMU's Integer variables ``statistics.*`` at the end, without that prefix: steps, rejections,
            evaluations, iterations, factorisations; empty for an FMU without them.
        messages: what there is to say of the control loop, such as its instability, and log messages of the FMU.
        unstable_loop: which signal runs away, how fast, and remedies; None for a stable loop, and for none.
    """

    statistics: Mapping[str, int]
    messages: tuple[str, ...]
    unstable_loop: str | None = None


@dataclass(frozen=True)
class Companion:
    """A more accurate repetition of a run, to estimate the run's error.

    Attributes:
        communication_step: [s], at most half of the run's and of every sample time.
        tolerance: relative tolerance for the FMU.
        run: function that simulates it; takes a progress function or None.
        share: its largest error, in terms of the change of a metric from the run to it.
    """

    communication_step: float
    tolerance: float
    run: Callable[[Progress | None], Run] = field(repr=False)
    share: float = NO_ORDER


@dataclass(frozen=True, repr=False)
class Run:
    """A simulated scene.

        run.metrics.peak_torque_1  # a number with a unit and an error
        run.to_pandas("joint*.torque")  # a data frame; all signals without an argument
        run.write("run.mat")  # also .csv, .parquet, .mcap

    Attributes:
        plan: the scene and its planned motion.
        recording: outputs of the FMU with first and second derivatives, its inputs (torques, or joint references such as
            ``joint1.reference.position``), the rigid end-effector motion (position, velocity and acceleration, such as
            ``end_effector.reference.position.x``), and outputs of other slaves as ``slave.variable``; over motion and
            dwell, or up to a failure. The first instant (standstill, motion), every breakpoint and every sample instant
            appear twice.
        outcome: how the run ended; `Outcome.COMPLETED` if it reached its stop time.
        message: the outcome in one line.
        fmu_path: the FMU that was simulated.
        communication_step: communication step [s].
        tolerance: relative tolerance passed to the FMU.
        input_order: degree of the input polynomials.
        health: statistics of the FMU, and messages.
        timing: wall times.
        slaves: all slaves of the system.
        delays: delay of the signals of each connection.
        parameters: parameters of the robot that differ from the scene's.
        companion: more accurate repetition, run only to estimate errors; None if there is none.
        rests: rest positions after the motion, shared by runs of the same motion; None if there are none to share.
        measure: function from a run, a number of companions and names to its metrics, `flexfmu.measure_run`; None for a run
            that is only recorded.
        accuracy: how the settings were chosen for the accuracy that was asked for; None where none was.
        page: function from a run to its page that simulates, `flexfmu.cosim.exchange.live.live_page`; None for a run without one.
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
    rests: RestPositions | None = field(default=None, repr=False, compare=False)
    measure: Callable[[Run, int, Collection[str] | None], Mapping[str, Metric]] | None = field(
        default=None, repr=False, compare=False
    )
    accuracy: AccuracyAnswer | None = field(default=None, repr=False, compare=False)
    page: Callable[[Run], str] | None = field(default=None, repr=False, compare=False)

    @property
    def scene(self) -> Scene:
        """The scene that was simulated."""
        return self.plan.scene

    @property
    def robot(self) -> Scene:
        """The scene with the parameters of the robot in this run."""
        return scene_with_parameters(self.scene, self.parameters)

    @property
    def completed(self) -> bool:
        """Whether the run reached its stop time."""
        return self.outcome is Outcome.COMPLETED

    @cached_property
    def metrics(self) -> RunMetrics:
        """The metrics as numbers with units and errors: ``run.metrics.peak_torque_1`` is a `flexfmu.Metric`.

        Raises:
            ResultsError: nothing measures this run.
        """
        if self.measure is None:
            raise ResultsError("this run has no metrics of its own: take flexfmu.measure_run(run)")
        return RunMetrics(self.scene.name, partial(self.measure, self))

    def to_pandas(self, names: Names = None) -> pandas.DataFrame:
        """Return recorded signals as a data frame; see `flexfmu.cosim.engine.results.Recording.to_pandas`."""
        return self.recording.to_pandas(names)

    def to_xarray(self, names: Names = None) -> xarray.Dataset:
        """Return recorded signals as a data set; see `flexfmu.cosim.engine.results.Recording.to_xarray`."""
        return self.recording.to_xarray(names)

    def plot(self, names: Names = None) -> Figure:
        """Return a figure of recorded signals; see `flexfmu.cosim.engine.results.Recording.plot`."""
        return self.recording.plot(names, self.scene.name)

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the recorded signals as .csv, .parquet, .mat or .mcap; see `flexfmu.cosim.engine.results.Recording.write`."""
        return self.recording.write(path, self.about)

    def live_report(self, path: str | os.PathLike[str]) -> Path:
        """Write the report with the system inside: its sliders change payload, stiffness, gains and more, and the page simulates.

        Raises:
            ResultsError: the run has no page, or the file can't be written.
            MissingCompilerError: there is no ziglang, which compiles the run for the page.
        """
        write_whole(target := Path(path), self.live().html)
        return target

    def live(self) -> LivePage:
        """The same report for a notebook, which shows it.

        Raises:
            ResultsError, MissingCompilerError: as for `live_report`.
        """
        if self.page is None:
            raise ResultsError("this run has no page of its own: take flexfmu.cosim.exchange.live.live_page(run)")
        return LivePage(self.page(self))

    @property
    def about(self) -> Mapping[str, str]:
        """Scene and outcome, for the metadata of files."""
        return {"scene": self.scene.name, "outcome": " ".join(self.message.split())}

    def __repr__(self) -> str:
        """Return five lines: how it went, what was simulated and recorded, and where the rest is."""
        time = self.recording.time
        changes = "".join(f", {name} = {value:g}" for name, value in self.parameters.items())
        return "\n".join(
            [
                f"Run of {self.scene.name}{changes}: {shorten(self.message, 79)}",
                f"  {time[-1] if time.size else 0.0:g} s in steps of {self.communication_step:g} s, tolerance "
                f"{self.tolerance:g}, simulated in {self.timing.simulate:.3g} s",
                f"  slaves: {shorten(', '.join(slave.name for slave in self.slaves) or 'unknown', 69)}",
                f"  {len(self.recording.columns)} signals at {time.size} instants: .recording, .to_pandas(), .plot(), .write()",
                "  metrics: .metrics.peak_torque_1, ..."
                + ("" if self.accuracy is None else "; chosen settings: .accuracy"),
            ]
        )

    def _repr_html_(self) -> str:
        from html import escape

        head, *lines = repr(self).splitlines()[:3]
        facts = "<br>".join(escape(line.strip()) for line in lines)
        parts = [each._repr_html_() for each in (self.accuracy, self.metrics, self.recording) if each is not None]
        return f"<p><b>{escape(head)}</b><br>{facts}</p>{''.join(parts)}"


PAGE_HEIGHT = 720
"""Height of a page within a notebook [px]."""


@dataclass(frozen=True)
class LivePage:
    """A page that simulates; notebooks show it in a frame.

    Attributes:
        html: the page.
    """

    html: str = field(repr=False)

    def _repr_html_(self) -> str:
        from html import escape

        style = f"width: 100%; height: {PAGE_HEIGHT}px; border: 0"
        return (
            f'<iframe title="simulation" sandbox="allow-scripts" allow="clipboard-write" style="{style}" '
            f'srcdoc="{escape(self.html)}"></iframe>'
        )


class RestPositions:
    """End-effector positions at rest after a planned motion: static equilibria at the end pose, motors locked.

    The FMU calculates them by initialising at the end pose, a hundred times faster than the equations in CasADi, which are
    used if the FMU can't. It is loaded at the first call and kept for others.

    Args:
        plan: the scene and its planned motion.
        fmu_path: FMU of the robot.
    """

    def __init__(self, plan: MotionPlan, fmu_path: Path) -> None:
        self._plan, self._path = plan, fmu_path
        self._kept: list[FmuSlave] = []

    def after(self, plan: MotionPlan) -> RestPositions:
        """Rest positions after another motion of the same robot from the same start, by the same FMU."""
        other = copy(self)
        other._plan = plan
        return other

    def at(self, parameters: Mapping[str, float]) -> RealArray:
        """Position (2,) [m] with these parameters of the robot that differ from the scene's.

        Raises:
            EquilibriumError: the end pose has no static equilibrium.
        """
        scene, (joints, position) = self._plan.scene, self._plan.end_pose
        robot = partial(scene_with_parameters, scene, parameters)
        pose = self._joint_pose
        if scene.cosimulation.drive != "motion":
            # a robot driven by torques gets its pose from the end effector, so its links must have the planned lengths
            if robot().mechanism != scene.mechanism:
                return _rest_by_equations(robot(), joints)
            pose = {f"start.{axis}": float(value) for axis, value in zip("xy", position, strict=True)}
        try:
            with self._at_rest(parameters, pose) as slave:
                names, found = [variable.name for variable in slave.variables], np.empty(2)
                slave.get(np.array([names.index(name) for name in END_EFFECTOR]), found)
            return found
        except CosimError:
            return _rest_by_equations(robot(), joints)

    def frequencies(self, parameters: Mapping[str, float]) -> RealArray:
        """Undamped natural frequencies [Hz] about the rest position, ascending, motors locked; arguments as for `at`.

        The FMU linearises its own equations, which takes a millisecond: with q'' = -K q for small elastic coordinates q, they are
        the roots of the eigenvalues of K. Empty where it can't, or torques drive the robot: its motors aren't locked.
        """
        if self._plan.scene.cosimulation.drive != "motion":
            return np.empty(0)
        try:
            with self._at_rest(parameters, self._joint_pose) as slave:
                names = [variable.name for variable in slave.variables]
                states = [name for name in names if f"der({name},2)" in names]
                places = (
                    np.array([names.index(text.format(name)) for name in states], dtype=np.intp)
                    for text in ("der({},2)", "{}")
                )
                squares = np.linalg.eigvals(-slave.directional_derivatives(*places))
        except CosimError:
            return np.empty(0)
        return np.asarray(np.sort(np.sqrt(squares.real[squares.real > 0.0]) / (2.0 * np.pi)))

    @property
    def _joint_pose(self) -> Mapping[str, float]:
        """Inputs of a motion-driven robot at the end of the motion."""
        return {f"joint{i}.reference.position": float(q) for i, q in enumerate(self._plan.end_pose[0], start=1)}

    @contextmanager
    def _at_rest(self, parameters: Mapping[str, float], pose: Mapping[str, float]) -> Iterator[FmuSlave]:
        """The FMU, initialised: that finds the equilibrium, without a step; parameters that scenes don't have are ignored.

        Raises:
            CosimError: the FMU can't be loaded, or finds no equilibrium.
        """
        scene = self._plan.scene
        if not self._kept:
            values = parameters_for(scene, parameter_names(open_fmu(self._path).description))
            self._kept.append(FmuSlave(self._path, "plant", {**values, INITIAL.name: "static"}, output_order=0))
        slave, known = self._kept[0], scene_parameters(scene)
        slave.vary({**{name: value for name, value in parameters.items() if name in known}, **pose})
        slave.initialize(0.0, 1.0, None)
        try:
            yield slave
        finally:
            slave.terminate()


def rest_position(run: Run) -> RealArray:
    """End-effector position at rest after a run's motion, (2,) [m]; see `RestPositions`.

    Raises:
        EquilibriumError: the end pose has no static equilibrium.
    """
    return (run.rests or RestPositions(run.plan, run.fmu_path)).at(run.parameters)


def _rest_by_equations(robot: Scene, joints: RealArray) -> RealArray:
    from flexfmu.model.statics import static_equilibrium

    return np.asarray(static_equilibrium(robot, joints).position, dtype=float)
