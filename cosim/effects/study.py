"""A choice of effects with everything that was looked at: what each effect is worth, what it costs, and frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from flexfmu.cosim.effects.choice import Step, asked, quiet, wanted
from flexfmu.cosim.effects.verified import choose_verified
from flexfmu.cosim.modes_table import ModalPose, modes_along_path
from flexfmu.cosim.planning import MotionPlan, plan
from flexfmu.model.choice_section import Choice, EstimatedEffect, integrator_tolerance
from flexfmu.model.scene import Scene
from flexfmu.model.selection.choose import neighbours
from flexfmu.model.selection.cost import Cost, costs
from flexfmu.model.selection.estimator import Estimator
from flexfmu.model.selection.given import given_effects

POSES = 3
"""Poses of the frequencies: start, middle and end of the path."""

Place = Literal["in", "out", "given"]
"""Where an effect is: in the chosen set or out of it, or given by the robot and not a matter of choice."""


@dataclass(frozen=True)
class EffectRow:
    """One effect, in the set or not, or given by the robot.

    Attributes:
        place: where it is.
        estimate: what it is and what it changes in each metric.
        cost: of the set without it, or with it.
        poses: natural frequencies of that set along the path.
    """

    place: Place
    estimate: EstimatedEffect
    cost: Cost
    poses: list[ModalPose]


@dataclass(frozen=True)
class EffectStudy:
    """A choice of effects with everything that was looked at.

    Attributes:
        scene: with the chosen set; ``scene.effects.choice`` says what was estimated.
        estimator: for further sets.
        cost: of the chosen set.
        poses: its natural frequencies along the path.
        rows: every effect, those in the set first, those that the robot gives last.
    """

    scene: Scene
    estimator: Estimator
    cost: Cost
    poses: list[ModalPose]
    rows: tuple[EffectRow, ...]

    @property
    def choice(self) -> Choice:
        """How the effects were chosen: tolerance, metrics, estimated errors and contributions."""
        choice = self.scene.effects.choice
        assert choice is not None  # that is what `choose_effects` gives
        return choice


def study_effects(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = (), show: Step = quiet
) -> EffectStudy:
    """Choose a scene's effects and look at each of them.

    Args:
        scene: any scene; its own choice of elastic effects doesn't matter.
        tolerance, of: as in the scene file; the scene's own, or `flexfmu.cosim.effects.choice.TOLERANCE` and ``MEASURED`` there.
        show: told what is being done.

    Raises:
        BuildError, ResultsError: as for `resolved`.
        SceneError: the tolerance or a metric is impossible.
        TrajectoryError: the motion isn't feasible.
    """
    limit, names = wanted(scene, tolerance, of)
    stated = scene.effects.tolerance
    if stated is None or scene.cosimulation.tolerance == integrator_tolerance(stated):
        # the integrator's tolerance belongs to other effects, or to none
        scene = scene.replace({"cosimulation.tolerance": integrator_tolerance(limit)})
    motion = plan(scene)
    chosen, estimator = choose_verified(scene, motion.joints, limit, names, asked(scene, of), show)
    show("looking at what the robot gives", None)
    found = _changes(estimator, chosen, motion)
    show("timing the equations", None)
    own, *theirs = costs((chosen, *(other for _, other, _ in found)))
    rows: list[EffectRow] = []
    for (place, other, estimate), cost in zip(found, theirs, strict=True):
        show(f"frequencies: {estimate.effect}", len(rows) / len(found))
        rows.append(EffectRow(place, estimate, cost, _frequencies(motion, other)))
    return EffectStudy(chosen, estimator, own, _frequencies(motion, chosen), tuple(rows))


def _changes(
    estimator: Estimator, chosen: Scene, motion: MotionPlan
) -> tuple[tuple[Place, Scene, EstimatedEffect], ...]:
    """All single changes of a chosen set, and of what the robot gives."""
    assert chosen.effects.choice is not None  # that is what `choose_effects` gives
    elastic = zip(neighbours(estimator, chosen), chosen.effects.choice.effects, strict=True)
    given = given_effects(estimator, chosen, motion.joints)
    return (
        *(("in" if estimate.chosen else "out", each.scene, estimate) for (each, _), estimate in elastic),
        *(("given", each.scene, estimate) for each, estimate in given),
    )


def _frequencies(motion: MotionPlan, scene: Scene) -> list[ModalPose]:
    return modes_along_path(replace(motion, scene=scene), POSES)
