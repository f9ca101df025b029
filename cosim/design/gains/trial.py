"""A trial of values: the scene with them, its run and those with other payloads, and its loop's margins.

Each is kept at once: what interrupts a tuning loses at most those that are being made.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isfinite, log10
from pathlib import Path
from typing import Any

from flexfmu.cosim.design.gains.goals import MARGINS, Condition, Goal
from flexfmu.cosim.design.gains.robustness import PayloadBand, band_masses, failure_of, largest, robustness
from flexfmu.cosim.design.margins.margins import shown_robot
from flexfmu.cosim.design.margins.scene_margins import MarginsResult, scene_margins
from flexfmu.cosim.design.response.response import FrequencyResponse
from flexfmu.cosim.engine.errors import CosimError, InputError
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.many.journal import WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.fmu_build.errors import MissingCompilerError
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.keys import full_key, value_at
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

DIGITS = 5
"""Significant digits of tried values: more than a run tells apart, and short enough for a scene file."""

POSES = 2
"""Number of poses at which margins are calculated, start and end of the path, beside the worst ones in between."""

WIDE = 4.0
"""Ratio of the ends of an interval from which its scale is logarithmic."""


@dataclass(frozen=True)
class Interval:
    """A key and the values that are tried.

    Attributes:
        key: of the scene.
        low, high: ends, in the unit of the key.
    """

    key: str
    low: float
    high: float

    @property
    def is_logarithmic(self) -> bool:
        """Whether equal factors count as equal steps: where the ends are positive and far apart."""
        return self.low > 0.0 and self.high >= WIDE * self.low

    def at(self, share: float) -> float:
        """The value at a share of the interval, 0 to 1, rounded to `DIGITS`."""
        if self.is_logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + share * (self.high - self.low)
        return min(max(float(f"{value:.{DIGITS}g}"), self.low), self.high)

    def share_of(self, value: float) -> float:
        """The share of a value, 0 to 1; of the nearer end for values beyond."""
        value = min(max(value, self.low), self.high)
        if self.is_logarithmic:
            return log10(value / self.low) / log10(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Trial:
    """Values and what they are worth.

    Attributes:
        values: of the keys; empty for the scene as it is.
        figures: metrics, the worst over the band of payloads, and margins in SI units; empty for a failed run.
        message: why it failed; empty otherwise.
    """

    values: tuple[float, ...]
    figures: Mapping[str, float | None] = field(default_factory=dict)
    message: str = ""


@dataclass(frozen=True)
class Study:
    """What is tuned, and for what.

    Attributes:
        scene: the scene, its effects chosen.
        over: keys and intervals.
        minimise: the figure to minimise.
        conditions: limits of figures.
        band: payloads that all figures hold for, the worst of them; None for the scene's alone.
        robots: parameters of further robots that they hold for.
        response: of the robot, that margins are those with, whatever the payload; None for the model's.
    """

    scene: Scene
    over: tuple[Interval, ...]
    minimise: Goal
    conditions: tuple[Condition, ...] = ()
    band: PayloadBand | None = None
    robots: tuple[Mapping[str, float], ...] = ()
    response: FrequencyResponse | None = None

    @property
    def goals(self) -> tuple[Goal, ...]:
        """All figures that are needed."""
        return (self.minimise, *(each.goal for each in self.conditions))

    def changed(self, values: Sequence[float]) -> Scene:
        """The scene with values of its keys.

        Raises:
            SceneError: a value is invalid.
        """
        return self.scene.replace({each.key: value for each, value in zip(self.over, values, strict=False)})

    def given(self) -> tuple[float | None, ...]:
        """The scene's own values; None for a key without a number: both joints have different ones, or it isn't set."""
        data = self.scene.model_dump()
        return tuple(_single(value_at(data, each.key, f"scene {self.scene.name}")) for each in self.over)

    def tried(self, values: tuple[float, ...]) -> Trial:
        """Run the scene with values; without any as it is. What fails has a message.

        Raises:
            MissingCompilerError: there is no C compiler.
        """
        try:
            return self._figures(values)
        except MissingCompilerError:
            raise
        except (CosimError, SceneError, TrajectoryError, EquilibriumError) as error:
            return Trial(values, {}, str(error))

    def _figures(self, values: tuple[float, ...]) -> Trial:
        scene = self.changed(values)
        names = list(dict.fromkeys(part for goal in self.goals if not goal.is_margin for part in goal.parts))
        prepared = PreparedScene(scene)
        run = prepared.run()
        if reason := failure_of(run):
            return Trial(values, {}, reason)
        found = dict(metrics_of(run, names))
        # the worst of the scene's robot, both ends of the band, and further robots
        masses = () if self.band is None else band_masses(scene, self.band)
        robots: dict[str, Mapping[str, float]] = {f"{mass:g} kg": {"payload.mass": mass} for mass in masses}
        robots |= {shown_robot(each): each for each in self.robots}
        if robots:
            worst, failures = robustness(prepared, robots, names)
            for robot, reason in failures.items():
                return Trial(values, {}, f"with {robot}: {reason}")
            found = {name: largest([found[name], worst[name].value]) for name in names}
        # margins take longer than runs
        if any(goal.is_margin for goal in self.goals):
            found |= margin_figures(loop_margins(scene, self.band, self.response, self.robots))
        return Trial(values, found)

    def instability(self, trial: Trial) -> str:
        """Where the loop of a trial is unstable about rest; empty where it isn't, where it has no loop, or none that can be linearised."""
        scene = self.changed(trial.values)
        if scene.cosimulation.drive != "torque" or not scene.controller or any(goal.is_margin for goal in self.goals):
            return ""
        try:
            loop_margins(scene, self.band, robots=self.robots)
        except UnstableLoopError as error:
            return str(error)
        except (CosimError, SceneError, TrajectoryError, EquilibriumError):
            pass
        return ""

    def rank(self, trial: Trial) -> tuple[int, float]:
        """What a trial is sorted by: within all limits by the figure, beyond them by the largest excess, failed ones last."""
        value = self.minimise.of(trial.figures)
        if trial.message or value is None:
            return 2, inf
        excess = max([0.0, *(one for each in self.conditions for one in each.excesses(trial.figures))])
        return (0, value) if excess <= 0.0 else (1, excess)


class UnstableLoopError(InputError):
    """The loop of a scene is unstable about a pose of its path."""


def loop_margins(
    scene: Scene,
    band: PayloadBand | None = None,
    response: FrequencyResponse | None = None,
    robots: Sequence[Mapping[str, float]] = (),
) -> MarginsResult:
    """Return the margins of a scene's loop along its path, over a band of payloads and robots, or at its end with a measured response.

    Raises:
        UnstableLoopError: the loop is unstable about a pose.
        InputError: it can't be linearised.
        TrajectoryError, EquilibriumError: as for `flexfmu.margins`.
    """
    masses = () if band is None or response is not None else band_masses(scene, band)
    robots = () if response is not None else robots
    found = scene_margins(scene, poses=POSES, payloads=masses, robots=robots, response=response)
    worst = max(found.poses, key=lambda pose: pose.radius)
    if not worst.is_stable:
        payload = "" if band is None and not robots else f" with {worst.carrier}"
        raise UnstableLoopError(f"the loop is unstable about the pose at {100.0 * worst.s:.3g} % of the path{payload}")
    return found


def margin_figures(found: MarginsResult) -> dict[str, Metric]:
    """Return the worst of each margin."""
    return {name: getattr(found.worst, name) for name in MARGINS}


def _single(value: Any) -> float | None:
    """One number for a value, or for both joints."""
    if isinstance(value, tuple | list) and value and all(each == value[0] for each in value):
        value = value[0]
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) else None


def check_keys(scene: Scene, over: Sequence[Interval]) -> None:
    """Check keys and intervals.

    Raises:
        InputError: an interval isn't one, or a key is there twice.
        SceneError: a key is unknown, or an end of its interval is invalid.
    """
    data = scene.model_dump(exclude_none=True)
    full = [full_key(data, each.key) for each in over]
    for each in over:
        if not (isfinite(each.low) and isfinite(each.high) and each.low < each.high):
            raise InputError(
                f"`{each.key}` must go from a smaller to a larger number, got {each.low:g} to {each.high:g}"
            )
        if [*full].count(full_key(data, each.key)) > 1:
            raise InputError(f"`{each.key}` is there twice: give one interval")
        for value in (each.low, each.high):
            scene.replace({each.key: value})


def trial_journal(
    folder: Path,
    study: Study,
    *,
    restart: bool = False,
    note: Callable[[str], object] = lambda text: None,
    total: int | None = None,
) -> WorkJournal:
    """The trials of a tuning in a folder, by their values; arguments and errors as for `WorkJournal`."""
    # what determines the trials of equal values
    about = {
        **about_scene(study.scene),
        "keys": [each.key for each in study.over],
        "figures": sorted({part for goal in study.goals for part in goal.parts}),
        "payload band": study.band,
    }
    if study.robots:
        about["robots"] = [*study.robots]
    if study.response is not None:
        about["response"] = study.response.rows()
    return WorkJournal(folder, "tuning", about, restart=restart, note=note, total=total)
