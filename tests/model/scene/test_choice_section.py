"""`select = "auto"` in scene files: what belongs together, what contradicts it, and what follows from it."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import pytest

from flexfmu.model.five_bar import assemble
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import parse_scene

AUTO: dict[str, Any] = {
    "gravity": [0.0, -9.81],
    "damping": {"kind": "modal", "ratio": 0.1357},
    "select": "auto",
    "tolerance": 0.01,
    "of": ["peak_position_error", "residual_vibration_amplitude"],
}


def data(**effects: Any) -> dict[str, Any]:
    """The paper's scene with other effects, without a tolerance of its own for the FMU."""
    scene = load_scene("barnard2012-6kg").model_dump(exclude_none=True)
    del scene["cosimulation"]["tolerance"]
    return scene | {"effects": {key: value for key, value in (AUTO | effects).items() if value is not None}}


def test_the_other_half_of_the_tolerance_is_the_integrators() -> None:
    """Half the tolerance goes to the FMU unless the scene gives one, and no looser one than saves time."""
    assert parse_scene(data(tolerance=0.001), "test").cosimulation.tolerance == 0.0005
    assert parse_scene(data(tolerance=0.5), "test").cosimulation.tolerance == 0.001
    assert parse_scene(data(tolerance=2), "test").cosimulation.tolerance == 0.001
    own = data()
    own["cosimulation"]["tolerance"] = 1e-7
    assert parse_scene(own, "test").cosimulation.tolerance == 1e-7


def test_the_scene_file_of_the_shipped_scenes_can_be_left_to_the_choice() -> None:
    """Basis and tolerance follow; the scene survives being written and read."""
    scene = parse_scene(data(), "test")
    assert scene.effects.basis == "craig-bampton"
    assert scene.replace({}) == scene
    assert "select" not in files("flexfmu.model.scene").joinpath("scenes", "barnard2012-6kg.toml").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize(
    ("effects", "sentence"),
    [
        (
            {"distal_axial": 1},
            r"in `effects`: `select = \"auto\"` chooses `distal_axial`: remove it, or remove `select`",
        ),
        (
            {"beam": "timoshenko", "foreshortening": True},
            r"`select = \"auto\"` chooses `beam`, `foreshortening`: remove them",
        ),
        ({"basis": "assumed-modes"}, r"`select = \"auto\"` needs `basis = \"craig-bampton\"`.*got 'assumed-modes'"),
        ({"tolerance": None}, r"`tolerance` is missing: `select = \"auto\"` needs `tolerance = 0\.01`"),
        ({"of": []}, r"`of` is missing"),
        ({"of": ["settling_time"]}, r"`effects\.of\[0\]` must be 'peak_torque_1', .* got 'settling_time'"),
        ({"tolerance": 1e-30}, r"^`effects\.tolerance` must be at least 2e-12, got 1e-30 \(test\)$"),
        ({"tolerance": "fine"}, r"^`effects\.tolerance` must be a valid number, got 'fine' \(test\)$"),
        (
            {"select": None, "basis": "craig-bampton"},
            r"`tolerance` belongs to `select = \"auto\"`: add that, or remove",
        ),
    ],
)
def test_contradictions_are_refused_in_one_sentence(effects: dict[str, Any], sentence: str) -> None:
    """Whoever mixes own choice and automatic choice learns which key to remove."""
    with pytest.raises(SceneError, match=sentence):
        parse_scene(data(**effects), "test")


def test_a_residual_vibration_needs_a_dwell() -> None:
    """Without a standstill there is nothing to hold."""
    scene = data()
    scene["trajectory"]["dwell"] = 0.0
    with pytest.raises(SceneError, match=r"names residual_vibration_amplitude, but `trajectory\.dwell` is 0 s"):
        parse_scene(scene, "test")


def test_an_open_choice_is_never_simulated_by_accident() -> None:
    """The model of a scene that hasn't been resolved would be a rigid one."""
    with pytest.raises(SceneError, match="leaves the choice of effects open"):
        assemble(parse_scene(data(), "test"))
