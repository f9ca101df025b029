"""Scenes that leave the choice of effects open, resolved along their planned motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from flexfmu.cosim.modes_table import ModalPose, modes_along_path
from flexfmu.cosim.planning import MotionPlan, plan
from flexfmu.model.choice_section import MEASURES, Choice, EstimatedEffect, MeasureName
from flexfmu.model.errors import SceneError
from flexfmu.model.scene import Scene

if TYPE_CHECKING:
    from flexfmu.model.selection.cost import Cost
    from flexfmu.model.selection.estimator import Estimator

TOLERANCE = 0.01
"""Relative error that is asked for where neither scene nor command says one."""

MEASURED: tuple[MeasureName, ...] = ("peak_position_error", "peak_torque_1", "residual_vibration_amplitude")
"""Metrics that are looked at where neither scene nor command names any; the last one needs a dwell."""

POSES = 3
"""Poses of the frequencies: start, middle and end of the path."""

Step = Callable[[str, float | None], None]
"""Told what is being done."""


def quiet(text: str, fraction: float | None) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class EffectRow:
    """One effect, in the set or not.

    Attributes:
        estimate: what it is and what it changes in each metric.
        cost: of the set without it, or with it.
        poses: natural frequencies of that set along the path.
    """

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
        rows: every effect, those in the set first.
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


def resolved(scene: Scene, show: Step = quiet) -> Scene:
    """The scene with its effects chosen, if it says ``select = "auto"``; otherwise the scene as it is.

    The choice is made along the scene's own motion, before any shaping, with motors that follow it exactly.

    Raises:
        TrajectoryError: that motion isn't feasible.
    """
    if scene.effects.select is None:
        return scene
    from flexfmu.model.selection.choose import choose_effects

    tolerance, of = wanted(scene)
    show("choosing the effects", None)
    return choose_effects(scene, plan(scene).joints, tolerance, of)


def wanted(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = ()
) -> tuple[float, tuple[MeasureName, ...]]:
    """Tolerance and metrics of a choice: those given, or the scene's, or the usual ones.

    Raises:
        SceneError: a metric can't be estimated, needs a dwell, or the tolerance is out of range.
    """
    dwells = scene.trajectory.dwell > 0.0
    usual = tuple(name for name in MEASURED if dwells or not name.startswith("residual"))
    names = tuple(_measure(name, dwells) for name in of) or scene.effects.of or usual
    value = tolerance if tolerance is not None else scene.effects.tolerance or TOLERANCE
    if not 0.0 < value <= 10.0:
        raise SceneError(f"the tolerance must be above 0 and at most 10 (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def _measure(name: str, dwells: bool) -> MeasureName:
    for known in MEASURES:
        if name == known and (dwells or not name.startswith("residual")):
            return known
    if name in MEASURES:
        raise SceneError(f"{name} needs a standstill after the motion: give the scene a `trajectory.dwell` above 0 s")
    raise SceneError(f"effects can't be chosen by {name!r}: choose from {', '.join(MEASURES)}")


def study_effects(
    scene: Scene, tolerance: float | None = None, of: tuple[str, ...] = (), show: Step = quiet
) -> EffectStudy:
    """Choose a scene's effects and look at each of them.

    Args:
        scene: any scene; its own choice of elastic effects doesn't matter.
        tolerance, of: as in the scene file; the scene's own, or `TOLERANCE` and `MEASURED`, when not given.
        show: told what is being done.

    Raises:
        SceneError: the tolerance or a metric is impossible.
        TrajectoryError: the motion isn't feasible.
    """
    from flexfmu.model.selection.choose import choose_effects, neighbours
    from flexfmu.model.selection.cost import costs
    from flexfmu.model.selection.estimator import Estimator

    limit, names = wanted(scene, tolerance, of)
    show("choosing the effects", None)
    motion = plan(scene)
    estimator = Estimator(scene, motion.joints, names)
    chosen = choose_effects(scene, motion.joints, limit, names, estimator)
    others = [neighbour.scene for neighbour, _ in neighbours(estimator, chosen)]
    show("timing the equations", None)
    own, *theirs = costs((chosen, *others))
    study = EffectStudy(chosen, estimator, own, _frequencies(motion, chosen), ())
    rows = []
    for index, (other, cost, estimate) in enumerate(zip(others, theirs, study.choice.effects, strict=True)):
        show(f"looking at {estimate.effect}", index / len(others))
        rows.append(EffectRow(estimate, cost, _frequencies(motion, other)))
    return replace(study, rows=tuple(rows))


def _frequencies(motion: MotionPlan, scene: Scene) -> list[ModalPose]:
    return modes_along_path(replace(motion, scene=scene), POSES)
