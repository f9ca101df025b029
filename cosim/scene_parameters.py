"""The values that a scene gives to the parameters of an FMU."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from flexfmu.cosim.errors import InputError
from flexfmu.model.scene import (
    Effects,
    Link,
    MassDamping,
    ModalDamping,
    RayleighDamping,
    Scene,
    Stiction,
    StiffnessDamping,
)


def scene_parameters(scene: Scene) -> dict[str, float]:
    """All parameters that an FMU of any effects may have, named as in the FMU, in SI units.

    What the scene leaves out is zero; the stiffness of a transmission that isn't elastic has no value.
    """
    mechanism, damping = scene.mechanism, scene.effects.damping
    return {
        "base_half_distance": mechanism.base_half_distance,
        **_link("proximal", mechanism.proximal),
        **_link("distal", mechanism.distal),
        "material.density": mechanism.material.density,
        "material.youngs_modulus": mechanism.material.youngs_modulus,
        "material.poissons_ratio": mechanism.material.poissons_ratio,
        "payload.mass": scene.payload.mass,
        "payload.inertia": scene.payload.inertia,
        "gravity.x": scene.effects.gravity[0],
        "gravity.y": scene.effects.gravity[1],
        "damping.ratio": damping.ratio if isinstance(damping, ModalDamping) else 0.0,
        "damping.rate": damping.rate if isinstance(damping, MassDamping | RayleighDamping) else 0.0,
        "damping.time": damping.time if isinstance(damping, StiffnessDamping | RayleighDamping) else 0.0,
        **_drives(scene.effects),
        "start.x": scene.trajectory.start[0],
        "start.y": scene.trajectory.start[1],
    }


EFFECTS = (
    "payload.mass",
    "payload.inertia",
    "gravity.x",
    "gravity.y",
    "damping.ratio",
    "damping.rate",
    "damping.time",
    "motor_inertia",
    "joint_friction.viscous",
    "joint_friction.coulomb",
    "joint_friction.breakaway",
    "joint_friction.stribeck_velocity",
    "transmission.stiffness",
    "transmission.damping",
)
"""Parameters without which an FMU lacks the effect itself; zero switches it off."""

STIFFNESS = "transmission.stiffness"

PERMANENT = {
    STIFFNESS: "elastic transmissions, scene {} has rigid ones",
    "joint_friction.breakaway": "friction that sticks, that of scene {} is smooth",
    "joint_friction.stribeck_velocity": "friction that falls smoothly from breakaway, that of scene {} doesn't",
}
"""Parameters of effects that no number switches off → what the FMU has then, and what the scene has instead."""


def parameters_for(scene: Scene, available: Collection[str]) -> dict[str, float]:
    """The scene's values of those parameters that an FMU has.

    Raises:
        InputError: the scene has an effect that the FMU lacks, or lacks one of the FMU's that no number switches off.
    """
    values = scene_parameters(scene)
    for name in EFFECTS:
        if values.get(name, 0.0) != 0.0 and name not in available:
            raise InputError(
                f"the FMU lacks {name}, which is {values[name]} in scene {scene.name}; build it from this scene"
            )
    for name, sentence in PERMANENT.items():
        if name in available and name not in values:
            raise InputError(f"the FMU has {sentence.format(scene.name)}; build the FMU from this scene")
    return {name: value for name, value in values.items() if name in available}


def scene_with_parameters(scene: Scene, parameters: Mapping[str, float]) -> Scene:
    """The scene whose robot has these values of FMU parameters; those that belong to no robot are left out.

    Raises:
        SceneError: a value is out of range.
    """
    known = scene_parameters(scene)
    changes: dict[str, Any] = {}
    for name, value in parameters.items():
        head = name.partition(".")[0]
        if head == "gravity":
            gravity = changes.setdefault("effects.gravity", list(scene.effects.gravity))
            gravity["xy".index(name[-1])] = value
        elif name in known and head in _SECTIONS:
            changes[_SECTIONS[head] + name] = value
    return scene.replace(changes) if changes else scene


_SECTIONS = {
    "base_half_distance": "mechanism.",
    "proximal": "mechanism.",
    "distal": "mechanism.",
    "material": "mechanism.",
    "payload": "",
    "damping": "effects.",
    "motor_inertia": "effects.",
    "joint_friction": "effects.",
    "transmission": "effects.",
}
"""First part of a parameter's name → section of the scene that holds it."""


def _link(name: str, link: Link) -> dict[str, float]:
    """Parameters of a kind of link."""
    sizes = {"length": link.length, "diameter": link.diameter, "inner_diameter": link.inner_diameter}
    return {f"{name}.{key}": value for key, value in sizes.items()}


def _drives(effects: Effects) -> Mapping[str, float]:
    """Parameters of motors, friction and transmissions."""
    friction, transmission = effects.joint_friction, effects.transmission
    found = {
        "motor_inertia": effects.motor_inertia,
        "joint_friction.viscous": friction.viscous,
        "joint_friction.coulomb": friction.coulomb,
    }
    if isinstance(friction, Stiction):
        found["joint_friction.breakaway"] = friction.holding
        if friction.stribeck_velocity is not None:
            found["joint_friction.stribeck_velocity"] = friction.stribeck_velocity
    else:
        found["joint_friction.velocity"] = friction.velocity
        if not friction.coulomb:
            found["joint_friction.breakaway"] = 0.0
    if transmission is not None:
        found |= {STIFFNESS: transmission.stiffness, "transmission.damping": transmission.damping}
    return found
