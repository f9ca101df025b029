"""Builds the FMU of a scene, with a cache key from the parts of the scene that determine it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from flexfmu.cosim.engine.shared_library import library_file
from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.fmu_build.build import BuildProgress, BuiltFmu, build_fmu
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.naming import Naming
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.model.scene.disturbances import disturbance_inputs
from flexfmu.model.scene.motion import TrajectorySection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel

_TIME_KEYS = {"duration", "dwell", "way_back", "cycles", "pause"}
_PATH_KEYS = {"kind", "lift", "height", "width", "blend", "profile", "degree", "noise", "references", *_TIME_KEYS}
_START_KEYS = {"file", "coordinates"}
"""Keys of the motion that the model knows by the start point alone."""
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
_LOOP = dict.fromkeys(
    ("controller", "shaper", "imperfection", "filter", "disturbance", "motor", "plan", "accuracy"), True
)
_WITHOUT_INFLUENCE: Any = {"trajectory": _PATH_KEYS, "cosimulation": _RUN_KEYS, **_LOOP}
"""Keys of the scene without influence on the model; all other keys but the strength belong to the cache key."""
_STRENGTH = "mechanism.material.yield_strength"
_NO_STRENGTH: Any = {"mechanism": {"material": {"yield_strength"}}}


def scene_key(scene: Scene) -> str:
    """Text that determines the scene's model: the scene as JSON without the keys that have no influence."""
    # the robot has inputs for disturbances, whatever their values
    inputs = disturbance_inputs(scene.disturbance)
    start = f" disturbed in {', '.join(inputs)}" if inputs else ""
    if isinstance(scene.trajectory, TrajectorySection):
        return scene.model_dump_json(exclude=_WITHOUT_INFLUENCE | _NO_STRENGTH) + start
    start += f" from {scene.start}"
    return (
        scene.model_dump_json(exclude={**_WITHOUT_INFLUENCE, **_NO_STRENGTH, "trajectory": _PATH_KEYS | _START_KEYS})
        + start
    )


def shared_key(scene: Scene) -> str:
    """Text that determines the scene's model but for the values of its parameters, which a run sets: whether each is zero.

    The shapes of Timoshenko's beams are calculated from the mechanism's values, which are numbers in the equations; they count there.
    """
    zeros = {name: known.value == 0.0 for name, known in scene_values(scene).items()}
    without: dict[str, Any] = {} if scene.effects.beam == "timoshenko" else {"mechanism": True}
    kept = scene.model_dump(mode="json", exclude={**_WITHOUT_INFLUENCE, **without, "trajectory": True})
    modes = scene.mechanism.working_mode, scene.mechanism.assembly_mode
    kept |= {name: _without_numbers(kept[name]) for name in ("payload", "effects")}
    return f"shared {json.dumps(kept)} {modes} {zeros} disturbed in {disturbance_inputs(scene.disturbance)}"


def _without_numbers(section: Any) -> Any:
    """A section without its values of parameters, which are floats."""
    if isinstance(section, dict):
        return {key: _without_numbers(value) for key, value in section.items()}
    if isinstance(section, list) and all(isinstance(each, float) for each in section):
        return len(section)
    return None if isinstance(section, float) else section


def depends_on(key: str) -> bool:
    """Whether the model may depend on a dotted key of the scene, or on a part of what it names."""
    section, _, rest = key.partition(".")
    if section.startswith("disturbance"):
        # which disturbances there are determines the inputs of the robot, their values don't
        return rest.rpartition(".")[2] in ("", "kind", "signal") or rest.isdigit()
    influenceless = _WITHOUT_INFLUENCE.get(section.partition("[")[0])
    return (
        key != _STRENGTH
        and influenceless is not True
        and (influenceless is None or rest.partition(".")[0] not in influenceless)
    )


def build_scene(
    scene: Scene,
    *,
    output: Path | None = None,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    enumerations: bool = False,
    fmi: FmiVersion | Literal[2, 3] = "2",
    cache: bool = True,
    shared: bool = False,
    progress: BuildProgress = lambda message: None,
) -> BuiltFmu:
    """Build the FMU of ``scene``, or take it from the cache without importing CasADi.

    The default experiment has the scene's communication step and tolerance, over motion and dwell.

    Args:
        scene: the scene.
        output, platforms, naming, enumerations, fmi, cache, progress: as for `flexfmu.fmu_build.build.build_fmu`.
        shared: whether the FMU may be that of another scene with other values of its parameters and another motion, for runs that
            set all of them; its start values and default experiment are those of the first such scene, or usual ones.

    Raises:
        BuildError: as for `build_fmu`.
        SceneError: there is no plant for the scene.
    """

    def make_model() -> SymbolicModel:
        from flexfmu.model.plants import build_model

        return build_model(scene)

    # end of motion and dwell, rounded: 0.43 + 0.25 = 0.68
    stop_time = float(f"{scene.trajectory.moving_time + scene.trajectory.dwell:.12g}")
    section, usual = scene.cosimulation, DefaultExperiment()
    own = DefaultExperiment(stop_time, section.communication_step, section.tolerance)
    experiment = usual if shared else own
    built = build_fmu(
        make_model,
        key=shared_key(scene) if shared else scene_key(scene),
        output=output,
        platforms=platforms,
        step=experiment.step,
        tolerance=experiment.tolerance,
        stop_time=experiment.stop_time,
        naming=naming,
        enumerations=enumerations,
        fmi=fmi,
        cache=cache,
        progress=progress,
    )
    if not built.cached:
        # a run with the FMU from the cache shall need no compiler
        for name in ("master", "metrics"):
            library_file(name)
    return built
