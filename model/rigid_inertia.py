"""Mass matrix of the rigid five-bar in the motor angles, by velocities of points, without CasADi.

A uniform rod of mass m with end velocities v_a and v_b has the kinetic energy m/6 (v_a² + v_a · v_b + v_b²). The end
effector's velocity follows from the constant lengths of the distal links: (X - E_i) · (X' - E_i') = 0.
"""

from __future__ import annotations

import math

import numpy as np

from flexfmu.model.scene.assembly import bases
from flexfmu.model.scene.mechanism import LinkSection
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray


def load_mass_matrix(scene: Scene, joints: RealArray) -> RealArray:
    """Return the mass matrix (N, 2, 2) [kg.m2] of links and payload at motor angles (N, 2) [rad], without the motors.

    Links are slender: the rotary inertia of their cross sections is left out.
    """
    mechanism, count = scene.mechanism, len(joints)
    length = mechanism.proximal.length
    masses = [_mass(link, mechanism.material.density) for link in (mechanism.proximal, mechanism.distal)]
    # elbows, the end effector beside the middle between them, and velocities for unit rates
    cosine, sine = np.cos(joints), np.sin(joints)
    elbows = np.array(bases(mechanism)) + length * np.stack([cosine, sine], axis=-1)
    line = elbows[:, 1] - elbows[:, 0]
    side = 1.0 if mechanism.assembly_mode == "left" else -1.0
    height = side * np.sqrt(mechanism.distal.length**2 / np.sum(line**2, axis=1) - 0.25)
    end = elbows.mean(axis=1) + height[:, np.newaxis] * np.stack([-line[:, 1], line[:, 0]], axis=-1)
    arms, turning = end[:, np.newaxis] - elbows, length * np.stack([-sine, cosine], axis=-1)
    drive = np.zeros((count, 2, 2))
    for leg in (0, 1):
        drive[:, leg, leg] = np.einsum("nk,nk->n", arms[:, leg], turning[:, leg])
    effector: RealArray = np.asarray(np.linalg.solve(arms, drive), dtype=float)
    # proximal links turn about their bases, then distal links and payload
    matrix: RealArray = np.tile(masses[0] * length**2 / 3.0 * np.eye(2), (count, 1, 1))
    for leg in (0, 1):
        elbow = np.zeros((count, 2, 2))
        elbow[:, :, leg] = turning[:, leg]
        mixed = _gram(elbow, effector)
        matrix += (
            masses[1] / 3.0 * (_gram(elbow, elbow) + 0.5 * (mixed + mixed.swapaxes(1, 2)) + _gram(effector, effector))
        )
        if leg == 0:
            relative, arm = effector - elbow, arms[:, 0]
            turn = (
                arm[:, 0, np.newaxis] * relative[:, 1] - arm[:, 1, np.newaxis] * relative[:, 0]
            ) / mechanism.distal.length**2
            matrix += scene.payload.inertia * turn[:, :, np.newaxis] * turn[:, np.newaxis]
    return np.asarray(matrix + scene.payload.mass * _gram(effector, effector))


def _gram(first: RealArray, second: RealArray) -> RealArray:
    """Return the products A^T B of matrices (N, 2, 2)."""
    return np.asarray(first.swapaxes(1, 2) @ second)


def _mass(link: LinkSection, density: float) -> float:
    return density * math.pi / 4.0 * (link.diameter**2 - link.inner_diameter**2) * link.length
