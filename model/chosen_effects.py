"""Which effects a scene asks for: the one place that knows them all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from flexfmu.model import scene as keys
from flexfmu.model.bases import family_shapes
from flexfmu.model.damping import ModalDamping, ProportionalDamping
from flexfmu.model.drive_effects import (
    CoulombFriction,
    ElasticTransmission,
    MotorInertia,
    StickingFriction,
    ViscousFriction,
)
from flexfmu.model.effects import Effect
from flexfmu.model.elastic_family import ElasticFamily
from flexfmu.model.foreshortening import Foreshortening
from flexfmu.model.link_inertia import LinkInertia
from flexfmu.model.link_properties import LinkProperties
from flexfmu.model.loads import Gravity, PayloadInertia, PointPayload
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.robot import Direction, LinkGroup
from flexfmu.model.rotary_inertia import RotaryInertia, slenderness, thick_beams
from flexfmu.model.scene import Scene
from flexfmu.model.timoshenko import timoshenko_shapes

FAMILIES: tuple[tuple[LinkGroup, Direction], ...] = (
    ("proximal", "axial"),
    ("proximal", "bending"),
    ("distal", "axial"),
    ("distal", "bending"),
)


def chosen_effects(
    scene: Scene, registry: ParameterRegistry, properties: Mapping[LinkGroup, LinkProperties]
) -> list[Effect]:
    """The effects that a scene asks for; what it leaves out isn't constructed."""
    effects: list[Effect] = [LinkInertia(registry, properties), *_link_effects(scene, registry, properties)]
    if scene.payload.mass:
        effects.append(PointPayload(registry, scene.payload.mass))
    if scene.payload.inertia:
        effects.append(PayloadInertia(registry, scene.payload.inertia, properties["distal"].length))
    if any(scene.effects.gravity):
        effects.append(Gravity(registry, scene.effects.gravity))
    effects.extend(_damping(scene.effects.damping, registry))
    effects.extend(_drive_effects(scene.effects, registry))
    return effects


def _damping(chosen: keys.Damping, registry: ParameterRegistry) -> Iterator[Effect]:
    """The structural damping that a scene asks for."""
    if isinstance(chosen, keys.ModalDamping):
        if chosen.ratio:
            yield ModalDamping(registry, chosen.ratio)
        return
    rate, time = getattr(chosen, "rate", 0.0), getattr(chosen, "time", 0.0)
    if rate or time:
        yield ProportionalDamping(registry, rate, time)


def _link_effects(
    scene: Scene, registry: ParameterRegistry, properties: Mapping[LinkGroup, LinkProperties]
) -> Iterator[Effect]:
    """Elasticity of the links, after the beam theory that the scene asks for."""
    chosen, mechanism = scene.effects, scene.mechanism
    thick = thick_beams(registry, properties, mechanism) if chosen.beam == "timoshenko" else {}
    if thick:
        yield RotaryInertia(registry, properties, thick)
    for group, direction in FAMILIES:
        modes: int = getattr(chosen, f"{group}_{direction}")
        if not modes:
            continue
        beam = thick.get(group) if direction == "bending" else None
        shapes = (
            timoshenko_shapes(chosen.basis, group, modes, slenderness(mechanism, group))
            if beam is not None
            else family_shapes(chosen.basis, group, direction, modes)
        )
        static = f"{group}_{direction}" in chosen.quasi_static
        yield ElasticFamily(registry, properties[group], group, direction, shapes, beam, static)
    if chosen.foreshortening and (chosen.proximal_bending or chosen.distal_bending):
        yield Foreshortening(registry, properties)


def _drive_effects(chosen: keys.Effects, registry: ParameterRegistry) -> Iterator[Effect]:
    """The effects of the drives that a scene asks for."""
    friction, transmission = chosen.joint_friction, chosen.transmission
    if chosen.motor_inertia:
        yield MotorInertia(registry, chosen.motor_inertia)
    if friction.viscous:
        yield ViscousFriction(registry, friction.viscous)
    if isinstance(friction, keys.Stiction):
        if friction.holding:
            yield StickingFriction(registry, friction.coulomb, friction.holding, friction.stribeck_velocity)
    elif friction.coulomb:
        yield CoulombFriction(registry, friction.coulomb, friction.velocity)
    if transmission is not None:
        yield ElasticTransmission(registry, transmission.stiffness, transmission.damping)
