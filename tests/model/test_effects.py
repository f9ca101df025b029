"""Effects in their limits, what they cost in operations, and the scenes with one more or less."""

from __future__ import annotations

import inspect
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq

from flexfmu.fmu_build.codegen import generate_functions
from flexfmu.model.beams import family_shapes, slenderness
from flexfmu.model.effects import Effect
from flexfmu.model.enrichment import enrichments, reductions
from flexfmu.model.five_bar import assemble, effect_classes
from flexfmu.model.numeric import numeric_model, standstill
from flexfmu.model.plants import build_model
from flexfmu.model.robot import TipMap
from flexfmu.model.scene.assembly import elbows, motor_angles
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import damped_modes, natural_frequencies, static_equilibrium
from flexfmu.model.symbolic import SymbolicModel

POSE = (0.05, 0.3)
BASES = ("assumed-modes", "craig-bampton")
ALONE = {
    "effects.gravity": [0.0, 0.0],
    "effects.damping": {"kind": "none"},
    "effects.proximal_bending": 0,
    "effects.distal_axial": 0,
    "payload.mass": 0.0,
}
WEIGHTLESS_DISTAL = {"mechanism.distal": {"length": 0.38079, "diameter": 1e-7}}
"""Distal links of no mass leave the proximal links to themselves."""


def alone(changes: dict[str, object]) -> Scene:
    """The paper's mechanism with nothing but the effects in `changes`."""
    return load_scene("barnard2012-6kg").replace(ALONE | changes)


def wave_speeds(scene: Scene, group: str) -> tuple[float, float, float]:
    """sqrt(EI/(rho A l⁴)) of a rod or tube [rad/s], I/(A l²) and EI/(k G A l²) with Cowper's k, from textbook formulas."""
    link, material = getattr(scene.mechanism, group), scene.mechanism.material
    outer, inner = link.diameter, link.inner_diameter
    area, second = np.pi * (outer**2 - inner**2) / 4, np.pi * (outer**4 - inner**4) / 64
    nu, m = material.poissons_ratio, (inner / outer) ** 2
    k = 6 * (1 + nu) * (1 + m) ** 2 / ((7 + 6 * nu) * (1 + m) ** 2 + (20 + 12 * nu) * m)
    shear_modulus = material.youngs_modulus / (2 * (1 + nu))
    rigidity = material.youngs_modulus * second
    rate = np.sqrt(rigidity / (material.density * area)) / link.length**2
    return rate, second / (area * link.length**2), rigidity / (k * shear_modulus * area * link.length**2)


def frequencies(scene: Scene) -> np.ndarray:
    """Angular frequencies [rad/s] with the motors locked."""
    return 2 * np.pi * natural_frequencies(scene, motor_angles(scene.mechanism, POSE))


def roots(function, count: int, last: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The first roots of a function above zero."""
    grid = np.linspace(1e-3, last, 20001)
    values = np.array([function(x) for x in grid])
    signs = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    return np.array([brentq(function, grid[i], grid[i + 1], xtol=1e-14) for i in signs[:count]])


@pytest.mark.parametrize(("basis", "modes", "tolerance"), [("assumed-modes", 3, 1e-8), ("craig-bampton", 14, 1e-5)])
def test_proximal_links_vibrate_as_cantilevers(basis: str, modes: int, tolerance: float) -> None:
    """cos(beta) cosh(beta) = -1, Blevins (1979), table 8-1: both legs alone, so every frequency twice."""
    scene = alone({"effects.proximal_bending": modes, "effects.basis": basis, **WEIGHTLESS_DISTAL})
    beta = np.array([1.87510407, 4.69409113, 7.85475744])
    expected = np.repeat(wave_speeds(scene, "proximal")[0] * beta**2, 2)
    np.testing.assert_allclose(frequencies(scene)[:6], expected, rtol=tolerance)


@pytest.mark.parametrize("basis", BASES)
def test_distal_links_vibrate_as_pinned_beams(basis: str) -> None:
    """(k pi)² sqrt(EI/(rho A l⁴)), Blevins (1979), table 8-1: elbows and end effector don't move."""
    scene = alone({"effects.distal_bending": 3, "effects.basis": basis})
    expected = np.repeat(wave_speeds(scene, "distal")[0] * (np.arange(1, 4) * np.pi) ** 2, 2)
    np.testing.assert_allclose(frequencies(scene), expected, rtol=1e-8)


@pytest.mark.parametrize(("basis", "modes", "tolerance"), [("assumed-modes", 3, 1e-8), ("craig-bampton", 12, 1e-3)])
def test_proximal_links_stretch_as_rods(basis: str, modes: int, tolerance: float) -> None:
    """(2k - 1) pi/2 sqrt(E/rho)/l, Blevins (1979), table 8-16."""
    scene = alone({"effects.proximal_axial": modes, "effects.basis": basis, **WEIGHTLESS_DISTAL})
    material, length = scene.mechanism.material, scene.mechanism.proximal.length
    speed = np.sqrt(material.youngs_modulus / material.density) / length
    expected = np.repeat((np.arange(1, 4) - 0.5) * np.pi * speed, 2)
    np.testing.assert_allclose(frequencies(scene)[:6], expected, rtol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize(("basis", "modes", "tolerance"), [("assumed-modes", 4, 1e-7), ("craig-bampton", 14, 3e-4)])
def test_thick_proximal_links_vibrate_as_timoshenko_cantilevers(basis: str, modes: int, tolerance: float) -> None:
    """Han, Benaroya and Wei (1999): characteristic equation of the clamped-free Timoshenko beam."""
    scene = alone(
        {"effects.proximal_bending": modes, "effects.basis": basis, "effects.beam": "timoshenko", **WEIGHTLESS_DISTAL}
    )
    rate, r, s = wave_speeds(scene, "proximal")

    def characteristic(square_root: float) -> float:
        w = square_root**2
        half = w * w * (r + s) / 2
        spread = np.sqrt((w * w * (r - s) / 2) ** 2 + w * w)
        a, b = np.sqrt(spread + half), np.sqrt(spread - half)
        g = s / r  # E/(k G)
        cosines = (a**4 + a**4 * g**2 + 4 * g * a**2 * b**2 + b**4 + g**2 * b**4) / (
            (b**2 + g * a**2) * (a**2 + g * b**2)
        )
        growth = np.exp(-b)
        return float(
            ((a**2 - b**2) * np.sin(a) * np.sinh(b) - a * b * cosines * np.cos(a) * np.cosh(b) - 2 * a * b) * growth
        )

    expected = np.repeat(rate * roots(characteristic, 3, 9.0) ** 2, 2)
    np.testing.assert_allclose(frequencies(scene)[:6], expected, rtol=tolerance)
    slender = frequencies(scene.replace({"effects.beam": "euler-bernoulli"}))
    assert slender[4] / frequencies(scene)[4] > 1.1


@pytest.mark.parametrize("inner", [0.0, 0.025])
def test_thick_distal_links_vibrate_as_pinned_timoshenko_beams(inner: float) -> None:
    """Han, Benaroya and Wei (1999): (k pi)⁴ - w² (1 + (k pi)² (r² + s²)) + w⁴ r² s² = 0 for pinned ends."""
    thick = {"effects.distal_bending": 3, "effects.beam": "timoshenko", "mechanism.distal.inner_diameter": inner}
    scene = alone(thick)
    rate, r, s = wave_speeds(scene, "distal")
    k = np.arange(1, 4) * np.pi
    expected = [rate * np.sqrt(min(np.roots([r * s, -(1 + n**2 * (r + s)), n**4]).real)) for n in k]
    np.testing.assert_allclose(frequencies(scene), np.repeat(expected, 2), rtol=1e-10)


@pytest.mark.parametrize("inner", [0.0, 0.03])
def test_a_thick_cantilever_yields_to_a_force_at_its_tip_by_bending_and_shear(inner: float) -> None:
    """F l³/(3 EI) + F l/(k G A): the static shape, which is the tip's displacement, has the inverse as stiffness, and that of
    the thin beam has F l³/(3 EI) alone. Modes of a clamped link begin with a positive curvature."""
    beam = {"mechanism.proximal": {"length": 0.24, "diameter": 0.06, "inner_diameter": inner}}
    basis = {"effects.basis": "craig-bampton", "effects.proximal_bending": 1, **WEIGHTLESS_DISTAL}
    u = standstill(motor_angles(alone({}).mechanism, POSE))
    thick, thin = (
        numeric_model(alone(basis | beam | {"effects.beam": kind})).static_stiffness(np.zeros(2), u).full()[0, 0]
        for kind in ("timoshenko", "euler-bernoulli")
    )
    scene = alone(beam)
    shear = wave_speeds(scene, "proximal")[2]
    assert thin / thick == pytest.approx(1.0 + 3.0 * shear, rel=1e-9)
    slender = slenderness(scene.mechanism, "proximal")
    static, *held = family_shapes("craig-bampton", "proximal", "bending", 4, slender)
    free = family_shapes("assumed-modes", "proximal", "bending", 4, slender)
    assert static.value(np.ones(1))[0] == pytest.approx(1.0, rel=1e-14)
    assert min(shape.strain(np.zeros(1))[0] for shape in (*held, *free)) > 0.0


SOUTHWELL = {3.0: (4.7973, 23.3203, 62.9850), 6.0: (7.3604, 26.8091, 66.6839), 12.0: (13.1702, 37.6031, 79.6145)}
"""Dimensionless rate of turning → flapping frequencies of a uniform cantilever without a hub.

Wright, Smith, Thresher and Wang, Vibration modes of centrifugally stiffened beams, J. Appl. Mech. 49 (1982), table 1.
"""


@pytest.mark.parametrize("rate", SOUTHWELL)
def test_turning_cantilevers_stiffen(rate: float) -> None:
    """Frequencies in the plane of turning are those of flapping less the rate: w² = w_flap² - rate²."""
    scene = alone({"effects.proximal_bending": 12, "effects.foreshortening": True, **WEIGHTLESS_DISTAL})
    unit = wave_speeds(scene, "proximal")[0]
    model = numeric_model(scene)
    u = np.concatenate([motor_angles(scene.mechanism, POSE), [rate * unit, rate * unit], [0.0, 0.0]])
    q = casadi.SX.sym("q", model.n)
    zeros = np.zeros(model.n)
    force = casadi.Function("stiffness", [q], [casadi.jacobian(model.elastic_forces(q, zeros, zeros, u), q)])
    squares = eigh(force(zeros).full(), model.mass_matrix(zeros, u).full(), eigvals_only=True) / unit**2
    expected = np.repeat(SOUTHWELL[rate], 2)
    np.testing.assert_allclose(np.sqrt(squares[:6] + rate**2), expected, rtol=2e-5)


def test_distal_links_buckle_under_eulers_load() -> None:
    """K_k = K_k0 (1 - P/P_k) with P_k = (k pi)² EI/l² (Euler): the payload's weight presses or pulls the distal links."""
    weight = {"effects.gravity": [0.0, -9.81], "payload.mass": 50.0, "mechanism.material.density": 1e-6}
    scene = alone({"effects.distal_bending": 2, "effects.foreshortening": True, **weight})
    joints = motor_angles(scene.mechanism, (0.0, 0.3))
    position, (elbow, _) = np.array((0.0, 0.3)), elbows(scene.mechanism, (0.0, 0.3))
    line = (position - elbow) / np.hypot(*(position - elbow))
    # both legs carry half of the weight along their lines; it presses where they come from below
    press = 50.0 * 9.81 / (2.0 * line[1])
    link = scene.mechanism.distal
    euler = np.pi**3 * scene.mechanism.material.youngs_modulus * link.diameter**4 / 64 / link.length**2
    loaded = numeric_model(scene).static_stiffness(np.zeros(4), standstill(joints)).full()
    free_scene = scene.replace({"effects.gravity": [0.0, 0.0]})
    free = numeric_model(free_scene).static_stiffness(np.zeros(4), standstill(joints)).full()
    factor = 1.0 - press / (euler * np.array([1.0, 4.0, 1.0, 4.0]))
    np.testing.assert_allclose(np.diag(loaded), np.diag(free) * factor, rtol=1e-10)
    assert abs(factor[0] - 1.0) > 1e-3


def test_a_bent_link_of_constant_length_pulls_the_end_effector_with_it() -> None:
    """A bent link's chord is shorter than its axis: arc length less chord of sin(pi xi) is q² pi²/(4 l) to second order."""
    scene = alone({"effects.distal_bending": 1, "effects.foreshortening": True})
    model, u = numeric_model(scene), standstill(motor_angles(scene.mechanism, POSE))
    q = np.array([3e-3, 0.0])
    moved = model.motion(q, np.zeros(2), np.zeros(2), u)[0].full().ravel()
    elbow, _ = elbows(scene.mechanism, POSE)
    length = scene.mechanism.distal.length
    assert length - np.hypot(*(moved - elbow)) == pytest.approx(q[0] ** 2 * np.pi**2 / (4 * length), rel=1e-9)


def elastica(force: float) -> tuple[float, float]:
    """Deflection and approach of the tip of a cantilever of length 1 and rigidity 1 under a force across it, by shooting."""

    def line(moment: float) -> np.ndarray:
        def rates(_: float, z: np.ndarray) -> list[float]:
            return [z[1], -force * np.cos(z[0]), np.sin(z[0]), 1.0 - np.cos(z[0])]

        return np.asarray(solve_ivp(rates, (0.0, 1.0), [0.0, moment, 0.0, 0.0], rtol=1e-12, atol=1e-13).y[:, -1])

    return tuple(line(brentq(lambda moment: line(moment)[1], 0.0, force, xtol=1e-13))[2:])


BISSHOPP_DRUCKER = {1.0: (0.30174, 0.05643), 2.0: (0.49349, 0.16056)}
"""P l²/(EI) → deflection and approach of the tip over the length: Q. Appl. Math. 3 (1945), figure 2, from its elliptic integrals."""


@pytest.mark.parametrize("load", BISSHOPP_DRUCKER)
def test_exact_bending_is_the_elastica(load: float) -> None:
    """The tip of a cantilever under a force deflects and approaches as in Bisshopp and Drucker (1945), by 49 % of the length and 16 %;
    errors fall with every mode."""
    expected = elastica(load)
    np.testing.assert_allclose(expected, BISSHOPP_DRUCKER[load], atol=2e-4)
    errors = []
    for modes in (1, 2, 4, 6):
        bent = {"effects.proximal_bending": modes, "effects.basis": "craig-bampton", "effects.foreshortening": "exact"}
        scene = alone(bent | WEIGHTLESS_DISTAL)
        link, model, five_bar = scene.mechanism.proximal, numeric_model(scene), assemble(scene)
        tips = [shape.tip for shape in family_shapes("craig-bampton", "proximal", "bending", modes)]
        rigidity = scene.mechanism.material.youngs_modulus * np.pi / 64 * link.diameter**4
        # the tip's force on the coordinates of both links
        u, still = standstill(motor_angles(scene.mechanism, POSE)), np.zeros(model.n)
        force = load * rigidity / link.length**2 * np.array(tips * 2)
        q = np.zeros(model.n)
        for fraction in np.linspace(0.1, 1.0, 10):
            for _ in range(6):
                left = model.elastic_forces(q, still, still, u).full()[:, 0] - fraction * force
                q -= np.linalg.solve(model.static_stiffness(q, u).full(), left)
        approach = TipMap(five_bar.robot).displacement("link11", "axial", casadi.SX(q))
        approach = casadi.evalf(casadi.substitute(approach, five_bar.registry.d, five_bar.registry.derived_at_start()))
        found = np.array([q[:modes] @ tips, -float(approach)]) / link.length
        errors.append(np.abs(found / expected - 1.0).max())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-4, errors


def test_small_deflections_foreshorten_alike() -> None:
    """Exact bending and foreshortening differ by the fourth order: a hundredth of the deflection, a ten-thousandth of the difference."""
    scenes = [
        alone({"effects.proximal_bending": 2, "effects.distal_bending": 1, "effects.foreshortening": kind})
        for kind in (True, "exact")
    ]
    u = np.concatenate([motor_angles(scenes[0].mechanism, POSE), [3.0, -2.0], [50.0, 80.0]])
    rng = np.random.default_rng(1)
    q, v, a = rng.normal(size=(3, 6)) * [[0.01], [1.0], [100.0]]

    def difference(scale: float) -> np.ndarray:
        forces = [numeric_model(each).elastic_forces(scale * q, scale * v, scale * a, u).full() for each in scenes]
        return np.asarray(forces[1] - forces[0])

    np.testing.assert_allclose(np.abs(difference(1e-2)).max(), 1e-4 * np.abs(difference(1e-0)).max(), rtol=1.0)


@pytest.mark.parametrize(("basis", "modes", "tolerance"), [("assumed-modes", 20, 1e-5), ("craig-bampton", 1, 1e-9)])
def test_cantilevers_sag_under_their_weight(basis: str, modes: int, tolerance: float) -> None:
    """Tip deflection w l⁴/(8 EI); the static shape alone gives it exactly, by Betti's reciprocity."""
    changes = {"effects.proximal_bending": modes, "effects.basis": basis, "effects.gravity": [0.0, -9.81]}
    scene = alone(changes | WEIGHTLESS_DISTAL)
    joints = motor_angles(scene.mechanism, POSE)
    tips = [shape.tip for shape in family_shapes(scene.effects.basis, "proximal", "bending", modes)]
    sag = static_equilibrium(scene, joints).elastic.reshape(2, modes) @ tips
    rate = wave_speeds(scene, "proximal")[0]
    np.testing.assert_allclose(sag, -9.81 * np.cos(joints) / (8.0 * rate**2), rtol=tolerance)


@pytest.mark.parametrize(
    "damping",
    [
        {"kind": "mass", "rate": 40.0},
        {"kind": "stiffness", "time": 1e-5},
        {"kind": "rayleigh", "rate": 40.0, "time": 1e-5},
    ],
)
@pytest.mark.parametrize("basis", BASES)
def test_proportional_damping_gives_rayleighs_ratios(damping: dict[str, object], basis: str) -> None:
    """zeta = rate/(2 w) + time w/2 for every mode of a link alone, in any basis (Clough and Penzien, section 12-3)."""
    beams = {"effects.proximal_bending": 3, "effects.basis": basis, **WEIGHTLESS_DISTAL}
    scene = alone(beams | {"effects.damping": damping})
    modes = damped_modes(scene, motor_angles(scene.mechanism, POSE))
    omega = 2 * np.pi * modes.frequencies
    expected = float(damping.get("rate", 0.0)) / (2 * omega) + float(damping.get("time", 0.0)) * omega / 2  # type: ignore[arg-type]
    np.testing.assert_allclose(modes.ratios, expected, rtol=1e-6)
    np.testing.assert_allclose(omega, frequencies(scene), rtol=1e-8)


def test_overdamped_motions_are_left_out() -> None:
    """With much damping the high modes creep instead of vibrating, and without elastic links nothing vibrates at all."""
    scene = load_scene("barnard2012-6kg").replace({"effects.damping": {"kind": "stiffness", "time": 1e-3}})
    modes, none = (damped_modes(each, motor_angles(each.mechanism, POSE)) for each in (scene, alone({})))
    assert 0 < len(modes.frequencies) < numeric_model(scene).n
    assert np.all(modes.ratios < 1.0)
    assert np.all(np.diff(modes.frequencies) > 0.0)
    assert none.frequencies.size == 0


def test_modal_damping_of_the_paper_s_shapes() -> None:
    """C_ii = 2 zeta sqrt(K_ii M_ii) of each link's own modes, nothing else: M = rho A l / sigma², sigma from Blevins (1979),
    table 8-1, and K = M beta⁴ EI/(rho A l⁴) in bending; M = rho A l / 2 and K = (k - 1/2)² pi² EA/(2 l) along the axis."""
    scene = load_scene("barnard2012-6kg").replace({"effects.damping": {"kind": "modal", "ratio": 0.2}})
    joints = motor_angles(scene.mechanism, POSE)
    model, u = numeric_model(scene), standstill(joints)
    v, still = casadi.SX.sym("v", model.n), np.zeros(model.n)
    force = casadi.jacobian(model.elastic_forces(still, v, still, u), v)
    damping = casadi.Function("damping", [v], [force])(still).full()

    def mass(group: str) -> float:
        link = getattr(scene.mechanism, group)
        return float(scene.mechanism.material.density * np.pi / 4 * link.diameter**2 * link.length)

    beta = np.array([1.87510407, 4.69409113, 7.85475744])
    sigma = np.array([0.734095514, 1.018467319, 0.999224497])
    bending = mass("proximal") / sigma**2 * wave_speeds(scene, "proximal")[0] * beta**2
    speed = np.sqrt(scene.mechanism.material.youngs_modulus / scene.mechanism.material.density)
    axial = mass("distal") / 2 * (np.arange(3) + 0.5) * np.pi * speed / scene.mechanism.distal.length
    expected = np.diag(0.4 * np.concatenate([bending, axial, bending, axial]))
    np.testing.assert_allclose(damping, expected, rtol=1e-8, atol=1e-12 * expected.max())


BARE = {
    "payload.mass": 0.0,
    "effects": {"gravity": [0.0, 0.0], "basis": "craig-bampton", "proximal_bending": 1, "distal_axial": 1},
}


@lru_cache
def bare(drive: str = "motion") -> SymbolicModel:
    """The model of a scene without any effect that can be left out."""
    return build_model(load_scene("barnard2012-6kg").replace(BARE | {"cosimulation.drive": drive}))


def stands_still(kind: str, *keys: str) -> dict[str, Any]:
    """A damping whose coefficients are zero."""
    return {"effects.damping": {"kind": kind} | dict.fromkeys(keys, 0.0)}


SWITCHED_OFF: tuple[dict[str, Any], ...] = (
    {"effects.proximal_axial": 0},
    {"effects.distal_bending": 0},
    {"effects.quasi_static": []},
    {"effects.beam": "euler-bernoulli", "mechanism.material.poissons_ratio": 0.1},
    {"effects.foreshortening": False},
    {"effects.gravity": [0.0, 0.0]},
    {"payload.mass": 0.0},
    {"payload.inertia": 0.0},
    stands_still("modal", "ratio"),
    stands_still("stiffness", "time"),
    stands_still("mass", "rate"),
    stands_still("rayleigh", "rate", "time"),
    {"effects.motor_inertia": 0.0},
    {"effects.joint_friction": {"viscous": 0.0, "coulomb": 0.0}},
    {"effects.joint_friction": {"kind": "stiction"}},
)


@pytest.mark.parametrize("off", SWITCHED_OFF)
def test_an_effect_that_is_switched_off_costs_nothing(off: dict[str, Any]) -> None:
    """Not a state, not a parameter, not a letter of C remains of it."""
    model = build_model(load_scene("barnard2012-6kg").replace(BARE | off))
    assert generate_functions(model) == generate_functions(bare())
    assert (model.unknowns, model.parameters) == (bare().unknowns, bare().parameters)


@pytest.mark.parametrize("drive", ["motion", "torque"])
def test_a_robot_without_elasticity_has_no_elastic_state(drive: str) -> None:
    """Rigid links leave the motors' angles alone, and less than half of the operations."""
    changes = {"effects.proximal_bending": 0, "effects.distal_axial": 0, "cosimulation.drive": drive}
    rigid = build_model(load_scene("barnard2012-6kg").replace(BARE | changes))
    assert rigid.degrees_of_freedom == (2 if drive == "torque" else 0)
    assert not any("bending" in variable.name or "axial" in variable.name for variable in rigid.outputs)
    operations = [model.functions["residual"].n_instructions() for model in (rigid, bare(drive))]
    assert operations[0] < 0.5 * operations[1]


def test_the_papers_model_stays_small() -> None:
    """Effects that a scene leaves out don't creep into its equations: 953 operations for the paper's 12 coordinates."""
    model = build_model(load_scene("barnard2012-6kg"))
    assert model.functions["residual"].n_instructions() <= 953
    assert model.functions["mass_matrix"].n_instructions() <= 1195
    assert model.functions["outputs"].n_instructions() <= 747


def test_every_effect_is_registered() -> None:
    """A class that `EFFECTS` doesn't name would be left out of every model without a word."""
    modules = [path.stem for path in (Path(__file__).parents[2] / "model").glob("*.py")]
    classes = [each for name in modules for each in vars(import_module(f"flexfmu.model.{name}")).values()]
    kinds = {each for each in classes if inspect.isclass(each) and issubclass(each, Effect)}
    assert {each for each in kinds if not inspect.isabstract(each)} == set(effect_classes())


RICH = {
    "payload.inertia": 0.01,
    "effects.basis": "craig-bampton",
    "effects.proximal_axial": 1,
    "effects.distal_bending": 1,
    "effects.quasi_static": ["proximal_axial"],
    "effects.beam": "timoshenko",
    "effects.foreshortening": True,
    "effects.motor_inertia": 0.01,
    "effects.joint_friction": {"viscous": 0.1},
    "effects.transmission": {"stiffness": 1e4},
}
RIGID = {"effects.proximal_bending": 0, "effects.distal_axial": 0}


@pytest.fixture(params=[{}, RICH, RIGID], ids=["the paper's", "rich", "rigid"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("barnard2012-6kg").replace(request.param)


def test_each_step_can_be_taken_back(scene: Scene) -> None:
    """Whoever adds an effect finds the scene again among the reductions, so that a search can't get stuck."""
    for neighbour in enrichments(scene):
        assert scene.effects in [back.scene.effects for back in reductions(neighbour.scene)], neighbour.change


def test_everything_can_be_left_out_one_by_one(scene: Scene) -> None:
    """Reductions lead from any scene to rigid links under the payload alone, which has no reduction."""
    steps = 0
    while left := reductions(scene):
        scene, steps = left[-1].scene, steps + 1
        assert steps < 50
    assert not any((scene.effects.proximal_bending, scene.effects.distal_axial, *scene.effects.gravity))
    assert scene.payload.mass == 6.0


def test_enrichments_of_the_papers_scene_name_what_the_paper_leaves_out() -> None:
    """One entry for each effect or mode more, by the keys of the scene file."""
    found = [(neighbour.effect, neighbour.change) for neighbour in enrichments(load_scene("barnard2012-6kg"))]
    assert found == [
        ("proximal_axial", "1 mode, deflecting statically"),
        ("proximal_axial", "1 mode instead of 0"),
        ("proximal_bending", "4 modes instead of 3"),
        ("distal_axial", "4 modes instead of 3"),
        ("distal_bending", "1 mode instead of 0"),
        ("beam", "with shear and rotary inertia"),
        ("foreshortening", "with foreshortening"),
    ]
