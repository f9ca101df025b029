"""The finite elements on their own: beams against closed forms, the integrator against its order."""

from __future__ import annotations

import numpy as np
import pytest
from formulations import full_scene
from scipy.linalg import eigh

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.finite_elements.motion import simulate
from flexfmu.model.finite_elements.robot import COORDINATES, BeamSection, beam_element, finite_element_robot
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene

SCENE = full_scene(load_scene("barnard2012-6kg"), "euler-bernoulli", foreshortening=True)
SLENDER = BeamSection(length=1.0, axial=7e7, bending=5e3, shear=np.inf, mass=2.6, rotary=0.0)
THICK = BeamSection(length=1.0, axial=7e7, bending=1e5, shear=2e7, mass=2.6, rotary=0.004)
BETA = 1.8751040687
"""First root of a cantilever (Blevins, 1979, table 8-1)."""


class Cantilever:
    """A chain of elements along x, clamped at the origin."""

    def __init__(self, section: BeamSection, elements: int) -> None:
        self.element = beam_element(section, section.length / elements, (0.0, 0.0), 0.0)
        self.index = 3 * np.arange(elements)[:, None] + np.arange(COORDINATES)
        self.x = np.zeros(3 * elements + 3)
        self.x[::3] = np.linspace(0.0, section.length, elements + 1)

    def force(self) -> np.ndarray:
        """At rest, on the free coordinates."""
        total, rest = np.zeros(self.x.size), np.zeros(COORDINATES)
        for index in self.index:
            total[index] += self.element.force(self.x[index], rest, rest).full().ravel()
        return total[3:]

    def matrices(self) -> tuple[np.ndarray, np.ndarray]:
        """Stiffness and mass of the free coordinates."""
        total, rest = np.zeros((2, self.x.size, self.x.size)), np.zeros(COORDINATES)
        for index in self.index:
            blocks = self.element.tangent(self.x[index], rest, rest).full().reshape(3, COORDINATES, COORDINATES)
            total[:, index[:, None], index] += blocks[[0, 2]].transpose(0, 2, 1)
        return total[0, 3:, 3:], total[1, 3:, 3:]

    def bend(self, load: np.ndarray, parts: int) -> None:
        """Go to equilibrium under a load on the free coordinates, in equal parts."""
        for part in np.arange(1, parts + 1) / parts:
            for _ in range(8):
                self.x[3:] += np.linalg.solve(self.matrices()[0], part * load - self.force())


def first_frequency(section: BeamSection, elements: int) -> float:
    """Angular frequency [rad/s]."""
    squares = eigh(*Cantilever(section, elements).matrices(), eigvals_only=True)
    return float(np.sqrt(squares[0]))


def test_cantilevers_frequency_converges_with_the_fourth_power() -> None:
    """Hermite's cubics: the error falls sixteenfold when elements are halved, towards Blevins' root."""
    exact = BETA**2 * np.sqrt(SLENDER.bending / SLENDER.mass)
    errors = [first_frequency(SLENDER, elements) / exact - 1.0 for elements in (1, 2, 4)]
    assert np.all(np.array(errors) > 0.0)
    assert np.log2(errors[0] / errors[1]) > 3.0
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4.0, abs=0.3)
    assert errors[2] < 1e-4


def test_thick_cantilever_sags_by_bending_and_shear() -> None:
    """A force at the tip: F l³/(3 EI) + F l/(kGA), exactly, with any number of elements."""
    beam = Cantilever(THICK, 3)
    load = np.zeros(beam.x.size - 3)
    load[-2] = 1.0
    beam.bend(load, 1)
    assert beam.x[-2] == pytest.approx(1.0 / (3.0 * THICK.bending) + 1.0 / THICK.shear, rel=1e-9)


def test_moment_rolls_a_beam_into_a_circle() -> None:
    """Pure bending without limits: 2 pi EI / l at the tip brings it back to the clamp (the elastica's textbook case)."""
    beam = Cantilever(SLENDER, 24)
    load = np.zeros(beam.x.size - 3)
    load[-1] = 2.0 * np.pi * SLENDER.bending / SLENDER.length
    beam.bend(load, 12)
    assert beam.x[-1] == pytest.approx(2.0 * np.pi, rel=1e-6)
    assert np.hypot(*beam.x[-3:-1]) < 2e-3 * SLENDER.length


@pytest.mark.parametrize("section", [SLENDER, THICK])
def test_forces_are_the_energies_slopes_and_tangents_the_forces(section: BeamSection) -> None:
    """At a drawn deformed, turning, accelerating state: power in is energy gained, Jacobians are difference quotients."""
    element = beam_element(section, 0.3, (1.0, -9.81), 0.0)
    draw = np.random.default_rng(5)
    x = np.array([0.1, 0.2, 1.1, 0.1 + 0.3 * np.cos(1.1), 0.2 + 0.3 * np.sin(1.1), 1.1])
    x += 1e-3 * draw.normal(size=COORDINATES)
    v, a = draw.normal(size=(2, COORDINATES))
    energies = [element.energy(x + t * v + t**2 / 2 * a, v + t * a).full().sum() for t in (-1e-5, 1e-5)]
    force = element.force(x, v, a).full().ravel()
    assert (energies[1] - energies[0]) / 2e-5 == pytest.approx(force @ v, rel=1e-5)
    tangent = element.tangent(x, v, a).full().reshape(3, COORDINATES, COORDINATES)
    for which in range(3):
        direction = draw.normal(size=COORDINATES)
        # in rates and accelerations forces are polynomials of second order: central differences of any size are exact
        size = 1e-6 if which == 0 else 1.0
        step = [np.zeros(COORDINATES)] * 3
        step[which] = size * direction
        here, there = ([z + sign * d for z, d in zip((x, v, a), step, strict=True)] for sign in (-1, 1))
        slope = (element.force(*there) - element.force(*here)).full().ravel() / (2.0 * size)
        expected = direction @ tangent[which]
        assert slope == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_integrator_has_its_order() -> None:
    """Halving the step of Radau's method divides the error of positions and torques by 2^5, within 0.4."""
    motion = plan(SCENE)
    instants = np.array([0.1])
    robot = finite_element_robot(SCENE, 1)
    exact, *runs = (simulate(robot, motion.joints, instants, step) for step in (5e-4, 2e-3, 1e-3))
    for key in ("position", "torque"):
        coarse, fine = (np.abs(getattr(run, key) - getattr(exact, key)).max() for run in runs)
        assert np.log2(coarse / fine) == pytest.approx(5.0, abs=0.4), key


def test_stages_within_steps_err_by_an_order_less() -> None:
    """What plans look at between the ends of steps: halving the step divides errors of all stages by 2^4, within 0.3."""
    motion, robot, errors = plan(SCENE), finite_element_robot(SCENE, 1), list[list[float]]()
    for step in (2e-3, 1e-3):
        found = simulate(robot, motion.joints, np.array([0.02]), step, stages=True)
        exact = simulate(robot, motion.joints, found.time, 2e-4)
        keys = ("position", "velocity", "acceleration", "torque")
        errors.append([np.abs(getattr(found, key) - getattr(exact, key)).max() for key in keys])
    assert np.log2(np.divide(*errors)) == pytest.approx(4.0, abs=0.3)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"effects.damping": {"kind": "modal", "ratio": 0.1}}, "stiffness"),
        ({"effects.motor_inertia": 0.01}, "motor_inertia"),
        ({"effects.joint_friction": {"viscous": 0.1}}, "joint_friction"),
        ({"effects.transmission": {"stiffness": 1e4}}, "transmission"),
    ],
)
def test_what_elements_lack_is_refused(changes: dict[str, object], said: str) -> None:
    """A reference that silently leaves out a scene's physics would agree with the wrong robot."""
    with pytest.raises(SceneError, match=said):
        finite_element_robot(SCENE.replace(changes), 2)
