"""The five-bar of a scene as a sum of effects, assembled once: what plants, statics and modes have in common."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi

from flexfmu.model.chosen_effects import chosen_effects
from flexfmu.model.closure import Closure, IndependentMotion, ProjectedForces
from flexfmu.model.dynamics import RedundantDynamics, derive_dynamics
from flexfmu.model.effects import Output, Stiction
from flexfmu.model.errors import SceneError
from flexfmu.model.link_properties import LinkProperties, link_properties
from flexfmu.model.parameters import ParameterRegistry
from flexfmu.model.quasi_static import Partition, static_deflections
from flexfmu.model.robot import LinkGroup, Robot, make_robot
from flexfmu.model.scene import Mechanism, Scene
from flexfmu.model.symbolic import EffectNote, Variable

POSITIVE = 1e-9
"""Smallest admissible value of a length, density or modulus in its SI unit."""


@dataclass(frozen=True)
class FiveBar:
    """A scene's mechanism in symbols.

    Attributes:
        robot: symbols of the redundant coordinates.
        registry: parameters and derived values.
        dynamics: equations of motion in redundant coordinates.
        motion: symbols of the independent motion, whose elastic coordinates are the states.
        partition: which elastic coordinates are states, and which deflect statically.
        closure: the assembled motion as expressions of the independent one, without static deflections.
        redundant_force: generalised forces that the motion needs in redundant coordinates, (10 + n, 1).
        forces: the same, projected: motor torques, forces on the states (zero in a free motion), joint reactions.
        elastic: all elastic coordinates (n, 1), static deflections under these forces included.
        position: end effector (2, 1) [m] with these elastic coordinates.
        outputs: watched scalars of the effects.
        stiction: dry friction that can hold motor 1 and motor 2; empty where there is none.
        notes: what the documentation says of each effect.
    """

    robot: Robot
    registry: ParameterRegistry
    dynamics: RedundantDynamics
    motion: IndependentMotion
    partition: Partition
    closure: Closure
    redundant_force: casadi.SX
    forces: ProjectedForces
    elastic: casadi.SX
    position: casadi.SX
    outputs: tuple[Output, ...]
    stiction: tuple[Stiction, ...]
    notes: tuple[EffectNote, ...]

    def with_forces(self, redundant_force: casadi.SX) -> FiveBar:
        """The same robot under other forces, (10 + n, 1) in redundant coordinates."""
        forces, elastic, position = _respond(self.robot, self.partition, self.closure, redundant_force)
        return replace(self, redundant_force=redundant_force, forces=forces, elastic=elastic, position=position)


def assemble(scene: Scene) -> FiveBar:
    """Put the chosen effects of a scene together.

    Raises:
        SceneError: the scene leaves the choice of effects open.
    """
    if scene.effects.select is not None:
        raise SceneError(
            f"scene {scene.name} leaves the choice of effects open (`effects.select`): resolve it first, with "
            f"`flexfmu.cosim.effects.choice.resolved(scene)`"
        )
    registry = ParameterRegistry()
    parameters = _mechanism_parameters(registry, scene.mechanism)
    properties: dict[LinkGroup, LinkProperties] = {
        group: link_properties(registry, group, parameters) for group in ("proximal", "distal")
    }
    effects = chosen_effects(scene, registry, properties)
    families = [family for effect in effects for family in effect.families()]
    twists = any(effect.twists_joints() for effect in effects)
    shortening = {
        family.group: matrix
        for effect in effects
        for family in families
        if (matrix := effect.shortening(family)) is not None
    }
    base = registry.derived("base_half_distance", parameters["base_half_distance"])
    robot = make_robot(families, base, twists, shortening)
    outputs = tuple(output for effect in effects for output in effect.outputs(robot))
    dynamics = derive_dynamics(robot, effects, registry)
    partition = Partition.of(robot)
    motion = _independent_motion(robot, partition)
    everything = replace(motion, **{name: partition.fill(getattr(motion, name)) for name in ("q_e", "v_e", "a_e")})
    side = 1 if scene.mechanism.assembly_mode == "left" else -1
    closure = Closure(robot, everything, (properties["proximal"].length, properties["distal"].length), side)
    force = dynamics.force(*closure.redundant().arguments(), registry.d)
    forces, elastic, position = _respond(robot, partition, closure, force)
    return FiveBar(
        robot=robot,
        registry=registry,
        dynamics=dynamics,
        motion=motion,
        partition=partition,
        closure=closure,
        redundant_force=force,
        forces=forces,
        elastic=elastic,
        position=position,
        outputs=outputs,
        stiction=tuple(friction for effect in effects for friction in effect.stiction()),
        notes=tuple(effect.note() for effect in effects),
    )


def _respond(
    robot: Robot, partition: Partition, closure: Closure, force: casadi.SX
) -> tuple[ProjectedForces, casadi.SX, casadi.SX]:
    """Forces on the states, elastic coordinates with static deflections, and where these put the end effector."""
    forces = closure.project(force)
    if not partition.statics:
        return forces, robot.q_e, closure.position
    deflections = static_deflections(robot, forces.elastic)
    elastic = partition.fill(partition.states_of(robot.q_e), deflections)
    return replace(forces, elastic=partition.states_of(forces.elastic)), elastic, closure.position_at(elastic)


def _independent_motion(robot: Robot, partition: Partition) -> IndependentMotion:
    q_a, v_a, a_a = (casadi.SX.sym(name, 2) for name in ("q_a", "v_a", "a_a"))
    q_e, v_e = partition.states_of(robot.q_e), partition.states_of(robot.v_e)
    return IndependentMotion(q_a, v_a, a_a, q_e, v_e, casadi.SX.sym("a_e", q_e.numel()))


def _mechanism_parameters(registry: ParameterRegistry, mechanism: Mechanism) -> dict[str, casadi.SX]:
    """The parameters that every scene has: lengths, diameters and material."""
    variables = [
        _positive(
            "base_half_distance", "m", "Half of the distance between the bases", mechanism.base_half_distance, 1e3
        )
    ]
    for group, link in (("proximal", mechanism.proximal), ("distal", mechanism.distal)):
        variables += [
            _positive(f"{group}.length", "m", f"Length of the {group} links", link.length, 1e3),
            _positive(f"{group}.diameter", "m", f"Outer diameter of the {group} links", link.diameter, 1e2),
            Variable(
                f"{group}.inner_diameter",
                "m",
                f"Inner diameter of the {group} links, 0 for solid rods",
                "parameter",
                start=link.inner_diameter,
                minimum=0.0,
                maximum=1e2,
            ),
        ]
    variables += [
        _positive("material.density", "kg/m3", "Density of the links", mechanism.material.density, 1e6),
        _positive(
            "material.youngs_modulus", "Pa", "Young's modulus of the links", mechanism.material.youngs_modulus, 1e15
        ),
    ]
    return {variable.name: registry.parameter(variable) for variable in variables}


def _positive(name: str, unit: str, description: str, start: float, maximum: float) -> Variable:
    """A parameter that must be above zero; FMI knows closed ranges only, so the minimum is tiny instead."""
    return Variable(name, unit, description, "parameter", start=start, minimum=POSITIVE, maximum=maximum)
