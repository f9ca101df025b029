"""The FMU of a scene, and which parts of the scene determine it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexfmu.fmu_build.build import BuildProgress, BuiltFmu, build_fmu

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming
    from flexfmu.model.scene.schema import Scene
    from flexfmu.model.symbolic import SymbolicModel

_PATH_KEYS = {"lift", "height", "width", "blend", "profile", "duration", "dwell"}
_RUN_KEYS = {
    "step",
    "tolerance",
    "settling_band",
    "integrator",
    "integrator_step",
    "algorithm",
    "step_control",
    "loop_solver",
}
_LOOP = dict.fromkeys(("controller", "shaper", "imperfection"), True)
_WITHOUT_INFLUENCE: Any = {"trajectory": _PATH_KEYS, "cosimulation": _RUN_KEYS, **_LOOP}
"""Keys of the scene that the model never sees; whatever is not listed here counts."""


def scene_key(scene: Scene) -> str:
    """All of the scene that determines its model, as text."""
    return scene.model_dump_json(exclude=_WITHOUT_INFLUENCE)


def build_scene(
    scene: Scene,
    *,
    output: Path | None = None,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
    cache: bool = True,
    progress: BuildProgress = lambda message: None,
) -> BuiltFmu:
    """Build the FMU of ``scene``, or take it from the cache without ever loading CasADi.

    The default experiment is the scene's own: its communication step, its tolerance, motion and dwell.

    Args:
        scene: what to build.
        output, platforms, naming, enumerations, cache, progress: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        BuildError: as for `build_fmu`.
        SceneError: the scene asks for a plant that doesn't exist.
    """

    def make_model() -> SymbolicModel:
        from flexfmu.model.plants import build_model

        return build_model(scene)

    # end of motion and dwell without the sum's rounding: 0.43 and 0.25 make 0.68
    stop_time = float(f"{scene.trajectory.duration + scene.trajectory.dwell:.12g}")
    return build_fmu(
        make_model,
        key=scene_key(scene),
        output=output,
        platforms=platforms,
        step=scene.cosimulation.step,
        tolerance=scene.cosimulation.tolerance,
        stop_time=stop_time,
        naming=naming,
        enumerations=enumerations,
        cache=cache,
        progress=progress,
    )
