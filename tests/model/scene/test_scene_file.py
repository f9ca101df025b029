"""Scene files: what is shipped, what a file may leave out, and what is said of files that can't be read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.model.scene.effects import ModalDampingSection, NoDampingSection
from flexfmu.model.scene.errors import SceneError, SceneWarning
from flexfmu.model.scene.file import load_scene, read_scene_text, shipped_scenes

TEXT = read_scene_text("barnard2012-6kg")[0]


def test_errors_name_the_file(tmp_path: Path) -> None:
    """Broken TOML, a missing file, a folder and an unknown name each say what they are about."""
    path = tmp_path / "broken.toml"
    path.write_text("name = [")
    with pytest.raises(SceneError, match=r"not a TOML file.*broken\.toml"):
        load_scene(path)
    with pytest.raises(SceneError, match=r"no scene file.*barnard2012-6kg"):
        load_scene(tmp_path / "missing.toml")
    with pytest.raises(SceneError, match="cannot read scene file"):
        load_scene(tmp_path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(SceneError, match="not UTF-8"):
        load_scene(path)


def test_the_papers_scenes_are_shipped() -> None:
    """Both are found by name, with the values that the paper gives, and survive the way through plain data."""
    assert {"barnard2012-6kg", "barnard2012-0.1kg"} <= set(shipped_scenes())
    scene = load_scene("barnard2012-6kg")
    assert (scene.mechanism.proximal.length, scene.payload.mass, scene.unit_hints) == (0.24, 6.0, ())
    assert scene.effects.damping == ModalDampingSection(kind="modal", ratio=0.1357)
    assert scene.replace({}) == scene


def test_a_scene_shows_its_sections() -> None:
    """In a notebook each section is a row, with the keys that differ from their defaults."""
    html = load_scene("barnard2012-6kg")._repr_html_()
    for key, text in (
        ("payload", "mass = 6.0"),
        ("trajectory", "duration = 0.43"),
        ("mechanism", "base_half_distance"),
    ):
        assert re.search(f"<th>{key}</th><td>[^<]*{text}", html)


def test_damping_may_be_left_out_or_none(tmp_path: Path) -> None:
    """A scene without `damping` is undamped, as with `{ kind = "none" }`, whose name is enough."""
    path = tmp_path / "scene.toml"
    path.write_text(TEXT.replace('damping = { kind = "modal", ratio = 0.1357 }', ""))
    for scene in (load_scene(path), load_scene(path, {"effects.damping": "none"})):
        assert scene.effects.damping == NoDampingSection()


JUNK = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.lists(st.integers(), max_size=3)
)
KEYS = (
    "name",
    "mechanism.material",
    "payload",
    "effects.gravity",
    "effects.damping",
    "trajectory.profile",
    "nonsense.key",
)


@settings(max_examples=60)
@given(st.sampled_from(KEYS), JUNK)
def test_junk_is_a_scene_or_a_scene_error_never_a_crash(key: str, value: object) -> None:
    """Any value at any key either makes a valid scene or is refused on one line."""
    message = ""
    try:
        load_scene("barnard2012-6kg").replace({key: value})
    except SceneError as error:
        message = str(error)
    assert "\n" not in message


@pytest.mark.parametrize(("old", "new", "hint"), [
    ("youngs_modulus = 70e9", "youngs_modulus = 210.0", r"= 210 Pa is below 1e8 Pa: it is in Pa, 1 GPa is 1e9 Pa"),
    ("density = 2710.0", "density = 2.71", r"= 2\.71 kg/m3 is below 100 kg/m3: 1 g/cm3 is 1000 kg/m3"),
    ("diameter = 0.035", "diameter = 35.0", r"`mechanism.proximal.diameter` = 35 m is above half the length, 0.24 m"),
])  # fmt: skip
def test_values_that_suggest_another_unit_are_hinted_at(tmp_path: Path, old: str, new: str, hint: str) -> None:
    """Soft, light or thick links can be meant, so the scene is read; the warning names key, value and the likely unit."""
    path = tmp_path / "scene.toml"
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.warns(SceneWarning, match=hint):
        scene = load_scene(path)
    assert all(each.startswith("`mechanism.") for each in scene.unit_hints)
