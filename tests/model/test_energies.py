"""The energies of the model against those of its material points: places and velocities of thousands of them, summed up."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from flexfmu.model.beams import scene_shapes
from flexfmu.model.five_bar import assemble
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

Array = np.ndarray
LINKS = ("link11", "link12", "link21", "link22")
GRAVITY, PAYLOAD, INERTIA, MOTOR, SPRING = np.array([2.0, -9.0]), 1.7, 0.03, 0.02, 800.0
IMAGINARY = 1e-40j
"""A small imaginary time, whose part of a place is the velocity without cancellation."""

BENDING = {
    "mechanism.proximal": {"length": 0.3, "diameter": 0.05, "inner_diameter": 0.03},
    "mechanism.distal": {"length": 0.4, "diameter": 0.03, "inner_diameter": 0.01},
    "payload": {"mass": PAYLOAD, "inertia": INERTIA},
    "effects.gravity": GRAVITY.tolist(),
    "effects.damping": {"kind": "none"},
    "effects.motor_inertia": MOTOR,
    "effects.transmission": {"stiffness": SPRING},
    "effects.proximal_bending": 2,
    "effects.distal_bending": 2,
    "effects.proximal_axial": 1,
    "effects.distal_axial": 1,
    "effects.foreshortening": True,
}
NODES, WEIGHTS = (each / 2.0 for each in np.polynomial.legendre.leggauss(30))
PLACES = NODES + 0.5
"""Normalised places along a link, and their weights."""


def shapes_at(scene: Scene, group: str, kind: str) -> list[Callable[[str, Array], Array]]:
    """Functions (field, xi) of the shapes of bending or stretching."""
    found = scene_shapes(scene)[group, kind]  # type: ignore[index]
    return [lambda field, xi, each=each: getattr(each, field)(xi) for each in found]  # type: ignore[misc]


def link_energy(
    scene: Scene, group: str, frame: Callable[[complex], tuple[Array, Array, complex]], q: Array, v: Array
) -> Array:
    """Kinetic and potential energy [J] of a link whose frame is (base point, direction, angle) of time, at time 0.

    q and v have the axial coordinate first, then those of bending. The links' axes keep their length when they bend: what is at
    the distance x along the axis has come nearer to the base by half of the integral of the squared slope.
    """
    link, material = getattr(scene.mechanism, group), scene.mechanism.material
    area = np.pi / 4.0 * (link.diameter**2 - link.inner_diameter**2)
    second = np.pi / 64.0 * (link.diameter**4 - link.inner_diameter**4)
    length, young, nu = link.length, material.youngs_modulus, material.poissons_ratio
    (axial,), bending = shapes_at(scene, group, "axial"), shapes_at(scene, group, "bending")

    def bent(field: str, xi: Array, by: Array) -> Array:
        return sum(each * shape(field, xi) for each, shape in zip(by, bending, strict=True))

    def places(time: complex) -> Array:
        """Places (2, points) of the axis."""
        now = q + time * v
        base, along, _ = frame(time)
        inner = 0.5 * np.array([xi * WEIGHTS @ bent("slope", xi * PLACES, now[1:]) ** 2 for xi in PLACES]) / length
        x = PLACES * length + now[0] * axial("value", PLACES) - inner
        across = np.array([-along[1], along[0]])
        return base[:, None] + np.outer(along, x) + np.outer(across, bent("value", PLACES, now[1:]))

    at, mass = places(IMAGINARY), material.density * area * length
    velocity = at.imag / IMAGINARY.imag
    kinetic = 0.5 * mass * WEIGHTS @ (velocity**2).sum(axis=0)
    potential = -mass * GRAVITY @ at.real @ WEIGHTS
    potential += 0.5 * young * area / length * q[0] ** 2 * WEIGHTS @ axial("strain", PLACES) ** 2
    potential += 0.5 * young * second / length**3 * WEIGHTS @ bent("strain", PLACES, q[1:]) ** 2
    if scene.effects.beam == "timoshenko":
        turning = frame(IMAGINARY)[2].imag / IMAGINARY.imag + bent("rotation", PLACES, v[1:]) / length
        kinetic += 0.5 * material.density * second * length * WEIGHTS @ turning**2
        # Cowper (1966), with the ratio m of the diameters
        m = link.inner_diameter / link.diameter
        k = 6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)
        angle = (bent("slope", PLACES, q[1:]) - bent("rotation", PLACES, q[1:])) / length
        potential += 0.5 * k * young / (2.0 * (1.0 + nu)) * area * length * WEIGHTS @ angle**2
    return np.array([kinetic, potential])


@pytest.mark.parametrize(
    "changes",
    [{}, {"effects.basis": "craig-bampton", "effects.beam": "timoshenko"}],
    ids=["thin beams, assumed modes", "thick beams, static shapes"],
)
def test_energies_are_those_of_the_material_points(changes: dict[str, object]) -> None:
    """All terms up to the second order in deflections and their rates, at a drawn motion of frames, base points and end effector:
    each link moves, turns, stretches, bends and shortens; payload, motors and transmissions are there too."""
    scene = load_scene("barnard2012-6kg").replace(BENDING | changes)
    five_bar, rng = assemble(scene), np.random.default_rng(3)
    derived = five_bar.registry.derived_at_start()
    angle, rate = (dict(zip(LINKS, rng.normal(size=4) * size, strict=True)) for size in (1.0, 4.0))
    points, point_rates = rng.normal(size=(3, 2)) * 0.3, rng.normal(size=(3, 2)) * 2.0
    size = five_bar.robot.q_e.numel()
    q, v = rng.normal(size=size) * 0.02, rng.normal(size=size) * 0.5

    def model(scale: float) -> Array:
        order = ("link11", "link21", "link12", "link22")
        directions = [f(angle[name]) for name in order for f in (np.cos, np.sin)]
        x = [*directions, *points.ravel(), *(scale * q)]
        rates = [*(rate[name] for name in order), *point_rates.ravel(), *(scale * v)]
        return five_bar.dynamics.energy(x, rates, derived).full().ravel()

    def exact(scale: float) -> Array:
        moved, moving = scale * q, scale * v
        half = scene.mechanism.base_half_distance
        fixed = {"link11": np.array([-half, 0.0]), "link21": np.array([half, 0.0])}
        ends = np.cumsum([0] + [3] * 4)
        total = np.zeros(2)
        for name, (first, last) in zip(LINKS, pairwise(ends), strict=True):
            leg = int(name[4]) - 1

            def frame(time: complex, name: str = name, leg: int = leg) -> tuple[Array, Array, complex]:
                turned = angle[name] + time * rate[name]
                base = fixed.get(name, points[leg] + time * point_rates[leg])
                return base, np.array([np.cos(turned), np.sin(turned)]), turned

            group = "proximal" if name.endswith("1") else "distal"
            total += link_energy(scene, group, frame, moved[first:last], moving[first:last])
        # payload, which turns with the last section of link 12, motors behind their transmissions
        tips = [float(each("rotation", np.ones(1))[0]) for each in shapes_at(scene, "distal", "bending")]
        section = rate["link12"] + tips @ moving[4:6] / scene.mechanism.distal.length
        motors = np.array([rate["link11"], rate["link21"]]) - moving[-2:]
        total[0] += 0.5 * (PAYLOAD * point_rates[2] @ point_rates[2] + INERTIA * section**2 + MOTOR * motors @ motors)
        total[1] += 0.5 * SPRING * moved[-2:] @ moved[-2:] - PAYLOAD * GRAVITY @ points[2]
        return total

    scales = np.linspace(-1.0, 1.0, 5)
    model_terms, exact_terms = (
        np.linalg.solve(np.vander(scales), [f(each) for each in scales]) for f in (model, exact)
    )
    np.testing.assert_allclose(model_terms[:2], 0.0, atol=1e-9 * np.abs(model_terms).max())
    for order in (2, 3, 4):
        np.testing.assert_allclose(
            model_terms[order], exact_terms[order], rtol=1e-9, atol=1e-11 * np.abs(model_terms[4]).max()
        )
