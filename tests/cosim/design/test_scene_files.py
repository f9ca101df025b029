"""Scene files of their own hold what TOML can."""

from __future__ import annotations

from pathlib import Path

from flexfmu.cosim.design.scene_files import write_new
from flexfmu.model.scene.file import load_scene


def test_a_choice_of_effects_without_all_errors_is_left_out(tmp_path: Path) -> None:
    """TOML has no null for a metric whose error isn't estimated; the effects themselves stay, as for tuned and planned scenes."""
    choice = {"tolerance": 1e-3, "of": ["peak_torque_1", "settling_time"], "error": [1e-4, None], "effects": []}
    scene = load_scene("barnard2012-6kg").replace({"effects.choice": choice, "effects.distal_bending": 2})
    found = load_scene(write_new(scene, tmp_path / "new.toml", ["Made by a test."]))
    assert found.effects.choice is None
    assert found.effects.distal_bending == 2
    assert (tmp_path / "new.toml").read_text().startswith("# Made by a test.\n")
