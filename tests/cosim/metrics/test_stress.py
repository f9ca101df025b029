"""Stresses of the links against the strength of materials, and against finite elements."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.stress import LinkStress, link_stresses
from flexfmu.cosim.reports.summary import stress_table, summarise
from flexfmu.model.beams import scene_shapes
from flexfmu.model.finite_elements.motion import equilibrium
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.numeric import numeric_model
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.statics import static_equilibrium

MakeRun = Callable[..., Run]
YOUNG, LENGTH, DIAMETER = 70e9, 0.24, 0.035
INERTIA = math.pi * DIAMETER**4 / 64.0
CRAIG_BAMPTON = {"effects.basis": "craig-bampton", "effects.proximal_bending": 1, "effects.distal_axial": 0}
CRAIG_BAMPTON |= {"mechanism.material.yield_strength": 2e8}


def stresses(
    make_run: MakeRun, changes: Mapping[str, object], coordinates: Mapping[str, float]
) -> dict[str, LinkStress]:
    """The stresses by link, where modal coordinates grow and fall like a sine of half a period up to these values."""
    time = np.linspace(0.0, 1.0, 22)
    wave = [math.pi**k * np.sin(math.pi * time + 0.5 * math.pi * k) for k in range(3)]
    columns = {name: Column("m", *(value * each for each in wave)) for name, value in coordinates.items()}
    run = replace(make_run(changes=changes), recording=Recording(time, columns))
    return {each.link: each for each in link_stresses(run)}


@pytest.mark.parametrize("inner", [0.0, 0.01, 0.028, 0.0345])
@pytest.mark.parametrize(("link", "length", "diameter"), [("link11", 0.24, 0.035), ("link21", 0.31, 0.05)])
def test_cantilever_with_a_force_at_its_tip(
    make_run: MakeRun, link: str, length: float, diameter: float, inner: float
) -> None:
    """M c / I at the clamp of a rod or a tube, when the force is largest, which lies between two communication points."""
    force, inertia = 300.0, math.pi * (diameter**4 - inner**4) / 64.0
    tip = force * length**3 / (3.0 * YOUNG * inertia)
    tube = {"mechanism.proximal": {"length": length, "diameter": diameter, "inner_diameter": inner}}
    found = stresses(make_run, CRAIG_BAMPTON | tube, {f"{link}.bending[1]": tip})[link]
    exact = force * length * diameter / 2.0 / inertia
    assert found.bending is not None
    assert found.bending.value == pytest.approx(exact, rel=1e-6)
    assert (found.bending.place, found.bending.time) == (0.0, pytest.approx(0.5))
    assert found.axial is None
    assert found.combined == found.bending
    assert found.safety == pytest.approx(2e8 / exact, rel=1e-6)
    assert found.change is None
    assert bool(list(found.exceeded)) == (exact > 2e8)


@pytest.mark.parametrize(("modes", "error"), [(1, 0.138), (2, -0.044), (3, 0.021), (5, 0.008)])
def test_truncation_of_assumed_modes(make_run: MakeRun, modes: int, error: float) -> None:
    """Under a tip force the clamp's stress is that far off with so many assumed modes, as the page says; the change without
    the highest mode is that of the sum of their moments, and larger than the error."""
    changes = {**CRAIG_BAMPTON, "effects.basis": "assumed-modes", "effects.proximal_bending": modes}
    shapes = scene_shapes(make_run(changes=changes).scene)["proximal", "bending"]
    xi = (np.polynomial.legendre.leggauss(60)[0] + 1.0) / 2.0
    weights = np.polynomial.legendre.leggauss(60)[1] / 2.0
    stiffness = [YOUNG * INERTIA / LENGTH**3 * float(weights @ shape.strain(xi) ** 2) for shape in shapes]
    tips = {f"link11.bending[{k}]": s.tip / c for k, (s, c) in enumerate(zip(shapes, stiffness, strict=True), start=1)}
    found = stresses(make_run, changes, tips)["link11"]
    assert found.combined is not None
    assert found.combined.value / (LENGTH * DIAMETER / 2.0 / INERTIA) - 1.0 == pytest.approx(error, abs=6e-4)
    if modes == 1:
        assert found.change is None
        return
    at_clamp = [float(shape.strain(np.zeros(1))[0]) for shape in shapes]
    moments = np.cumsum(np.multiply(at_clamp, [*tips.values()]))
    assert found.change == pytest.approx(abs(moments[-2] / moments[-1] - 1.0), rel=1e-6)
    assert found.change is not None
    assert found.change > abs(error)


@pytest.mark.parametrize("inner", [0.0, 0.02])
def test_distal_links_under_forces(make_run: MakeRun, inner: float) -> None:
    """F / A all along a rod or a tube; M c / I of the load p sin(pi x / L) on pinned ends, whose moment is p (L / pi)^2 in the
    middle; the sum where both are known."""
    outer, length, load = 0.03, 0.38079, 900.0
    area, inertia = math.pi * (outer**2 - inner**2) / 4.0, math.pi * (outer**4 - inner**4) / 64.0
    changes = {**CRAIG_BAMPTON, "effects.distal_axial": 1, "effects.distal_bending": 1}
    changes |= {"mechanism.distal": {"length": length, "diameter": outer, "inner_diameter": inner}}
    pull = 500.0 * length / (YOUNG * area)
    sag = load * (length / math.pi) ** 4 / (YOUNG * inertia)
    found = stresses(make_run, changes, {"link12.axial[1]": -pull, "link22.axial[1]": pull, "link22.bending[1]": sag})
    rod, both = found["link12"], found["link22"]
    assert rod.axial is not None
    assert rod.axial.value == pytest.approx(500.0 / area, rel=1e-6)
    assert rod.bending is None
    assert both.combined is not None
    assert both.bending is not None
    assert both.bending.value == pytest.approx(load * (length / math.pi) ** 2 * outer / 2.0 / inertia, rel=1e-6)
    assert both.bending.place == pytest.approx(length / 2.0, rel=1e-12)
    assert both.combined.value == pytest.approx(both.bending.value + 500.0 / area, rel=1e-6)


def test_links_without_modes_have_no_stress(make_run: MakeRun) -> None:
    """What modal coordinates don't tell is unknown, not zero."""
    rigid = stresses(make_run, {**CRAIG_BAMPTON, "effects.proximal_bending": 0}, {})
    for each in rigid.values():
        assert each.bending is each.axial is each.combined is each.safety is each.change is None
        assert not list(each.exceeded)


def test_summary_and_warning(make_run: MakeRun) -> None:
    """With a yield strength the summary has a row for each link, and says where it is exceeded."""
    run = make_run(changes={**CRAIG_BAMPTON, "mechanism.material.yield_strength": 1e7})
    links = summarise(run, {})["stresses"]
    assert [link["link"] for link in links] == ["link11", "link21", "link12", "link22"]
    assert "link11: stress of" in links[0]["exceeded"][0]
    assert "exceeds the yield strength of 10 MPa" in links[0]["exceeded"][0]
    rows = dict(stress_table(links).rows)
    assert rows["link22"] == "no modes, stress not known"
    assert " MPa at 0 mm, " in rows["link11"]
    assert "stresses" not in summarise(make_run(), {})


@pytest.mark.parametrize(
    ("value", "message"), [(0.0, "must be above 0.0 Pa"), (2e11, "must be below `youngs_modulus`")]
)
def test_strengths_that_no_material_has(value: float, message: str) -> None:
    """The key, the value and the unit are named."""
    with pytest.raises(SceneError, match=message):
        load_scene("barnard2012-6kg").replace({"mechanism.material.yield_strength": value})


def test_finite_elements_agree_at_rest(make_run: MakeRun) -> None:
    """At rest under gravity the finite elements hold link 11 by the motor's torque, which is the moment at its clamp."""
    changes = {
        **CRAIG_BAMPTON,
        "effects.proximal_bending": 2,
        "effects.damping": "none",
        "effects.foreshortening": True,
    }
    run = make_run(changes=changes)
    joints = run.plan.joints.evaluate(0.0, 0)[0, 0]
    elements = equilibrium(finite_element_robot(run.scene, 4), joints)
    state = static_equilibrium(run.scene, joints)
    names = numeric_model(run.scene).names
    found = stresses(make_run, changes, dict(zip(names, state.elastic.tolist(), strict=True)))["link11"]
    assert found.combined is not None
    exact = abs(float(elements.torque[0])) * DIAMETER / 2.0 / INERTIA
    assert found.combined.value == pytest.approx(exact, rel=2e-3)
