"""Scenes that leave the choice of effects open, resolved along their planned motion."""

from __future__ import annotations

from collections.abc import Callable

from flexfmu.cosim.planning import plan
from flexfmu.model.choice_section import LARGEST, MEASURES, SMALLEST, MeasureName
from flexfmu.model.errors import SceneError
from flexfmu.model.scene import Scene

TOLERANCE = 0.01
"""Relative error that is asked for where neither scene nor command says one."""

MEASURED: tuple[MeasureName, ...] = ("peak_position_error", "peak_torque_1", "residual_vibration_amplitude")
"""Metrics that are looked at where neither scene nor command names any; the last one needs a dwell."""

Step = Callable[[str, float | None], None]
"""Told what is being done."""


def quiet(text: str, fraction: float | None) -> None:
    """Say nothing."""


def resolved(scene: Scene, show: Step = quiet) -> Scene:
    """The scene with its effects chosen, if it says ``select = "auto"``; otherwise the scene as it is.

    The choice is made along the scene's own motion, before any shaping, with motors that follow it exactly.

    Raises:
        BuildError: an FMU that the choice is verified by can't be built.
        ResultsError: its run failed.
        TrajectoryError: that motion isn't feasible.
    """
    if scene.effects.select is None:
        return scene
    from flexfmu.cosim.effects.verified import choose_verified

    tolerance, of = wanted(scene)
    return choose_verified(scene, plan(scene).joints, tolerance, of, asked(scene), show)[0]


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
    if not SMALLEST <= value <= LARGEST:
        raise SceneError(f"the tolerance must be between {SMALLEST:g} and {LARGEST:g} (relative error), got {value:g}")
    return value, tuple(dict.fromkeys(names))


def asked(scene: Scene, of: tuple[str, ...] = ()) -> tuple[MeasureName, ...]:
    """The metrics that the user has named: those given, or the scene's; none where they are the usual ones."""
    return wanted(scene, of=of)[1] if of or scene.effects.of else ()


def _measure(name: str, dwells: bool) -> MeasureName:
    for known in MEASURES:
        if name == known and (dwells or not name.startswith("residual")):
            return known
    if name in MEASURES:
        raise SceneError(f"{name} needs a standstill after the motion: give the scene a `trajectory.dwell` above 0 s")
    raise SceneError(f"effects can't be chosen by {name!r}: choose from {', '.join(MEASURES)}")
