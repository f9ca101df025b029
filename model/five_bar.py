"""The five-bar of a scene as a sum of effects, the common base of plants, statics and modes.

Quasi-static families have no states and no inertia of their own: they deflect statically under the present loads. The
loads f on such a family follow from the motion of all other coordinates with the family undeformed; the deflection is q
= -K^-1 f. It displaces the end effector and enters the effects' outputs, but doesn't act back on the other coordinates:
this is the static correction of the mode acceleration method. Its relative error is of the order of (frequency of the
motion / natural frequency of the family)².

Sources: Craig and Kurdila, Fundamentals of Structural Dynamics (2006), section 11.4; Dickens, Nakagawa and Wittbrodt, A
critique of mode acceleration and modal truncation augmentation methods for modal response analysis, Computers &
Structures 62 (1997).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module

import casadi

from flexfmu.model.beams import LinkGroup
from flexfmu.model.closure import Closure, IndependentMotion, ProjectedForces
from flexfmu.model.dynamics import RedundantDynamics, derive_dynamics
from flexfmu.model.effects import Effect, EffectContext, Output, Stiction
from flexfmu.model.parameters import LinkProperties, ParameterRegistry, link_properties, mechanism_parameters
from flexfmu.model.robot import Robot, make_robot
from flexfmu.model.scene.effects import EFFECTS
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import EffectNote


@dataclass(frozen=True)
class Partition:
    """Indices in q_e (n,) of the coordinates that are states, and of those that deflect statically."""

    states: tuple[int, ...]
    statics: tuple[int, ...]

    @staticmethod
    def of(robot: Robot) -> Partition:
        flags = [part.family.quasi_static for _, part in robot.elastic for _ in part.family.shapes]
        flags += [False] * robot.twist.numel()
        indices = range(len(flags))
        return Partition(tuple(i for i in indices if not flags[i]), tuple(i for i in indices if flags[i]))

    def states_of(self, values: casadi.SX) -> casadi.SX:
        """The entries (n_states, 1) of `values` (n, 1) that belong to states."""
        return values[list(self.states)] if self.statics else values

    def fill(self, states: casadi.SX, statics: casadi.SX | None = None) -> casadi.SX:
        """Values (n, 1) from those of the states and of the static coordinates, which are zero by default."""
        if not self.statics:
            return states
        values = casadi.SX(len(self.states) + len(self.statics), 1)
        if self.states:
            values[list(self.states)] = states
        if statics is not None:
            values[list(self.statics)] = statics
        return values


@dataclass(frozen=True)
class FiveBar:
    """A scene's mechanism in symbols.

    Attributes:
        robot: symbols of the redundant coordinates.
        registry: parameters and derived values.
        links: properties of the link groups.
        dynamics: equations of motion in redundant coordinates.
        motion: symbols of the independent motion; its elastic coordinates are the states.
        partition: which elastic coordinates are states, and which deflect statically.
        closure: motion of the assembled robot as expressions of the independent motion, without static deflections.
        redundant_force: generalised forces that the motion needs, in redundant coordinates (10 + n, 1).
        forces: their projection: motor torques, forces on the states (zero by the equations of motion), reactions.
        elastic: all elastic coordinates (n, 1), static deflections under these forces included.
        position: end effector (2, 1) [m] with these elastic coordinates.
        end_effector_mass: mass that moves with the end effector, of all effects [kg].
        joint_stiffness: stiffness of each transmission [N m/rad]; None where they are rigid.
        outputs: outputs of the effects.
        stiction: dry friction that can hold motor 1 and motor 2; empty where there is none.
        notes: documentation of each effect.
    """

    robot: Robot
    registry: ParameterRegistry
    links: Mapping[LinkGroup, LinkProperties]
    dynamics: RedundantDynamics
    motion: IndependentMotion
    partition: Partition
    closure: Closure
    redundant_force: casadi.SX
    forces: ProjectedForces
    elastic: casadi.SX
    position: casadi.SX
    end_effector_mass: casadi.SX
    joint_stiffness: casadi.SX | None
    outputs: tuple[Output, ...]
    stiction: tuple[Stiction, ...]
    notes: tuple[EffectNote, ...]

    def with_forces(self, redundant_force: casadi.SX) -> FiveBar:
        """The same robot under other forces, (10 + n, 1) in redundant coordinates."""
        forces, elastic, position = _respond(self.robot, self.partition, self.closure, redundant_force)
        return replace(self, redundant_force=redundant_force, forces=forces, elastic=elastic, position=position)


CONTRIBUTIONS: Mapping[str, str] = {
    "families": "elastic coordinates",
    "joint_stiffness": "twist of the joints",
    "shortening": "shortening of links",
    "kinetic_energy": "kinetic energy T",
    "first_moment": "weight",
    "potential_energy": "potential energy V",
    "dissipation": "dissipation R",
    "stiction": "sticking of the motors",
    "outputs": "outputs",
}
"""Hook of an effect → the part of the model to which an effect with a hook of its own contributes."""


def _contributions(kind: type[Effect]) -> tuple[str, ...]:
    """The parts of the model to which effects of a class contribute."""
    return tuple(part for hook, part in CONTRIBUTIONS.items() if getattr(kind, hook) is not getattr(Effect, hook))


@cache
def effect_classes() -> tuple[type[Effect], ...]:
    """The classes that `flexfmu.model.scene.effects.EFFECTS` names, in its order."""
    names = (path.split(".") for path in EFFECTS)
    return tuple(getattr(import_module(f"flexfmu.model.{module}"), name) for module, name in names)


def assemble(scene: Scene) -> FiveBar:
    """Assemble the five-bar from the effects of a scene.

    Raises:
        SceneError: the scene leaves the choice of effects open.
    """
    if scene.effects.select is not None:
        raise SceneError(
            f"scene {scene.name} leaves the choice of effects open (`effects.select`): resolve it first, with "
            f"`flexfmu.cosim.design.effects.choice.resolved(scene)`"
        )
    # parameters of the mechanism, then those of the effects that the scene chooses
    registry = ParameterRegistry()
    parameters = mechanism_parameters(registry, scene.mechanism)
    links: dict[LinkGroup, LinkProperties] = {
        group: link_properties(registry, group, parameters) for group in ("proximal", "distal")
    }
    context = EffectContext(scene, registry, links)
    effects = [effect for kind in effect_classes() for effect in kind.from_scene(context)]
    joint_stiffness = next((k for effect in effects if (k := effect.joint_stiffness()) is not None), None)
    # the robot with the coordinates of all effects; some families shorten their link by bending
    families = [family for effect in effects for family in effect.families()]
    shortening = {
        family.group: amount
        for effect in effects
        for family in families
        if (amount := effect.shortening(family)) is not None
    }
    base = registry.derived("base_half_distance", parameters["base_half_distance"])
    robot = make_robot(families, base, joint_stiffness is not None, shortening)
    outputs = tuple(output for effect in effects for output in effect.outputs(robot))

    # equations in redundant coordinates, and their projection onto the independent ones
    dynamics = derive_dynamics(robot, effects, registry)
    partition = Partition.of(robot)
    q_a, v_a, a_a = (casadi.SX.sym(name, 2) for name in ("q_a", "v_a", "a_a"))
    q_e, v_e = partition.states_of(robot.q_e), partition.states_of(robot.v_e)
    motion = IndependentMotion(q_a, v_a, a_a, q_e, v_e, casadi.SX.sym("a_e", q_e.numel()))
    everything = replace(motion, **{name: partition.fill(getattr(motion, name)) for name in ("q_e", "v_e", "a_e")})
    side = 1 if scene.mechanism.assembly_mode == "left" else -1
    closure = Closure(robot, everything, (links["proximal"].length, links["distal"].length), side)
    force = dynamics.force(*closure.redundant().arguments(), registry.d)
    forces, elastic, position = _respond(robot, partition, closure, force)
    return FiveBar(
        robot=robot,
        registry=registry,
        links=links,
        dynamics=dynamics,
        motion=motion,
        partition=partition,
        closure=closure,
        redundant_force=force,
        forces=forces,
        elastic=elastic,
        position=position,
        end_effector_mass=sum((effect.end_effector_mass() for effect in effects), casadi.SX(0)),
        joint_stiffness=joint_stiffness,
        outputs=outputs,
        stiction=tuple(friction for effect in effects for friction in effect.stiction()),
        notes=tuple(replace(effect.note, contributes=_contributions(type(effect))) for effect in effects),
    )


def _respond(
    robot: Robot, partition: Partition, closure: Closure, force: casadi.SX
) -> tuple[ProjectedForces, casadi.SX, casadi.SX]:
    """Projected forces, elastic coordinates with static deflections, and the end-effector position with these."""
    forces = closure.project(force)
    if not partition.statics:
        return forces, robot.q_e, closure.position
    # each quasi-static family by the forces on its coordinates
    deflections, start = [], 0
    for _, part in robot.elastic:
        stop = start + part.q.numel()
        if part.family.compliance is not None:
            deflections.append(-part.family.compliance @ forces.elastic[start:stop])
        start = stop
    elastic = partition.fill(partition.states_of(robot.q_e), casadi.vertcat(casadi.SX(0, 1), *deflections))
    return replace(forces, elastic=partition.states_of(forces.elastic)), elastic, closure.position_at(elastic)
