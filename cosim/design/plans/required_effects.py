"""Which effects a plan requires beyond those of the scene's model, and whether a motion leaves no vibration with them too.

A motion at the edge of its bands leaves up to 3 µm more for each percent by which a frequency is lower: an effect that moves one of
the lowest frequencies is required, whatever it changes else is small against what vibrates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge
from flexfmu.cosim.design.plans.goals import Goals
from flexfmu.cosim.design.plans.robustness import RICHER, frozen, in_robot, judge_of
from flexfmu.cosim.engine.errors import CosimError
from flexfmu.model.modes import natural_frequencies
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.trajectories.errors import TrajectoryError

SHIFT = 1e-3
"""Relative change of a frequency from which on an effect is required: about 0.3 µm."""

LOWEST = 2
"""Number of the lowest frequencies: others carry too little."""

WORTH, NEAR = 0.03, 6
"""Relative increase of what is minimised for which a motion that leaves no vibration with these effects is taken instead, and
largest number of motions that are tried."""


def required_effects(goals: Goals) -> Mapping[str, Any]:
    """Keys of the effects that a plan requires beyond the scene's, by frequencies at the end of the motion with the lightest payload.

    Raises:
        EquilibriumError: the robot has no static equilibrium there.
    """
    scene = goals.scene.replace({"payload.mass": goals.band[0]})
    end = goals.given.once.joints.evaluate([goals.given.once.duration], 0, "left")[0, 0]
    own = natural_frequencies(scene, end)[:LOWEST]
    found: dict[str, Any] = {}
    for changes in RICHER.values() if own.size else ():
        other = natural_frequencies(scene.replace({**changes}), end)[:LOWEST]
        if np.abs(other / own - 1.0).max() > SHIFT:
            found |= changes
    return found


class FullerModel:
    """The robot with the effects that a plan requires.

    Args:
        goals: what is planned.
    """

    def __init__(self, goals: Goals) -> None:
        self._goals = goals

    @cached_property
    def effects(self) -> Mapping[str, Any]:
        """Keys of these effects; none if the scene's model has all that matter."""
        return required_effects(self._goals)

    @cached_property
    def _judge(self) -> Judge:
        return judge_of(self._goals, self.effects)

    def residual(self, candidate: Candidate) -> float:
        """Worst residual vibration of the candidate's joint references [m]; 0 without further effects.

        Raises:
            CosimError, SceneError, TrajectoryError, EquilibriumError: the robot or the motion can't be run.
        """
        if not self.effects:
            return 0.0
        judge = self._judge
        return judge.assess(in_robot(frozen(candidate), judge.goals.scene)).residual


def most_robust(chosen: Assessment, ranked: Sequence[Assessment], judge: Judge) -> tuple[Assessment, str]:
    """The chosen motion, or one that is hardly worse but leaves no vibration with the effects that the plan requires.

    Args:
        chosen: the best motion.
        ranked: all motions, the best first.
        judge: judges the motion that is taken instead.

    Returns:
        The motion, and what there is to say; an empty text if it leaves no vibration.
    """
    if not chosen.feasible or chosen.candidate.method == "given":
        return chosen, ""
    goals, label = judge.goals, chosen.candidate.label
    aim, fuller = goals.wishes.minimise, FullerModel(goals)
    near = [
        each
        for each in ranked
        if each.feasible and each.candidate.method != "given" and each.candidate is not chosen.candidate
        and each.objective[aim] <= (1.0 + WORTH) * chosen.objective[aim]
    ]  # fmt: skip
    try:
        residual = fuller.residual(chosen.candidate)
        if residual <= goals.wishes.residual:
            return chosen, ""
        # motions that are nearly as good
        for each in near[:NEAR]:
            if fuller.residual(each.candidate) <= goals.wishes.residual:
                judged = judge.assess(each.candidate)
                if judged.feasible:
                    return judged, ""
    except (CosimError, SceneError, TrajectoryError, EquilibriumError) as error:
        return chosen, f"{label}, with further effects: {error}"
    return chosen, (
        f"{label} leaves {1e6 * residual:.3g} µm with {', '.join(sorted(fuller.effects))}, which matter here: plan with them in "
        f"the scene, or with a `stiffness_band`"
    )
