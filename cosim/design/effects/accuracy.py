"""Chooses effects, communication step, integrator and tolerance together, such that figures of a scene have the accuracy that is asked for.

The error of a figure is what a run of the scene as it is, loop included, differs from the richest model by: a set of effects that one
more mode of every family changes by at most `CONVERGED` of what is allowed, integrated at `EXACT`. Its bound is the distance of the two
runs, at least that of the set of effects alone, and what the richest model itself isn't known to; the next tighter tolerance may not be
worse. Two parts are shown: the effects that are left out (a run at `EXACT` beside the richest model's), and the numerics (the setting
beside its own run at `EXACT`). Sets of effects are a
ladder and, where it has a gap, what the linear estimates of `flexfmu.cosim.design.effects.estimator` choose; runs decide. Tolerances are
tightened from the loosest on, and left where another setting is cheaper already. The choice of effects alone
(`flexfmu.cosim.design.effects.choice`) is the same with the communication step and the integrator of the scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from itertools import product
from math import inf, isfinite
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import TypeAdapter, ValidationError

from flexfmu.cosim.design.effects.estimator import Estimator, richest, with_set
from flexfmu.cosim.design.effects.runs import MARGINS, ObservedFigures, SceneRuns, followed, is_smooth, with_settled
from flexfmu.cosim.design.effects.search import CONVERGED, SAFETY, one_more, rich_enough, smallest_set
from flexfmu.cosim.engine.errors import CosimError, InputError, ResultsError, suggestion
from flexfmu.cosim.engine.files import to_json
from flexfmu.cosim.engine.showing import UNITS, ShowProgress, quiet
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.accuracy import (
    AccuracyAnswer,
    FigureError,
    PricedSettings,
    WorkPrecisionTrial,
    excess,
    quantity_of,
)
from flexfmu.cosim.experiment.timing import fastest_in_turns
from flexfmu.cosim.many.journal import NOWHERE, WorkJournal, about_scene
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, definition
from flexfmu.fmu_build.cache import cache_folder, content_hash, package_fingerprint, read_cached, store
from flexfmu.model.choice_text import set_text
from flexfmu.model.enrichment import THEORIES
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.choice import MEASURES, MeasureName
from flexfmu.model.scene.effects import FamilyName
from flexfmu.model.scene.loop import SampledSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

TINY = 1e-300
"""Change that stands for zero in ratios."""

EXACT = 1e-11
"""Tolerance of runs that show the error of a set of effects; the richest one's is compared with a tenth of it."""

EXACT_EFFECTS = 1e-9
"""The same where effects alone are chosen, with the communication step and the integrator of the scene: small enough that only they differ."""

BEYOND = 2.0
"""What all further modes may change a figure by, in terms of what the last mode of every family did: contributions that fall with the
fourth power of a mode's number add up to about as much again, and scatter."""

MOST_COORDINATES = 44
"""Largest number of coordinates of a richest set: more take a minute to build."""

LADDER: Mapping[str, Mapping[str, Any]] = {
    "rigid": {},
    "4 coordinates": {"proximal_bending": 1, "distal_axial": 1, "beam": "timoshenko"},
    "6 coordinates": {"proximal_bending": 1, "distal_bending": 1, "distal_axial": 1, "beam": "timoshenko"},
    "8 coordinates": {"proximal_bending": 2, "distal_bending": 1, "distal_axial": 1, "beam": "timoshenko"},
    "12 coordinates": {
        "proximal_bending": 2, "proximal_axial": 1, "distal_bending": 2, "distal_axial": 1, "beam": "timoshenko",
    },
}  # fmt: skip
"""Sets of effects that are tried in any scene; shear costs nothing in a run."""

HOPELESS = 30.0
"""Estimated error in units of what is allowed above which a set isn't run."""

SHARE = 0.5
"""Share of the allowed error for the effects, by which estimates choose them; runs then decide by the sum."""

ROUNDS = 5
"""Largest number of sets that estimates choose, each with larger safety factors for the figures that runs have shown to be wrong."""

WITHOUT_ERROR = 1e12
"""Safety factor with which only the richest set is within a limit."""

FINEST = 1e-10
"""Smallest relative error that can be asked for: runs at `EXACT` aren't better."""

TOLERANCES = tuple(float(f"{each}e-{k}") for k in range(1, 11) for each in (1, 0.3))
INTEGRATORS = ("automatic", "gauss3", "gauss4")
"""Integrators that win somewhere; for rigid links nothing is stiff."""

STEPS = (1.0 / 20.0, 1.0 / 40.0, 1.0 / 80.0, 1.0 / 200.0, 1.0 / 400.0, 1.0 / 800.0, 1.0 / 2000.0)
"""Communication steps as fractions of the motion's duration, where nothing samples."""

LENGTHENINGS, TIGHTENINGS = (1.8, 1.5, 1.25), (1.0, 0.3, 0.1)
"""Factors by which the communication step of the fastest settings is lengthened, and its tolerance tightened, if that is cheaper."""

HALVINGS = 3
"""Halvings of the communication step of scenes with a loop: from the sample time and the scene's own on; continuous slaves need them."""

WORTH_TIMING = 1.3
"""Ratio to the least processor time up to which settings are timed in turns, and beyond which none is tightened."""

FINALISTS = 4
"""Largest number of settings that are timed in turns."""

TENTH = 0.1
"""What would come next is for this part of what was asked."""

MEASURED: tuple[MeasureName, ...] = ("peak_position_error", "peak_torque_1", "residual_vibration_amplitude")
"""Usual metrics of a choice of effects; the last one needs a dwell."""


@dataclass(frozen=True)
class SettingTrial:
    """A tried setting.

    Attributes:
        scene: with the setting.
        model, numerics: error of each figure by the effects that are left out, and by the numerics [SI].
        both: error of each figure by both together [SI]: its distance from the reference, at least that of the effects.
        time: processor time of a run [s].
        share: largest total error in units of what is allowed.
    """

    scene: Scene
    model: RealArray
    numerics: RealArray
    both: RealArray
    time: float
    share: float

    @property
    def priced(self) -> PricedSettings:
        """Settings and time, in words."""
        return PricedSettings(setting_text(self.scene), self.time, self.share)


def setting_text(scene: Scene) -> str:
    """Effects, integrator, tolerance and communication step in words."""
    section = scene.cosimulation
    step = "steps chosen from the motion" if section.step is None else f"steps of {section.step:g} s"
    fixed = f", integrator steps of {section.integrator_step:g} s" if section.integrator_step else ""
    return f"{set_text(scene)}; {section.integrator} at {section.tolerance:.0e}{fixed}, {step}"


def set_size(scene: Scene) -> int:
    """Number of elastic coordinates of the links that are states."""
    effects = scene.effects
    return 2 * sum(int(getattr(effects, key)) for key in get_args(FamilyName) if key not in effects.quasi_static)


def with_numerics(scene: Scene, step: float | None, integrator: str, tolerance: float) -> Scene:
    """The scene with these numerical settings."""
    return scene.replace(
        {
            "cosimulation.step": "auto" if step is None else step,
            "cosimulation.integrator": integrator,
            "cosimulation.integrator_step": 0.0,
            "cosimulation.tolerance": float(f"{tolerance:.2g}"),
        }
    )


def check_figures(scene: Scene, asked: Mapping[str, float | str], key: str = "accuracy") -> None:
    """Check names and values of what is asked for by a key of the scene.

    Raises:
        InputError: there is no such figure of this robot, or an absolute error has another unit or isn't above zero.
    """
    known = (*ALL_METRICS, *MARGINS)
    for name, value in asked.items():
        if name not in known:
            raise InputError(f"`{key}` names {name!r}, which is no metric; {suggestion(name, known)}")
        if name in MARGINS and not scene.controller:
            raise InputError(f"`{key}` names {name}, a margin of a loop, and scene {scene.name} has no controller")
        if name.startswith(("residual", "settling")) and not scene.trajectory.dwell:
            raise InputError(
                f"`{key}` names {name}, which needs a standstill after the motion: give `trajectory.dwell` above 0 s"
            )
        if not isinstance(value, str):
            if value < FINEST:
                raise InputError(f"`{key}.{name}` = {value:g} can't be had: the smallest relative error is {FINEST:g}")
            continue
        number, unit = quantity_of(value, name)
        own = definition(name).unit
        if unit not in (own, *UNITS) or UNITS.get(unit, (unit, 1.0))[0] != own:
            units = ", ".join(each for each, (si, _) in UNITS.items() if si == own) or own
            raise InputError(
                f"`accuracy.{name}` = {value!r} has {f'the unit {unit!r}' if unit else 'no unit'}: it is in {units}; a relative "
                "error is a number without quotes"
            )
        if not 0.0 < number < inf:
            raise InputError(f"`accuracy.{name}` = {value!r} must be above 0 {unit}")


class NotConvergedError(ResultsError):
    """A figure keeps changing with the number of modes."""


class Chooser:
    """Searches the cheapest settings of a scene for what is asked.

    Args:
        scene: with the default settings; its own elastic effects are a set among others.
        asked: figure → relative error, or text of an absolute one.
        show: called with the current activity and the finished fraction.
        journal: where estimates and runs are kept.
        floor: None where effects and numerics are chosen. Where effects alone are: the smallest position to which an error is relative,
            as a fraction of the peak position error, which must be asked for if positions are.

    Attributes:
        richest, reference: the scene with the richest set, and its figures.
        allowed: largest error of each figure [SI].
        known: error of each figure of the richest model itself [SI].
        is_estimated: whether linear estimates are of this scene, not of a loop, and have all figures.

    Raises:
        InputError: as for `check_figures`, or a figure has no value.
        NotConvergedError: the figures don't converge with the number of modes.
        ResultsError: a run of the richest set failed.
    """

    def __init__(
        self,
        scene: Scene,
        asked: Mapping[str, float | str],
        show: ShowProgress = quiet,
        journal: WorkJournal = NOWHERE,
        floor: float | None = None,
    ) -> None:
        check_figures(scene, asked)
        self.scene, self.asked, self._show = (
            scene.replace({"accuracy": None, "effects.choice": None}),
            dict(asked),
            show,
        )
        self._journal, self._floor = journal, floor
        self._runs = SceneRuns(self.asked, show, journal, timed=floor is None)
        section = scene.cosimulation
        motion = scene.trajectory.duration
        self._is_smooth = is_smooth(scene)
        # whether estimates, of motors that follow the motion exactly, are of this scene, and of all its figures
        self._is_followed = self._is_smooth if floor is None else not scene.controller
        self.is_estimated = self._is_followed and self.asked.keys() <= {*MEASURES}
        finest = min(section.communication_step, motion / 2000.0) if self._is_smooth else section.communication_step
        self._exact_step = finest if self._is_smooth else finest / 2**HALVINGS
        self.trials: dict[str, SettingTrial] = {}
        self._converge()

    # The richest model

    def _converge(self) -> None:
        """Find the richest set, its figures, what is allowed of each, and how well the richest model itself is known."""
        most = richest(self.scene)
        found = self.exact_figures(most, "running the richest set")
        values = dict(zip(self.asked, found.values[0], strict=True))
        self.allowed = np.array([self._allowed(name, values) for name in self.asked])
        if self._is_followed:
            self._show("estimating how many modes matter", None)
            units = self._units(Estimator(self.scene, self._motion, self._measures, journal=self._journal), found)
            bends = 1.0 if self._floor is None else min(map(float, self.asked.values()))
            most = rich_enough(self.scene, self._motion, units, bends, self._journal)
            found = self.exact_figures(most, "running the richest set")
        self.richest, self.reference = most, found
        rest = earlier = np.full(self.allowed.shape, np.inf)
        before = most
        while (rest > CONVERGED * self.allowed).any():
            finer = one_more(most, get_args(FamilyName))
            # at the rate of the last two changes, how large would the last affordable one be
            left = (MOST_COORDINATES - set_size(most)) // max(set_size(finer) - set_size(most), 1)
            hopeless = (
                (rest * (rest / np.maximum(earlier, TINY)) ** left > CONVERGED * self.allowed).any()
                if np.isfinite(earlier).all()
                else left < 1
            )
            if hopeless or finer == most:
                name = [*self.asked][int(np.argmax(rest / self.allowed))]
                last = rest[[*self.asked].index(name)]
                how = f"with {set_size(most)} instead of {set_size(before)} coordinates of the links it still changes by {last:.2g}"
                how = (
                    f"{how} {definition(name).unit}"
                    if isfinite(last)
                    else f"by estimates {set_size(most)} coordinates don't suffice"
                )
                raise NotConvergedError(f"{name} doesn't converge as far as asked: {how}; ask for less accuracy")
            better = self.exact_figures(finer, "running one more mode of every family")
            earlier, rest, before = rest, better.change(found), most
            most, found = finer, better
        self.richest, self.reference = most, found
        self.known = BEYOND * rest
        if self._floor is None:
            # and how well it is integrated
            twice = self._observe(
                with_numerics(most, 0.5 * self._exact_step, "automatic", 0.1 * EXACT),
                "running the richest set, more precisely",
            )
            self.known += twice.change(found)

    @property
    def reserve(self) -> RealArray:
        """What is stated of the richest model's error [SI]: the next mode may change more than the last, however little that did."""
        found: RealArray = np.maximum(self.known, CONVERGED * self.allowed)
        return found

    def _allowed(self, name: str, values: Mapping[str, float]) -> float:
        asked, value, key = self.asked[name], values[name], "accuracy" if self._floor is None else "effects.of"
        if self._floor is not None and definition(name).unit == "m" and isfinite(value):
            value = max(abs(value), self._floor * values["peak_position_error"])
        if isinstance(asked, str):
            number, unit = quantity_of(asked, name)
            if not isfinite(value):
                raise InputError(f"`accuracy` names {name}, which has no value in scene {self.scene.name}")
            return number * UNITS.get(unit, (unit, 1.0))[1]
        if not isfinite(value) or value == 0.0:
            which = "is 0" if value == 0.0 else "has no value"
            is_mendable = value == 0.0 and self._floor is None
            remedy = "; ask for an absolute error, a text with its unit" if is_mendable else ""
            if value == 0.0 and name in MARGINS:
                remedy = ", since the loop is unstable: make it stable first"
            raise InputError(f"`{key}` names {name}, which {which} in scene {self.scene.name}{remedy}")
        return float(asked * abs(value))

    @property
    def _measures(self) -> tuple[MeasureName, ...]:
        """Figures that the linear estimates have, of those asked for; in place of others the usual ones."""
        has_dwell = self.scene.trajectory.dwell > 0.0
        own = tuple(name for name in MEASURES if name in self.asked)
        if len(own) == len(self.asked):
            return own
        usual = (name for name in MEASURED if has_dwell or not name.startswith("residual"))
        return tuple(dict.fromkeys((*own, *usual)))

    def _units(self, estimates: Estimator, found: ObservedFigures) -> dict[MeasureName, float]:
        """What is allowed of these figures [SI]; of the usual ones the smallest relative error that is asked for."""
        ratio = float(np.min(self.allowed / np.abs(np.array(found.values[0]))))
        allowed = dict(zip(self.asked, self.allowed.tolist(), strict=True))
        return {name: allowed.get(name, ratio * abs(value)) for name, value in estimates.reference.items()}

    def exact(self, base: Scene) -> Scene:
        """Return the scene with a set of effects, integrated such that only the effects make an error."""
        if self._floor is None:
            return with_numerics(base, self._exact_step, "automatic", EXACT)
        return base.replace({"cosimulation.integrator_step": 0.0, "cosimulation.tolerance": EXACT_EFFECTS})

    def exact_figures(self, base: Scene, activity: str = "") -> ObservedFigures:
        """Return the figures of an `exact` run; errors as for `SceneRuns.observe`."""
        return self._observe(self.exact(base), activity or f"running {set_text(base)}")

    def _observe(self, scene: Scene, activity: str) -> ObservedFigures:
        return self._runs.observe(scene, activity)

    # Sets of effects

    def smallest(self, target: float) -> Scene:
        """Return a set with few coordinates whose error is at most ``target`` times what is allowed, the richest where none is.

        Estimates choose it and runs confirm it; where estimates are of another system, or of other figures, it is part of the first
        set of the ladder that suffices.
        """
        ladder = () if self.is_estimated else self._ladder
        first = next((each for each in ladder if self.model_share(each) <= target), None)
        return next(self._estimated(target, target, first), first or self.richest)

    def _sets(self, target: float) -> Iterator[Scene]:
        """Yield sets whose model error leaves room for the numerics, in units of ``target`` times what is allowed: few coordinates first."""
        own = [name for name in self._measures if name in self.asked] if self._is_followed else []
        fitting = list[Scene]()
        for each in self._ladder:
            # what estimates call hopeless isn't built
            if any(self.estimates.errors(each.effects)[name] > HOPELESS * target for name in own):
                continue
            if (share := self.model_share(each)) <= target:
                fitting.append(each)
            # more coordinates take longer, and could leave the numerics little more
            if share <= SHARE * target:
                break
        first = fitting[0] if fitting else self.richest
        if set_size(first):
            fitting += self._estimated(target, SHARE * target, first)
        yield from sorted([*fitting, self.richest], key=set_size)

    def _estimated(self, target: float, limit: float, most: Scene | None) -> Iterator[Scene]:
        """Yield the part of a set that estimates choose for a limit, if it has fewer coordinates; more carefully until a run confirms it.

        Figures that a run has shown to be wrong get larger safety factors; where estimates don't have such a figure, all others do.
        """
        # of another system, or of other figures, estimates may be far too large
        safety = dict.fromkeys(self._measures, SAFETY if self.is_estimated else SAFETY / HOPELESS)
        for _ in range(ROUNDS):
            self._show("choosing a set of effects", None)
            found = smallest_set(self.estimates, safety, limit, most)
            if most is not None and set_size(found) >= set_size(most):
                return
            shares = dict(zip(self.asked, self.model_shares(found).tolist(), strict=True))
            if (worst := max(shares.values())) <= target:
                yield found
                return
            for name, estimated in self.estimates.errors(found.effects).items():
                if (share := shares.get(name, worst)) > target:
                    grown = SAFETY * share / max(estimated, 1e-12)
                    safety[name] = min(max(2.0 * safety[name], grown), WITHOUT_ERROR)
            if self.estimates.richest != self.richest:
                del self.estimates  # of the first richest set, which sufficed to estimates

    @property
    def _ladder(self) -> list[Scene]:
        """The ladder and the scene's own set, few coordinates first."""
        return sorted([*self.ladder.values()][:-1], key=set_size)

    @cached_property
    def ladder(self) -> dict[str, Scene]:
        """Name → set of effects: the ladder, the scene's own, and the richest."""
        found = {name: with_set(self.scene, chosen) for name, chosen in LADDER.items()}
        own, most = (
            f"{name} ({set_size(each)})" for name, each in (("the scene's own", self.scene), ("richest", self.richest))
        )
        return found | {own: self.scene, most: self.richest}

    @cached_property
    def _motion(self) -> Trajectory:
        return followed(self.scene)

    @cached_property
    def estimates(self) -> Estimator:
        """Linear estimates, in units of what is allowed; for figures that they don't have, of the usual ones."""
        found = Estimator(self.scene, self._motion, self._measures, self.richest, self._journal)
        return found.scaled(self._units(found, self.reference))

    def model_shares(self, base: Scene) -> RealArray:
        """Return each figure's error by the effects that a set leaves out, with what the reference isn't known to, in units of what is allowed."""
        try:
            found: RealArray = (self.model_errors(base) + self.known) / self.allowed
        except CosimError:
            found = np.full(self.allowed.shape, inf)
        return found

    def model_share(self, base: Scene) -> float:
        """Return the largest of the `model_shares`."""
        return float(self.model_shares(base).max())

    def model_errors(self, base: Scene) -> RealArray:
        """Return the error of each figure by the effects that a set leaves out [SI]; errors as for `SceneRuns.observe`."""
        return self.exact_figures(base).change(self.reference)

    # Numerics

    def trial(self, scene: Scene) -> SettingTrial | None:
        """Return a setting's errors and time; None where it fails."""
        with suppress(CosimError):
            return self.measured(scene)
        return None

    def measured(self, scene: Scene) -> SettingTrial:
        """Return a setting's errors and time; errors as for `SceneRuns.observe`."""
        key = scene.model_dump_json(include={"effects", "cosimulation"})
        if key not in self.trials:
            exact = self.exact_figures(scene)
            found = self._observe(scene, "; ".join(reversed(setting_text(scene).split("; "))))
            model, numerics = exact.change(self.reference), found.change(exact)
            both = np.maximum(model, found.change(self.reference))
            share = float(((both + self.known) / self.allowed).max())
            self.trials[key] = SettingTrial(scene, model, numerics, both, found.time, share)
        return self.trials[key]

    def points(self, trial: SettingTrial) -> Iterator[WorkPrecisionTrial]:
        """Yield the error of each figure with a setting, relative where its value isn't 0, as a point of the line of its set of effects."""
        names = (name for name, each in self.ladder.items() if each.effects == trial.scene.effects)
        line = next(names, f"{set_size(trial.scene)} coordinates, by estimates")
        label = setting_text(trial.scene).partition("; ")[2]
        for name, value, error in zip(self.asked, self.reference.values[0], trial.both, strict=True):
            yield WorkPrecisionTrial(name, line, label, float(error / (abs(value) or 1.0)), trial.time)

    def missed_by(self, other: Scene) -> float:
        """Return the largest error of this scene with the settings of another, in units of what is allowed; infinite where its run fails."""
        changes = {key: getattr(other, key).model_dump(exclude_none=True) for key in ("effects", "cosimulation")}
        found = self.trial(self.scene.replace(changes | {"cosimulation.step": other.cosimulation.step or "auto"}))
        return inf if found is None else found.share

    def steps(self) -> tuple[float | None, ...]:
        """Return the communication steps that are worth a trial [s], the longest first; None for steps chosen from the motion."""
        own = self.scene.cosimulation.step
        if self._is_smooth:
            fractions = (self.scene.trajectory.duration * each for each in STEPS)
            rounded = {float(f"{each:.1g}") for each in fractions} | ({own} if own else set())
            return (None, *sorted(rounded, reverse=True))
        own = own or self.scene.cosimulation.communication_step
        samples = [each.sample_time for each in self.scene.controller if isinstance(each, SampledSection)]
        longest = min(samples, default=2.0 * own)
        return tuple(dict.fromkeys((max(longest, own), *(own / 2**k for k in range(HALVINGS)))))

    def walk(self, base: Scene, target: float, best: float) -> Iterator[SettingTrial]:
        """Yield, for a set of effects, the loosest setting of each line that is accurate enough and may be cheaper than ``best`` [s]."""
        for step in self.steps():
            if self._is_smooth and not self._suffices(base, step, target):
                continue
            least, is_found = inf, False
            is_rigid = not set_size(base) and self._is_smooth
            for integrator in INTEGRATORS[: 1 if is_rigid else None]:
                found, fastest = self._loosest(base, step, integrator, target, WORTH_TIMING * best)
                least = min(least, fastest)
                if found is not None:
                    best, is_found = min(best, found.time), True
                    yield found
            # shorter steps take longer
            if (is_found and not self._is_smooth) or WORTH_TIMING * best < least < inf:
                return

    def _suffices(self, base: Scene, step: float | None, target: float) -> bool:
        """Whether a communication step is short enough: no tolerance mends what is lost between the ends of longer ones."""
        found = self.trial(with_numerics(base, step, INTEGRATORS[-1], TOLERANCES[-1]))
        return found is not None and found.share <= target

    def _loosest(
        self, base: Scene, step: float | None, integrator: str, target: float, limit: float
    ) -> tuple[SettingTrial | None, float]:
        """Return the first trial that is accurate enough, and the least time [s]; none beyond a time limit [s]."""
        least = inf
        for tolerance in TOLERANCES:
            found = self.trial(with_numerics(base, step, integrator, tolerance))
            least = least if found is None else min(least, found.time)
            if found is None or found.time > limit:
                break
            if found.share > target:
                continue
            # right by chance, if a tighter tolerance isn't
            tighter = self.trial(with_numerics(base, step, integrator, max(0.3 * tolerance, 1e-12)))
            if tighter is not None and tighter.share <= target:
                both = np.maximum(found.both, tighter.both)
                return replace(found, both=both, share=max(found.share, tighter.share)), least
        return None, least

    def _lengthened(self, found: SettingTrial, target: float) -> SettingTrial:
        """The fastest of a setting and those with longer communication steps, between those of the grid, that are accurate enough."""
        section = found.scene.cosimulation
        if section.step is None or not self._is_smooth:
            return found
        steps = [float(f"{factor * section.step:.2g}") for factor in LENGTHENINGS]
        tolerances = [max(factor * section.tolerance, EXACT) for factor in TIGHTENINGS]
        pairs = product(steps, tolerances)
        tried = [self.trial(with_numerics(found.scene, step, section.integrator, each)) for step, each in pairs]
        right = [each for each in tried if each is not None and each.share <= target]
        return min([found, *right], key=lambda each: each.time)

    # The answer

    def cheapest(self, target: float = 1.0) -> SettingTrial | None:
        """Return the cheapest setting whose errors are at most ``target`` times what is allowed; None where there is none."""
        target *= 1.0 - CONVERGED  # the rest is the `reserve`
        found, best = list[SettingTrial](), inf
        for base in self._sets(target):
            if found and base == self.richest:
                break
            for each in self.walk(base, target, best):
                found.append(each)
                best = min(best, each.time)
        if not found:
            exact = self.trial(with_numerics(self.richest, self._exact_step, "automatic", EXACT))
            return exact if exact is not None and exact.share <= target else None
        # the fastest in turns, since a machine's speed varies
        self._show("timing the fastest settings", None)
        found = sorted((each for each in found if each.time <= WORTH_TIMING * best), key=lambda each: each.time)
        found = [self._lengthened(each, target) for each in found[:FINALISTS]]
        times = fastest_in_turns([PreparedScene(with_settled(each.scene)).run for each in found])
        return min(
            (replace(each, time=time) for each, time in zip(found, times, strict=True)), key=lambda each: each.time
        )

    def answer(self) -> AccuracyAnswer:
        """Return the cheapest settings with their errors and costs.

        Raises:
            ResultsError: no settings are accurate enough.
        """
        chosen = self.cheapest()
        if chosen is None:
            raise ResultsError(
                f"no settings of scene {self.scene.name} are accurate enough: the richest model itself, {setting_text(self.richest)}, is known "
                f"to {float((self.known / self.allowed).max()):.2g} times what was asked; ask for less"
            )
        following = self.cheapest(TENTH)
        if following is not None and following.time < chosen.time:
            chosen = following
        why, default = self._why(chosen), self.trial(self.scene)
        exact = with_numerics(self.richest, self._exact_step, "automatic", EXACT)
        dearest = PricedSettings(setting_text(exact), self.reference.time, float((self.known / self.allowed).max()))
        figures = tuple(
            FigureError(
                name, definition(name).unit, f"{asked}" if isinstance(asked, str) else f"{asked:g}", *map(float, values)
            )
            for (name, asked), *values in zip(
                self.asked.items(),
                self.allowed,
                self.reference.values[0],
                chosen.model,
                chosen.numerics,
                self.reserve,
                chosen.both + self.reserve,
                strict=True,
            )
        )
        return AccuracyAnswer(
            figures,
            chosen.priced,
            None if default is None else default.priced,
            dearest,
            None if following is None else following.priced,
            self._changes(chosen.scene),
            len(self.trials),
            why,
            tuple(point for each in self.trials.values() for point in self.points(each)),
        )

    def _why(self, chosen: SettingTrial) -> str:
        """What fewer effects and looser tolerances would have missed, in a sentence."""
        section, effects = chosen.scene.cosimulation, chosen.scene.effects
        fewer = [
            (set_size(each), self.model_share(each), set_text(each))
            for each in self.ladder.values()
            if set_size(each) < set_size(chosen.scene)
        ]
        poor = max((each for each in fewer if 1.0 < each[1] < inf), default=None)
        looser = [
            each
            for each in self.trials.values()
            if each.scene.effects == effects
            and (each.scene.cosimulation.step, each.scene.cosimulation.integrator) == (section.step, section.integrator)
            and each.scene.cosimulation.tolerance > section.tolerance
            and each.share > 1.0
        ]
        loose = min(looser, key=lambda each: each.scene.cosimulation.tolerance, default=None)
        parts = [f"{poor[2]} would miss {excess(poor[1])}"] if poor else []
        if loose is not None:
            parts.append(f"a tolerance of {loose.scene.cosimulation.tolerance:.0e} {excess(loose.share)}")
        return " and ".join(parts) or "neither fewer effects nor looser numerics are cheaper"

    def _changes(self, scene: Scene) -> dict[str, Any]:
        """Dotted keys of effects and numerics that differ from the scene's own."""
        found = dict[str, Any]()
        for key in ("effects", "cosimulation"):
            own, new = (getattr(each, key).model_dump(mode="json") for each in (self.scene, scene))
            found |= {f"{key}.{name}": value for name, value in new.items() if value != own[name]}
        if found.get("cosimulation.step", 0.0) is None:
            found["cosimulation.step"] = "auto"
        return found


@one_blas_thread()
def accuracy_answer(scene: Scene, show: ShowProgress = quiet) -> AccuracyAnswer:
    """Return the cheapest settings that have the accuracy which a scene asks for; from the cache if they were chosen before.

    Raises:
        InputError: there is no such figure, it has no value, or an absolute error has another unit.
        ResultsError: no settings are accurate enough.
        BuildError, TrajectoryError: as for `flexfmu.cosim.many.prepared_scene.run_scene`.
    """
    asked = scene.accuracy or {}
    check_figures(scene, asked)
    if scene.has_objects:
        return Chooser(scene, asked, show).answer()
    parts = (
        to_json(about_scene(scene)),
        version("flexfmu"),
        package_fingerprint(),
        Path(__file__).read_text(encoding="utf-8"),
    )
    digest = content_hash(part.encode() for part in parts)
    kind = TypeAdapter(AccuracyAnswer)
    if (known := read_cached(f"{digest}.json")) is not None:
        with suppress(ValidationError):
            return kind.validate_json(known)
    # what an interrupted choice has run already isn't run again
    folder: Path | None = cache_folder() / "accuracy" / digest
    journal = WorkJournal(folder, "choice of settings", {"settings": digest})
    try:
        found = Chooser(scene, asked, show, journal).answer()
        store(f"{digest}.json", kind.dump_json(found))
    except KeyboardInterrupt:
        folder = None
        raise KeyboardInterrupt("the same command continues the choice of settings") from None
    finally:
        if folder is not None:
            journal.remove()
            with suppress(OSError):
                folder.rmdir()
    return found


def with_answer(scene: Scene, answer: AccuracyAnswer) -> Scene:
    """Return the scene with the chosen settings, which asks for nothing more."""
    return scene.replace({**answer.changes, "accuracy": None})


def chosen_over(
    scene: Scene,
    corners: Mapping[str, Scene],
    show: ShowProgress = quiet,
    note: Callable[[str], object] = lambda text: None,
) -> Scene:
    """Return the scene with settings that have the accuracy which it asks for at the corners of a sweep too.

    Args:
        scene: what is swept.
        corners: what a corner changes, in words → its scene.
        show: called with the current activity and the finished fraction.
        note: called with a sentence for each corner at which the settings had to be tightened, or fail.

    Raises:
        As `accuracy_answer`.
    """
    asked, chosen = scene.accuracy or {}, with_answer(scene, accuracy_answer(scene, show))
    for name, corner in corners.items():
        judge = Chooser(corner, asked, show)
        if (missed := judge.missed_by(chosen)) <= 1.0:
            continue
        chosen = _tighter(chosen, with_answer(corner, accuracy_answer(corner, show)))
        after = judge.missed_by(chosen)
        verdict = "tightened" if after <= 1.0 else f"even tightened they miss it {excess(after)}"
        text = "fail" if missed == inf else f"miss the accuracy {excess(missed)}"
        note(f"at {name} the chosen settings {text}: {verdict} to {setting_text(chosen)}")
    return chosen


def _tighter(first: Scene, second: Scene) -> Scene:
    """The first scene with all effects of both, and with the tighter numerics."""
    one, two = first.effects, second.effects
    steps = [each for each in (first.cosimulation.step, second.cosimulation.step) if each is not None]
    integrators = {first.cosimulation.integrator, second.cosimulation.integrator}
    changes: dict[str, Any] = {
        f"effects.{key}": max(getattr(one, key), getattr(two, key)) for key in get_args(FamilyName)
    }
    changes["effects.quasi_static"] = [
        each for each in one.quasi_static if each in two.quasi_static or not getattr(two, each)
    ]
    changes["effects.foreshortening"] = max(one.foreshortening, two.foreshortening, key=THEORIES.index)
    changes["effects.beam"] = "timoshenko" if "timoshenko" in (one.beam, two.beam) else one.beam
    changes["effects.basis"] = "craig-bampton" if "craig-bampton" in (one.basis, two.basis) else one.basis
    integrator = integrators.pop() if len(integrators) == 1 else "gauss4"
    tolerance = min(first.cosimulation.tolerance, second.cosimulation.tolerance)
    return with_numerics(first.replace(changes), min(steps, default=None), integrator, tolerance)
