"""The values that a scene gives to the parameters of an FMU."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.effects import StictionSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.scene.section import Section

PERMANENT = {
    "transmission.stiffness": "elastic transmissions, scene {} has rigid ones",
    "joint_friction.breakaway": "friction that sticks, that of scene {} is smooth",
    "joint_friction.stribeck_velocity": "friction that falls smoothly from breakaway, that of scene {} doesn't",
}
"""Parameters of effects that no number switches off → what the FMU has then, and what the scene has instead."""

SMOOTHING = "joint_friction.velocity"
"""The only parameter of an effect that makes no effect by itself."""

CHOICE_KEYS = ("tolerance", "choice")
"""Keys of `effects` that are about the choice of effects, not about the robot."""


@dataclass(frozen=True)
class SceneValue:
    """A parameter's key in the scene file (of the whole vector for a component) and its value."""

    key: str
    value: float


def scene_parameters(scene: Scene) -> dict[str, float]:
    """All parameters that an FMU of any effects may have, named as in the FMU, in SI units.

    What the scene leaves out is zero; the stiffness of a transmission that isn't elastic has no value.
    """
    return {name: known.value for name, known in _scene_values(scene).items()}


def _scene_values(scene: Scene) -> dict[str, SceneValue]:
    """Parameters of FMUs with the scene's keys and values.

    A parameter is named like its key, without the sections `mechanism` and `effects`; `.x` and `.y` are a vector's components.
    """
    x, y = scene.trajectory.start
    found = {
        **dict(_section_values(scene.mechanism, "", "mechanism.")),
        **dict(_section_values(scene.payload, "payload.", "payload.")),
        **dict(_section_values(scene.effects, "", "effects.")),
        "start.x": SceneValue("trajectory.start", x),
        "start.y": SceneValue("trajectory.start", y),
    }
    # kinds of damping that the scene doesn't have are zero
    for key in ("ratio", "rate", "time"):
        found.setdefault(f"damping.{key}", SceneValue(f"effects.damping.{key}", 0.0))
    # a breakaway torque holds by default what Coulomb friction does; no friction is one of zero
    friction, breakaway = scene.effects.joint_friction, "joint_friction.breakaway"
    if isinstance(friction, StictionSection):
        found[breakaway] = SceneValue(f"effects.{breakaway}", friction.holding)
    elif not friction.coulomb:
        found[breakaway] = SceneValue(f"effects.{breakaway}", 0.0)
    return found


def _section_values(section: Section, name: str, key: str) -> Iterator[tuple[str, SceneValue]]:
    """The quantities of a section and of those in it; `name` and `key` are what stands before theirs."""
    for field in type(section).model_fields:
        value = getattr(section, field)
        if field in CHOICE_KEYS:
            continue
        if isinstance(value, Section):
            yield from _section_values(value, f"{name}{field}.", f"{key}{field}.")
        elif isinstance(value, float):
            yield f"{name}{field}", SceneValue(f"{key}{field}", value)
        elif isinstance(value, tuple) and all(isinstance(component, float) for component in value):
            for axis, component in zip("xy", value, strict=False):
                yield f"{name}{field}.{axis}", SceneValue(f"{key}{field}", component)


def parameters_for(scene: Scene, available: Collection[str]) -> dict[str, float]:
    """The scene's values of those parameters that an FMU has.

    Raises:
        InputError: the scene has an effect that the FMU lacks, or lacks one of the FMU's that no number switches off.
    """
    known = _scene_values(scene)
    # an effect of the scene that the FMU lacks
    for name, each in known.items():
        is_effect = each.key.startswith(("payload.", "effects.")) and name != SMOOTHING
        if is_effect and each.value != 0.0 and name not in available:
            raise InputError(
                f"the FMU lacks {name}, which is {each.value} in scene {scene.name}; build it from this scene"
            )
    # an effect of the FMU that the scene lacks
    for name, sentence in PERMANENT.items():
        if name in available and name not in known:
            raise InputError(f"the FMU has {sentence.format(scene.name)}; build the FMU from this scene")
    return {name: each.value for name, each in known.items() if name in available}


def scene_with_parameters(scene: Scene, parameters: Mapping[str, float]) -> Scene:
    """The scene whose robot has these values of FMU parameters; those that belong to no robot are left out.

    Raises:
        SceneError: a value is out of range.
    """
    known = _scene_values(scene)
    changes: dict[str, Any] = {}
    for name, value in parameters.items():
        if name not in known or name.startswith("start."):
            continue
        key = known[name].key
        # components change their whole vector
        if name.endswith((".x", ".y")):
            vector = changes.setdefault(key, [known[f"{name[:-1]}{axis}"].value for axis in "xy"])
            vector["xy".index(name[-1])] = value
        else:
            changes[key] = value
    return scene.replace(changes) if changes else scene


def holding_torques(scene: Scene) -> Mapping[str, float]:
    """Torques that hold the start pose of a scene that is driven by torques; nothing for one driven by motion."""
    if scene.cosimulation.drive != "torque":
        return {}
    from flexfmu.model.statics import static_equilibrium

    torque = static_equilibrium(scene, motor_angles(scene.mechanism, scene.trajectory.start)).torque
    return {f"joint{joint}.torque": float(value) for joint, value in enumerate(torque, start=1)}
