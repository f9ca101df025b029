"""Formulation in all coordinates: Lagrange multipliers at acceleration level (index 1), Baumgarte stabilisation.

Coordinates q = [q_a, q_e, q_p] with q_p = [x12, y12, th12, x22, y22, th22, x, y], constraints f(q) = 0 of eq. (18) and
their Jacobians C, B, A of eq. (19). The equations are ::

    [ M   Psi' ] [ q''    ]   [ tau - h                       ]
    [ Psi  0   ] [ lambda ] = [ -Psi' q' - 2 a f' - a² f      ]

It has the energies in common with the formulation in independent coordinates, but neither assembly nor projection, so
it checks both. The multipliers are the joint reaction forces.

Source: Baumgarte, Stabilization of constraints and integrals of motion in dynamical systems, CMAME 1 (1972).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi

from flexfmu.model.five_bar import FiveBar, assemble
from flexfmu.model.robot import TipMap
from flexfmu.model.scene.schema import Scene

PASSIVE = 8
"""Number of passive coordinates and of constraints."""


@dataclass(frozen=True)
class ConstrainedModel:
    """Functions in all coordinates q = [q_a (2), q_e (n), q_p (8)].

    Attributes:
        n: number of elastic coordinates.
        constraints: q → f(q) (8, 1) [m].
        jacobian: q → Psi = [C, B, A] (8, 10 + n).
        mass_matrix: q → M (10 + n, 10 + n).
        bias: (q, v) → bias forces h (10 + n, 1): the generalised forces that a motion with q'' = 0 needs.
        curvature: (q, v) → (d Psi/dt) v (8, 1).
        assembled: (q_a, q_e, v_a, v_e) → consistent q and v, (10 + n, 1) each.
    """

    n: int
    constraints: casadi.Function
    jacobian: casadi.Function
    mass_matrix: casadi.Function
    bias: casadi.Function
    curvature: casadi.Function
    assembled: casadi.Function


@lru_cache(maxsize=8)
def constrained_model(scene: Scene) -> ConstrainedModel:
    """The index-1 form of a scene's five-bar with numeric parameter values.

    Quasi-static families are left out, as they have no part in the dynamics.
    """
    rigid = {f"effects.{family}": 0 for family in scene.effects.quasi_static}
    five_bar = assemble(scene.replace(rigid | {"effects.quasi_static": []}) if rigid else scene)
    # symbols of all coordinates, constraints, and the forces that a motion needs
    d, n = five_bar.registry.derived_at_start(), five_bar.robot.q_e.numel()
    q, v = casadi.SX.sym("q", 2 + n + PASSIVE), casadi.SX.sym("v", 2 + n + PASSIVE)
    a = casadi.SX.sym("a", q.numel())
    f = _constraints(five_bar, q, d)
    psi = casadi.jacobian(f, q)
    force = _force(five_bar, q, v, a, d)
    bias = casadi.substitute(force, a, casadi.SX.zeros(a.numel()))
    return ConstrainedModel(
        n=n,
        constraints=casadi.Function("constraints", [q], [f]),
        jacobian=casadi.Function("jacobian", [q], [casadi.densify(psi)]),
        mass_matrix=casadi.Function("mass_matrix", [q], [casadi.densify(casadi.jacobian(force, a))]),
        bias=casadi.Function("bias", [q, v], [casadi.densify(bias)]),
        curvature=casadi.Function("curvature", [q, v], [casadi.densify(casadi.jtimes(psi @ v, q, v))]),
        assembled=_assembled(five_bar, d),
    )


def _split(q: casadi.SX, n: int) -> tuple[casadi.SX, casadi.SX, casadi.SX]:
    return q[:2], q[2 : 2 + n], q[2 + n :]


def _constraints(five_bar: FiveBar, q: casadi.SX, d: casadi.DM) -> casadi.SX:
    """Constraints f(q) of eq. (18): distal tips coincide with the end effector, distal bases with the proximal tips."""
    # angles of the proximal links, with the twists of the transmissions
    q_a, q_e, q_p = _split(q, five_bar.robot.q_e.numel())
    tips = TipMap(five_bar.robot)
    links = q_a + tips.twist.T @ q_e if q_e.numel() else q_a
    # gaps of each leg at the end effector and at the elbow
    end = q_p[6:8]
    at_end, at_elbow = [], []
    for leg in (1, 2):
        base, angle = q_p[3 * leg - 3 : 3 * leg - 1], q_p[3 * leg - 1]
        at_end.append(end - _tip(five_bar, tips, f"link{leg}2", base, angle, q_e))
        fixed = five_bar.robot.links[f"link{leg}1"].base
        at_elbow.append(base - _tip(five_bar, tips, f"link{leg}1", fixed, links[leg - 1], q_e))
    return casadi.substitute(casadi.vertcat(*at_end, *at_elbow), five_bar.registry.d, d)


def _tip(five_bar: FiveBar, tips: TipMap, link: str, base: casadi.SX, angle: casadi.SX, q_e: casadi.SX) -> casadi.SX:
    """Tip (2, 1) [m] of a link for its base, angle and elastic coordinates, eq. (5) at xi = 1."""
    length = five_bar.registry.find_derived(f"{five_bar.robot.links[link].group}_length")
    along = length + tips.displacement(link, "axial", q_e)
    across = tips.displacement(link, "bending", q_e)
    c, s = casadi.cos(angle), casadi.sin(angle)
    return base + casadi.vertcat(c * along - s * across, s * along + c * across)


def _force(five_bar: FiveBar, q: casadi.SX, v: casadi.SX, a: casadi.SX, d: casadi.DM) -> casadi.SX:
    """Generalised forces that a motion in all coordinates needs, in the order of q."""
    n = five_bar.robot.q_e.numel()
    twist = five_bar.robot.twist_selection
    # the redundant configuration, rates and accelerations as functions of the coordinates
    q_a, q_e, q_p = _split(q, n)
    links = q_a + twist.T @ q_e if n else q_a
    directions = [casadi.vertcat(casadi.cos(t), casadi.sin(t)) for t in (links[0], links[1], q_p[2], q_p[5])]
    x = casadi.vertcat(*directions, q_p[0:2], q_p[3:5], q_p[6:8], q_e)

    def redundant(w: casadi.SX) -> casadi.SX:
        w_a, w_e, w_p = _split(w, n)
        return casadi.vertcat(w_a + twist.T @ w_e if n else w_a, w_p[2], w_p[5], w_p[0:2], w_p[3:5], w_p[6:8], w_e)

    force = five_bar.dynamics.force(x, redundant(v), redundant(a), d)
    # redundant forces in the order of q; a twist rotates the link relative to the motor
    passive = casadi.vertcat(force[4:6], force[2], force[6:8], force[3], force[8:10])
    elastic = force[10:] + twist @ force[0:2] if n else force[10:]
    return casadi.vertcat(force[0:2], elastic, passive)


def _assembled(five_bar: FiveBar, d: casadi.DM) -> casadi.Function:
    """All coordinates and rates from the independent ones, by the closed-form assembly."""
    m, closure = five_bar.motion, five_bar.closure
    passive, rates = [], []
    # elbows and directions of the distal links
    for leg in range(2):
        e = closure.e_p[leg]
        passive += [closure.elbows[leg], casadi.atan2(e[1], e[0])]
        rates += [closure.elbow_velocity[leg], closure.w_p[leg]]
    q = casadi.vertcat(m.q_a, m.q_e, *passive, closure.position)
    v = casadi.vertcat(m.v_a, m.v_e, *rates, closure.velocity)
    # numbers for the derived values
    filled = [casadi.substitute(expression, five_bar.registry.d, d) for expression in (q, v)]
    return casadi.Function("assembled", [m.q_a, m.q_e, m.v_a, m.v_e], filled)
