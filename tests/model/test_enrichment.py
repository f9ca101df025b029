"""The neighbours of a scene, one effect richer or poorer."""

from __future__ import annotations

import pytest

from flexfmu.model.enrichment import enrichments, reductions
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene

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
