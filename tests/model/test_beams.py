"""Mode shapes of beams against closed forms and literature, and the convergence of both bases."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.model import beams
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies

XI = np.linspace(0.0, 1.0, 101)


def test_first_shape_is_the_papers_formula() -> None:
    """The evaluation without cancellation is eq. (1) with the exact a_k, tip 2.7244 included."""
    shape = beams.clamped_free_bending(1)
    b = shape.wave_number
    a = -(np.cosh(b) + np.cos(b)) / (np.sinh(b) - np.sin(b))
    paper = np.sin(b * XI) + a * np.cos(b * XI) - np.sinh(b * XI) - a * np.cosh(b * XI)
    np.testing.assert_allclose(shape.value(XI), paper, atol=1e-14)
    assert abs(a + 1.3622) < 5e-5
    assert shape.tip == pytest.approx(2.7244, abs=5e-5)


@pytest.mark.parametrize("mode", [1, 2, 5, 20, 40])
def test_shapes_meet_their_boundary_conditions(mode: int) -> None:
    """Clamped: phi = phi' = 0; free: phi'' = 0; pinned: phi = phi'' = 0, with the tabulated roots 3.9266, 7.0686 (Blevins 1979,
    table 8-1); the sign of the free tip alternates."""
    ends, free, pinned = np.array([0.0, 1.0]), beams.clamped_free_bending(mode), beams.clamped_pinned_bending(mode)
    for shape in (free, pinned):
        assert abs(shape.value(ends)[0]) < 1e-14
        assert abs(shape.slope(ends)[0]) < 1e-13 * shape.wave_number
        assert abs(shape.strain(ends)[1]) < 1e-12 * shape.wave_number**2
    assert np.sign(free.tip) == (-1) ** (mode + 1)
    assert abs(pinned.value(ends)[1]) < 1e-13
    assert [round(beams.clamped_pinned_bending(k).wave_number, 4) for k in (1, 2)] == [3.9266, 7.0686]


def test_twenty_bending_modes_are_orthogonal_to_1e_10() -> None:
    """High modes are as good as the first: mass and stiffness Gram matrices are diagonal."""
    shapes = [beams.clamped_free_bending(k) for k in range(1, 21)]
    xi, w = np.polynomial.legendre.leggauss(300)
    values = np.array([s.value(0.5 * (xi + 1)) for s in shapes])
    strains = np.array([s.strain(0.5 * (xi + 1)) for s in shapes])
    for rows in (values, strains):
        gram = (rows * 0.5 * w) @ rows.T
        norms = np.sqrt(np.diag(gram))
        assert np.abs(gram / np.outer(norms, norms) - np.eye(20)).max() < 1e-10


ALL_SHAPES = [
    beams.clamped_free_bending(3),
    beams.clamped_pinned_bending(3),
    beams.tip_force_bending(),
    beams.pinned_pinned_bending(3),
    beams.fixed_free_axial(3),
    beams.fixed_fixed_axial(3),
    beams.tip_force_axial(),
]


@pytest.mark.parametrize("shape", ALL_SHAPES)
def test_slopes_and_strains_are_the_derivatives_of_the_shapes(shape: beams.Shape) -> None:
    """Each energy sees the same shape."""
    inside, h = XI[1:-1], 1e-6
    scale = max(1.0, shape.wave_number)
    slope = (shape.value(inside + h) - shape.value(inside - h)) / (2 * h)
    np.testing.assert_allclose(shape.slope(inside), slope, atol=1e-8 * scale**3)
    bends = np.any(shape.rotation(inside))
    strain = (shape.rotation(inside + h) - shape.rotation(inside - h)) / (2 * h) if bends else slope
    np.testing.assert_allclose(shape.strain(inside), strain, atol=1e-8 * scale**4)
    assert shape.value(np.array([1.0]))[0] == pytest.approx(shape.tip, abs=1e-13)


@pytest.mark.parametrize(
    ("static", "held"),
    [(beams.tip_force_bending, beams.clamped_pinned_bending), (beams.tip_force_axial, beams.fixed_fixed_axial)],
)
def test_static_shapes_carry_the_whole_compliance_and_no_stiffness_couples_them(static, held) -> None:  # type: ignore[no-untyped-def]
    """Craig and Bampton (1968): stiffness 3 EI/l³ and EA/l at the tip, exactly, and none to the modes with the tip held."""
    stiffness = beams.integrate_shapes([static(), *(held(k) for k in range(1, 6))]).strain_gram
    assert stiffness[0, 0] == pytest.approx(3.0 if static is beams.tip_force_bending else 1.0, rel=1e-14)
    np.testing.assert_array_equal(stiffness[~np.eye(6, dtype=bool)], 0.0)


POSES = [(-0.175, 0.320), (0.0, 0.295)]
SHIPPED = ("barnard2012-6kg", "barnard2012-0.1kg")
SIX = {
    "effects.basis": "craig-bampton",
    "effects.proximal_bending": 1,
    "effects.distal_bending": 1,
    "effects.distal_axial": 1,
}
"""1 + 1 + 1 shapes for each leg, 6 coordinates; the paper's scene has 3 + 3, 12 coordinates."""


def converged(scene: Scene, basis: str, modes: int) -> Scene:
    """The robot with so many modes of every family."""
    families = {"proximal_bending": modes, "proximal_axial": modes, "distal_bending": modes, "distal_axial": modes}
    return scene.replace({"effects.basis": basis} | {f"effects.{key}": count for key, count in families.items()})


def frequencies(scene: Scene, count: int) -> np.ndarray:
    """The first natural frequencies [Hz] at all poses, shape (poses, count)."""
    poses = [natural_frequencies(scene, motor_angles(scene.mechanism, pose)) for pose in POSES]
    return np.array([found[:count] for found in poses])


@pytest.mark.parametrize("name", SHIPPED)
def test_six_coordinates_beat_the_papers_twelve_in_frequency(name: str) -> None:
    """1 + 1 + 1 static and bending shapes are nearer to the converged robot: 0.15 % instead of up to 1.5 %."""
    scene = load_scene(name)
    reference = frequencies(converged(scene, "craig-bampton", 6), 2)
    six, twelve = (frequencies(each, 2) / reference - 1.0 for each in (scene.replace(SIX), scene))
    assert scene.replace(SIX).effects.proximal_axial == 0
    assert np.all(six > 0.0)
    assert np.abs(six).max() < 1.5e-3
    assert np.abs(twelve).max() > 1.6 * np.abs(six).max()
    assert np.all(np.abs(six[:, 0]) < 0.6 * np.abs(twelve[:, 0]))
