"""Feedforwards that compensate single effects: friction of the motors, and gravity.

Both are added to the torque of another controller. They read the references, which are known ahead and free of noise, or the
measurements, which are there without a reference too (B. Armstrong-Hélouvry, P. Dupont, C. Canudas de Wit, A survey of models, analysis
tools and compensation methods for the control of machines with friction, Automatica 30 (1994), section 6.3; gravity: B. Siciliano et al.,
Robotics, 2009, section 8.5.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block, split
from flexfmu.cosim.control.controllers.computed_torque import assumed_dynamics, check_dynamics
from flexfmu.cosim.control.controllers.joints import (
    JOINTS,
    JointQuantity,
    PerJoint,
    feedforward_outputs,
    gains,
    measurements,
    per_joint,
    references,
)
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.scene.controllers import FrictionCompensationSection, GravityFeedforwardSection
from flexfmu.model.symbolic import SymbolicBlock, Variable

Motion = Literal["reference", "measured"]
"""Which motion a feedforward reads."""


def friction_compensation(
    viscous: PerJoint,
    coulomb: PerJoint,
    *,
    sample_time: float,
    offset: float = 0.0,
    velocity: float = 0.01,
    motion: Motion = "reference",
    joints: Sequence[str] = JOINTS,
    name: str = "friction_compensation",
) -> SymbolicBlock:
    """Build the block: feedforward = viscous w + coulomb w / sqrt(w² + velocity²), with the motor rate w; without states.

    It is the law of the scene's smooth friction. A compensation from the measured velocity that is stronger than the friction feeds
    energy into the loop: keep it below.

    Input: ``joint1.reference.velocity`` or ``joint1.velocity``; output ``joint1.feedforward``. Coefficients are tunable parameters
    ``joint1.viscous_friction``, ``joint1.coulomb_friction``.

    Args:
        viscous: coefficient [N.m.s/rad].
        coulomb: dry friction [N.m].
        sample_time, offset: sample time and first sample instant [s].
        velocity: rate [rad/s] that smooths the change of sign; 71 % of the dry friction at this rate.
        motion: whether w is that of the reference or measured.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: a coefficient is negative or not finite, the smoothing velocity or the sample time isn't positive.
    """
    (smoothing,) = per_joint(("the motors",), "velocity", velocity, "rad/s")
    if smoothing <= 0.0:
        raise InputError(f"{name}: the smoothing velocity must be above 0 rad/s, got {velocity}; try 0.01")

    def equations(x: Vector, w: Vector, p: Vector) -> tuple[Vector, Vector]:
        d, c = split(p, len(joints))
        return d * w + c * w / casadi.sqrt(w**2 + smoothing**2), x

    return block(
        name,
        "Compensation of the motors' friction",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=_inputs(joints, "velocity", motion, name),
        outputs=feedforward_outputs(joints, "Torque against the friction"),
        parameters=[
            *gains(joints, "viscous_friction", viscous, "N.m.s/rad", "Viscous friction that is compensated"),
            *gains(joints, "coulomb_friction", coulomb, "N.m", "Dry friction that is compensated"),
        ],
    )


def gravity_feedforward(
    inverse_dynamics: casadi.Function,
    *,
    sample_time: float,
    offset: float = 0.0,
    motion: Motion = "reference",
    joints: Sequence[str] = JOINTS,
    name: str = "gravity_feedforward",
) -> SymbolicBlock:
    """Build the block: feedforward = ID(q, 0, 0), the torques that hold the rigid robot at rest in its pose q; without states.

    Input: ``joint1.reference.position`` or ``joint1.position``; output ``joint1.feedforward``.

    Args:
        inverse_dynamics: (q, v, a) → torque [rad, rad/s, rad/s2 → N.m], as of `flexfmu.model.numeric.inverse_dynamics`.
        sample_time, offset: sample time and first sample instant [s].
        motion: whether q is that of the reference or measured.
        joints: names of the joints.
        name: name of the block.

    Raises:
        InputError: the inverse dynamics don't fit the joints, or the sample time isn't positive.
    """
    check_dynamics(inverse_dynamics, joints, name)

    def equations(x: Vector, q: Vector, p: Vector) -> tuple[Vector, Vector]:
        rest = casadi.SX.zeros(len(joints))
        return inverse_dynamics.call([q, rest, rest])[0], x

    return block(
        name,
        "Torques that hold the rigid robot at rest",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=_inputs(joints, "position", motion, name),
        outputs=feedforward_outputs(joints, "Torque against gravity"),
    )


def _inputs(joints: Sequence[str], kind: JointQuantity, motion: Motion, name: str) -> list[Variable]:
    """Return the references or the measurements of this kind.

    Raises:
        InputError: the motion is neither.
    """
    if motion not in ("reference", "measured"):
        raise InputError(f"{name}: the motion is 'reference' or 'measured', got {motion!r}")
    return references(joints, kind) if motion == "reference" else measurements(joints, kind)


@builds(FrictionCompensationSection)
def _friction_from_section(section: FrictionCompensationSection, context: LoopContext) -> SymbolicBlock:
    # the scene's own friction, unless the section has its own
    friction = context.scene.effects.joint_friction
    viscous = friction.viscous if section.viscous is None else section.viscous
    coulomb = friction.coulomb if section.coulomb is None else section.coulomb
    smoothing = getattr(friction, "velocity", 0.01) if section.velocity is None else section.velocity
    if section.viscous is None and section.coulomb is None and not friction.is_there:
        raise InputError(
            f"{context.name} has no friction to compensate: give it `viscous` [N.m.s/rad] or `coulomb` [N.m], or the robot "
            "`effects.joint_friction`"
        )
    return friction_compensation(
        viscous,
        coulomb,
        velocity=smoothing,
        motion=section.motion,
        sample_time=section.sample_time,
        offset=section.offset,
    )


@builds(GravityFeedforwardSection)
def _gravity_from_section(section: GravityFeedforwardSection, context: LoopContext) -> SymbolicBlock:
    return gravity_feedforward(
        assumed_dynamics(context, section.payload),
        motion=section.motion,
        sample_time=section.sample_time,
        offset=section.offset,
    )
