"""Which motion determines parameters best: standard errors to be expected of motions of a scene's families, within its limits.

The inverse of the information that a log of the motion has about the parameters, delays and offsets of sensors estimated along, is their
covariance to be expected (A. Atkinson, A. Donev, R. Tobias, *Optimum Experimental Designs, with SAS*, 2007, chapters 9 and 10). D-optimal is
the motion with the smallest determinant of the parameters' relative covariance, A-optimal that with its smallest trace.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from flexfmu.cosim.design.identification.estimate import FreeParameter, Problem, information
from flexfmu.cosim.design.identification.measurements import Channel, Experiment, SceneSimulation, comparable, parts_of
from flexfmu.cosim.engine.errors import InputError, suggestion
from flexfmu.cosim.engine.showing import Rows, ShowProgress, few_lines
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.reports.chart import FIRST, INK, SECOND, Curve, Panel
from flexfmu.cosim.reports.page import Plot, Table
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Criterion = Literal["D", "A"]

PROFILES: tuple[dict[str, Any], ...] = (
    {"kind": "poly7"},
    {"kind": "poly5"},
    {"kind": "trapezoidal", "ramp": 0.125},
    {"kind": "trapezoidal", "ramp": 0.25},
    {"kind": "bang-bang"},
)
DURATIONS, WIDTHS = (0.7, 0.85, 1.0, 1.25, 1.6, 2.0), (1.0, 0.75, 0.5)
"""Motions that are tried: profiles, durations and widths of the path, the latter two relative to the scene's."""

TORQUES = ("joint1.torque", "joint2.torque")
SHOWN = 11
"""Motions in a table."""

SLACK = 1.0 + 1e-6
"""Excess of a limit that counts as rounding."""


@dataclass(frozen=True)
class ProposedMotion:
    """A motion, and what a log of it would tell.

    Attributes:
        changes: key of the scene → value.
        errors: parameter → standard error to be expected; infinite where the log doesn't determine it.
        figure: the criterion: of D the geometric mean of the relative standard errors along the principal axes, of A their root mean square.
        torque, speed: largest torque [N.m] and joint velocity [rad/s].
        is_allowed: whether both keep the limits.
    """

    changes: Mapping[str, Any]
    errors: Mapping[str, float]
    figure: float
    torque: float
    speed: float
    is_allowed: bool

    @property
    def text(self) -> str:
        """The motion in a few words."""
        if not self.changes:
            return "the scene's own motion"
        profile = self.changes["trajectory.profile"]
        ramp = f" {profile['ramp']:g}" if "ramp" in profile else ""
        return f"{profile['kind']}{ramp}, {self.changes['trajectory.duration']:.4g} s, {self.changes['trajectory.width']:.4g} m wide"

    @property
    def facts(self) -> dict[str, Any]:
        """What it is, and what it needs of the motors [N.m, rad/s]."""
        needs = {"torque": self.torque, "speed": self.speed, "allowed": self.is_allowed}
        return {"motion": self.text, "criterion": self.figure, **needs}


@dataclass(frozen=True, eq=False, repr=False)
class ProposedMotions(Rows):
    """Motions of a scene, those first that keep the limits and determine the parameters best.

    Attributes:
        scene: the scene.
        own: its own motion.
        motions: all others.
        units: parameter → unit.
    """

    row_name = "motion"

    scene: Scene
    own: ProposedMotion
    motions: tuple[ProposedMotion, ...]
    units: Mapping[str, str]

    @property
    def best(self) -> ProposedMotion:
        """The best motion that keeps the limits; the scene's own if none is better."""
        return min((self.own, *(each for each in self.motions if each.is_allowed)), key=lambda each: each.figure)

    def rows(self) -> list[dict[str, Any]]:
        """A row for each motion, the scene's own first: criterion, largest torque and velocity, whether limits are kept, standard errors."""
        return [{**each.facts, **each.errors} for each in (self.own, *self.motions)]

    def row_units(self) -> Mapping[str, str]:
        """Column → unit."""
        return {**self.units, "torque": "N.m", "speed": "rad/s"}

    def table(self) -> Table:
        """The scene's own motion and the best ones within the limits, with their standard errors to be expected."""
        shown = (self.own, *(each for each in self.motions if each.is_allowed))[:SHOWN]
        rows = [
            [each.text, *(f"{error:.2g}" for error in each.errors.values()), f"{each.torque:.4g}", f"{each.speed:.4g}"]
            for each in shown
        ]
        return Table(
            "Standard errors to be expected", ["Motion", *self.own.errors, "Torque [N·m]", "Speed [rad/s]"], rows
        )

    def as_data(self) -> dict[str, Any]:
        """Plain data in SI units."""

        def described(each: ProposedMotion) -> dict[str, Any]:
            return {**each.facts, "changes": dict(each.changes), "standard_errors": dict(each.errors)}

        own, best = described(self.own), described(self.best)
        return {"scene": self.scene.name, "own": own, "best": best, "motions": [*map(described, self.motions)]}

    def __repr__(self) -> str:
        """Return at most five lines: the best motion and its standard errors."""
        items = [f"{name} ± {value:.2g} (now {self.own.errors[name]:.2g})" for name, value in self.best.errors.items()]
        return few_lines(f"Best of {len(self.motions) + 1} motions for {self.scene.name}: {self.best.text}", items)

    def plot(self) -> Figure:
        """Criterion over the largest torque of all motions."""
        from flexfmu.cosim.reports.figure_style import figure_of

        allowed, beyond = ([each for each in self.motions if each.is_allowed is wanted] for wanted in (True, False))
        groups = (allowed, "within the limits", FIRST), (beyond, "beyond", SECOND), ([self.own], "own motion", INK)
        curves = list[Curve]()
        for some, label, colour in groups:
            torque, criterion = (np.array([getattr(each, name) for each in some]) for name in ("torque", "figure"))
            curves.append(Curve(torque, criterion, label, colour, 0.0, dot="disc"))
        panel = Panel("criterion", curves, logarithmic="y", is_function=False)
        return figure_of([Plot("proposed", f"Motions of {self.scene.name}", "", (panel,), "largest torque [N·m]")])


@one_blas_thread()
def propose_motions(
    scene: Scene,
    parameters: Sequence[FreeParameter],
    *,
    signals: Sequence[str] = TORQUES,
    noise: float = 0.01,
    sample_time: float = 1e-3,
    sensors: Collection[str] = ("delay", "offset"),
    criterion: Criterion = "D",
    show: ShowProgress,
) -> ProposedMotions:
    """Return what logs of motions would tell of parameters.

    Limits are what the scene's motors can, or else largest torque and joint velocity of its own motion.

    Args:
        scene: a scene with path and profile that motion drives, its parameters at their first values.
        parameters: what is to be estimated.
        signals: what is measured.
        noise: standard deviation of white noise, relative to each signal's largest value in the scene's own motion.
        sample_time: of the log [s].
        sensors: what is unknown of them.
        criterion: by which motions are compared.
        show: shows progress.

    Raises:
        InputError: the scene has no path and profile, or torques drive it; a signal doesn't exist; or noise or sample time aren't positive.
    """
    section = scene.trajectory
    if not isinstance(section, TrajectorySection) or scene.cosimulation.drive != "motion":
        raise InputError(
            f'motions are proposed for scenes with path and profile that motion drives, {scene.name} has another: set cosimulation.drive = "motion"'
        )
    if not (noise > 0.0 and sample_time > 0.0):
        raise InputError(f"noise and sample time must be positive, got {noise:g} and {sample_time:g} s")
    path = build_scene(scene, shared=True).path
    known = comparable(scene, path)
    for each in signals:
        if "strain[" not in each and each not in known:
            raise InputError(f"{scene.name} has no signal {each!r}; {suggestion(each, known)}")
    parts = {each: parts_of(each, scene, known) for each in signals}
    deviations: dict[str, float] = {}
    limits: list[float] = []

    def judged(changes: Mapping[str, Any]) -> ProposedMotion:
        robot = scene.replace(dict(changes)) if changes else scene
        planned = plan(robot)
        time = np.arange(0.0, planned.stop_time, sample_time)
        steady = (slice(0, time.size),)
        channels = tuple(
            Channel(name, known.get(name, "1"), each, time, np.zeros(time.size), steady, sample_time)
            for name, each in parts.items()
        )
        outputs = sorted({*TORQUES, *(output for each in parts.values() for output in each)})
        experiment = Experiment(
            robot.name, channels, SceneSimulation(robot, path, outputs), 2.0 * planned.stop_time, True, robot
        )
        problem = Problem([experiment], parameters, sensors, [0.0])
        (recording,) = problem.at(problem.start)
        torque = max(float(np.abs(recording[each].values).max()) for each in TORQUES)
        if not limits:
            for channel in channels:
                size = float(np.abs(channel.simulated(recording, 0.0)[0]).max())
                deviations[channel.name] = noise * (size or 1.0)
            limits[:] = _limits(scene, torque, planned.top_speed)
        columns = problem.derivatives(problem.start)
        scaled = [
            each * problem.sizes / deviations[row.channel.name] for each, row in zip(columns, problem.rows, strict=True)
        ]
        errors, figure = _expected(np.concatenate(scaled), len(parameters), criterion)
        is_allowed = torque <= limits[0] * SLACK and planned.top_speed <= limits[1] * SLACK
        named = {each.name: error * each.size for each, error in zip(parameters, errors.tolist(), strict=True)}
        return ProposedMotion(changes, named, figure, torque, planned.top_speed, is_allowed)

    show("the scene's own motion", None)
    own, found = judged({}), list[ProposedMotion]()
    candidates = [*product(PROFILES, DURATIONS, WIDTHS)]
    for number, (profile, duration, width) in enumerate(candidates):
        show("motions", number / len(candidates))
        blend = {**section.blend.model_dump(), "width": min(section.blend.width, 0.5 * section.width * width)}
        sizes = {"duration": section.duration * duration, "width": section.width * width}
        changes = {f"trajectory.{key}": value for key, value in ({"profile": profile, "blend": blend} | sizes).items()}
        try:
            found.append(judged(changes))
        except (TrajectoryError, SceneError, InputError):
            continue  # motions that the robot can't make
    found.sort(key=lambda each: (not each.is_allowed, each.figure))
    return ProposedMotions(scene, own, tuple(found), {each.name: each.unit for each in parameters})


def _limits(scene: Scene, torque: float, speed: float) -> list[float]:
    """Largest torque [N.m] and velocity [rad/s] of a joint."""
    if scene.motor is None:
        return [torque, speed]
    motors = [scene.motor.of_joint(joint) for joint in (0, 1)]
    return [
        min(each.peak_torque * each.gear_ratio * each.gear_efficiency for each in motors),
        min(each.maximum_speed / each.gear_ratio for each in motors),
    ]


def _expected(scaled: RealArray, count: int, criterion: Criterion) -> tuple[RealArray, float]:
    """Relative standard errors of the first ``count`` unknowns, and the criterion."""
    values, vectors = np.linalg.eigh(information(scaled, count))
    with np.errstate(divide="ignore"):
        spread = np.where(values > 1e-12 * max(float(values[-1]), 1e-300), 1.0 / np.maximum(values, 1e-300), np.inf)
        errors = np.sqrt(np.where(np.abs(vectors) > 1e-9, vectors**2 * spread, 0.0).sum(axis=1))
        figure = np.exp(0.5 * np.mean(np.log(spread))) if criterion == "D" else np.sqrt(np.mean(errors**2))
    return errors, float(figure)
