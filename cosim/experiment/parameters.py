"""Values of FMU parameters from a scene, and scenes with changed FMU parameters."""

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
"""Parameters of effects that no value switches off → text on the effect of the FMU, and of the scene."""

SMOOTHING = "joint_friction.velocity"
"""The only parameter of an effect that has no influence alone."""

CHOICE_KEYS = ("tolerance", "choice")
"""Keys of `effects` for the choice of effects, which are no parameters of the robot."""


@dataclass(frozen=True)
class SceneValue:
    """Key of a parameter in the scene file (for a component, of the whole vector), and its value."""

    key: str
    value: float


def scene_parameters(scene: Scene) -> dict[str, float]:
    """Values of all parameters that an FMU with any effects may have: name in the FMU → value in SI units.

    Effects that the scene lacks have zeros; the stiffness of a rigid transmission is left out.
    """
    return {name: known.value for name, known in scene_values(scene).items()}


def scene_values(scene: Scene) -> dict[str, SceneValue]:
    """Name of the FMU parameter → key and value in the scene.

    The name is the key without the sections `mechanism` and `effects`; components of vectors end in `.x` and `.y`.
    """
    x, y = scene.start
    found = {
        **dict(_section_values(scene.mechanism, "", "mechanism.")),
        **dict(_section_values(scene.payload, "payload.", "payload.")),
        **dict(_section_values(scene.effects, "", "effects.")),
        "start.x": SceneValue("trajectory.start", x),
        "start.y": SceneValue("trajectory.start", y),
    }
    # kinds of damping that the scene lacks are zero
    for key in ("ratio", "rate", "time"):
        found.setdefault(f"damping.{key}", SceneValue(f"effects.damping.{key}", 0.0))
    # the breakaway torque is by default the Coulomb torque; without friction it is zero
    friction, breakaway = scene.effects.joint_friction, "joint_friction.breakaway"
    if isinstance(friction, StictionSection):
        found[breakaway] = SceneValue(f"effects.{breakaway}", friction.holding)
    elif not friction.coulomb:
        found[breakaway] = SceneValue(f"effects.{breakaway}", 0.0)
    return found


def _section_values(section: Section, name: str, key: str) -> Iterator[tuple[str, SceneValue]]:
    """Yield the values of a section and its subsections; `name` and `key` are prefixes."""
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
    """The scene's values of the parameters in ``available``, those of the FMU.

    Raises:
        InputError: the FMU lacks an effect of the scene, or has an effect that the scene lacks and no value switches off.
    """
    known = scene_values(scene)
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


def scene_changes(scene: Scene, parameters: Mapping[str, float]) -> dict[str, Any]:
    """Key of the scene → value by these values of FMU parameters; the start point and parameters unknown to scenes are ignored."""
    known = scene_values(scene)
    changes: dict[str, Any] = {}
    for name, value in parameters.items():
        if name not in known or name.startswith("start."):
            continue
        key = known[name].key
        # a component replaces its vector
        if name.endswith((".x", ".y")):
            vector = changes.setdefault(key, [known[f"{name[:-1]}{axis}"].value for axis in "xy"])
            vector["xy".index(name[-1])] = value
        else:
            changes[key] = value
    return changes


def scene_with_parameters(scene: Scene, parameters: Mapping[str, float]) -> Scene:
    """The scene with the values of `scene_changes`.

    Raises:
        SceneError: a value is out of range.
    """
    return scene.replace(changes) if (changes := scene_changes(scene, parameters)) else scene


def holding_torques(scene: Scene) -> Mapping[str, float]:
    """Torques [N.m] by input name that hold the start pose statically; empty for a scene driven by motion."""
    if scene.cosimulation.drive != "torque":
        return {}
    from flexfmu.model.statics import static_equilibrium

    torque = static_equilibrium(scene, motor_angles(scene.mechanism, scene.start)).torque
    return {f"joint{joint}.torque": float(value) for joint, value in enumerate(torque, start=1)}
