"""Scene files: what is shipped, what is refused, and what the refusal says."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.model.scene.effects import ModalDampingSection, NoDampingSection
from flexfmu.model.scene.errors import SceneError, SceneWarning
from flexfmu.model.scene.file import load_scene, shipped_scenes

WRONG_VALUES = {
    "negative mass": ({"payload.mass": -0.1}, r"`payload\.mass` must be at least 0\.0 kg, got -0\.1 kg"),
    "unknown key": ({"payload.weight": 1.0}, r"`payload\.weight` is not a known key: known keys here: `mass`"),
    "misspelt key": (
        {"trajectory.durations": 1.0},
        r"`trajectory\.durations` is not a known key: did you mean `duration`\?",
    ),
    "missing key": ({"effects.damping": {"kind": "modal"}}, r"`effects\.damping\.ratio` is missing"),
    "key of another kind": (
        {"effects.damping": {"kind": "none", "ratio": 0.1}},
        r"`effects\.damping\.ratio` is not a known key",
    ),
    "unknown kind": (
        {"effects.damping": {"kind": "foo"}},
        r"`effects\.damping\.kind` must be one of 'none', 'modal', 'stiffness'",
    ),
    "kind of a profile": ({"trajectory.profile": {"kind": "sine"}}, r"`trajectory\.profile\.kind` must be 'poly7'"),
    "wrong type": (
        {"mechanism.proximal.length": "a"},
        r"`mechanism\.proximal\.length` must be a valid number in m, got 'a'",
    ),
    "boolean for a number": ({"payload.mass": True}, r"`payload\.mass` must be a valid number in kg, got True"),
    "fraction of a mode": ({"effects.proximal_bending": 2.5}, r"`effects\.proximal_bending` must be a valid integer"),
    "vector too long": (
        {"trajectory.start": [1.0, 2.0, 3.0]},
        r"`trajectory\.start` must be an array of 2 values in m, got \[1\.0, 2\.0, 3\.0\]",
    ),
    "number for a vector": (
        {"trajectory.lift": 1.0},
        r"`trajectory\.lift` must be an array like \[1\.0, 2\.0\], got 1\.0",
    ),
    "word for a switch": (
        {"effects.foreshortening": "yes"},
        r"`effects\.foreshortening` must be true or false, got 'yes'",
    ),
    "one name for many": (
        {"effects.quasi_static": "distal_axial"},
        r"`effects\.quasi_static` must be an array like \[\"proximal_bending\", \"proximal_axial\"\], got 'distal_axial'",
    ),
    "word for a table": ({"trajectory.blend": "lame"}, r"`trajectory\.blend` must be a table like \{ key = value \}"),
    "number for a damping": ({"effects.damping": 3}, r"`effects\.damping` must be a table"),
    "word for a damping with a number": (
        {"effects.damping": "modal"},
        r"`effects\.damping\.ratio` is missing: add it",
    ),
    "unknown word for a damping": (
        {"effects.damping": "nope"},
        r"`effects\.damping\.kind` must be one of 'none', 'modal', 'stiffness', 'mass', 'rayleigh', got 'nope'",
    ),
    "unknown word for a step": (
        {"cosimulation.step": "fast"},
        r"`cosimulation\.step`: must be a time above 0 s, or \"auto\"",
    ),
    "damping without a kind": (
        {"effects.damping": {"ratio": 0.1}},
        r"`effects\.damping\.kind` must be one of 'none', 'modal', 'stiffness', 'mass', 'rayleigh', but is missing",
    ),
    "profile without a kind": (
        {"trajectory.profile": {}},
        r"`trajectory\.profile\.kind` is missing: add it, one of 'poly7', 'poly5', 'bang-bang', 'trapezoidal', ",
    ),
    "word for a profile with a number": ({"trajectory.profile": "trapezoidal"}, r"needs 0 < ramp <= 0\.5"),
    "table for a vector": (
        {"trajectory.start": {"x": 0.1}},
        r"`trajectory\.start` must be an array like \[1\.0, 2\.0\] in m, got \{'x': 0\.1\}",
    ),
    "path as a name": ({"name": "a/b"}, r"`name` must be made of letters, digits"),
    "word in a vector": ({"trajectory.start": [1.0, "b"]}, r"`trajectory\.start\[1\]` must be a valid number in m"),
    "not a number": (
        {"trajectory.duration": float("nan")},
        r"`trajectory\.duration` must be a finite number in s, got nan",
    ),
    "contradicting modes": (
        {"mechanism.assembly_mode": "right"},
        r"`mechanism\.assembly_mode` must be 'left' for `working_mode` = 'elbows-out' at the start pose",
    ),
    "out of reach": (
        {"trajectory.start": [0.0, 5.0]},
        r"5\.001 m from the base .* a leg reaches 0\.14079 to 0\.62079 m",
    ),
    "tube without a wall": (
        {"mechanism.proximal.inner_diameter": 0.1},
        r"`inner_diameter` must be below `diameter` = 0\.035 m",
    ),
    "ramp of a polynomial": (
        {"trajectory.profile": {"kind": "poly7", "ramp": 0.2}},
        r"`ramp` = 0\.2 belongs to profile `trapezoidal` or `double-s` alone: remove it from `poly7`",
    ),
    "phases longer than their ramp": (
        {"trajectory.profile": {"kind": "double-s", "ramp": 0.2, "jerk_phase": 0.15}},
        r"in `trajectory\.profile`: jerk_phase must be at most half of ramp = 0\.2, which is 0\.1 of the duration, got 0\.15",
    ),
    "polynomial without coefficients": (
        {"trajectory.profile": "polynomial"},
        r"`coefficients` is missing: profile `polynomial` needs coefficients = \[0, 0, c2, c3, \.\.\.\]",
    ),
    "one coefficient": (
        {"trajectory.profile": {"kind": "polynomial", "coefficients": 1.0}},
        r"`trajectory\.profile\.coefficients` must be an array like \[1\.0, 2\.0\], got 1\.0",
    ),
    "polynomial that ends elsewhere": (
        {"trajectory.profile": {"kind": "polynomial", "coefficients": [0, 0, 3, -1]}},
        r"coefficients \[0\.0, 0\.0, 3\.0, -1\.0\] must end at 1: its coefficients must have the sum 1, got 2",
    ),
    "trapezoid without a ramp": ({"trajectory.profile": {"kind": "trapezoidal"}}, r"needs 0 < ramp <= 0\.5"),
    "ramp too long": (
        {"trajectory.profile": {"kind": "trapezoidal", "ramp": 0.7}},
        r"`trajectory\.profile\.ramp` must be at most 0\.5",
    ),
    "blend higher than the lift": (
        {"trajectory.blend.height": 0.03},
        r"`blend\.height` must be at most `height` = 0\.025 m",
    ),
    "blends that overlap": ({"trajectory.blend.width": 0.2}, r"`blend\.width` must be at most `width`/2 = 0\.175 m"),
    "lift without a direction": ({"trajectory.lift": [0.0, 0.0]}, r"`lift` must be a direction"),
    "tolerance out of range": ({"cosimulation.tolerance": 1.0}, r"`cosimulation\.tolerance` must be at most 0\.1"),
    "tolerance below rounding": (
        {"cosimulation.tolerance": 1e-13},
        r"in `cosimulation\.tolerance`: must be at least 1e-12, got 1e-13: below, rounding errors decide",
    ),
    "spring without a motor behind it": (
        {"cosimulation.drive": "torque", "effects.transmission": {"stiffness": 1e4}},
        r"`effects\.transmission` needs `effects\.motor_inertia` above 0 kg\.m2",
    ),
    "millimetres": (
        {"mechanism.base_half_distance": 100.0, "mechanism.proximal.length": 240.0, "mechanism.distal.length": 380.79},
        r"a leg reaches .*; `mechanism\.proximal\.length` = 240 m is above 10 m: lengths are in m, millimetres are 1e-3 m",
    ),
    "unknown beam theory": ({"effects.beam": "thick"}, r"`effects\.beam` must be 'euler-bernoulli' or 'timoshenko'"),
    "unknown basis": ({"effects.basis": "finite-elements"}, r"must be 'assumed-modes' or 'craig-bampton'"),
    "impossible material": (
        {"mechanism.material.poissons_ratio": 0.6},
        r"`mechanism\.material\.poissons_ratio` must be at most 0\.5, got 0\.6",
    ),
    "negative inertia": (
        {"payload.inertia": -1.0},
        r"`payload\.inertia` must be at least 0\.0 kg\.m2, got -1\.0 kg\.m2",
    ),
    "damping of another kind": (
        {"effects.damping": {"kind": "mass", "time": 1e-4}},
        r"`effects\.damping\.rate` is missing: add it \(in 1/s\)",
    ),
    "static family twice": (
        {"effects.quasi_static": ["distal_axial", "distal_axial"]},
        r"`quasi_static` names distal_axial twice",
    ),
    "zero duration": ({"trajectory.duration": 0.0}, r"`trajectory\.duration` must be above 0\.0 s, got 0\.0 s"),
}


def test_the_papers_scenes_are_shipped() -> None:
    """Both of the paper's scenes are found by name, with the values that the paper gives."""
    assert {"barnard2012-6kg", "barnard2012-0.1kg"} <= set(shipped_scenes())
    scene = load_scene("barnard2012-6kg")
    assert scene.mechanism.proximal.length == 0.24
    assert scene.payload.mass == 6.0
    assert scene.effects.damping == ModalDampingSection(kind="modal", ratio=0.1357)


@pytest.mark.parametrize(("changes", "message"), WRONG_VALUES.values(), ids=WRONG_VALUES.keys())
def test_a_wrong_value_is_one_sentence_with_key_value_unit_and_remedy(changes: dict[str, object], message: str) -> None:
    """A user sees what is wrong and what would be right, on one line."""
    with pytest.raises(SceneError, match=message) as error:
        load_scene("barnard2012-6kg").replace(changes)
    assert "\n" not in str(error.value)
    assert "barnard2012-6kg" in str(error.value)


def test_damping_may_be_left_out_or_none(tmp_path: Path) -> None:
    """Keys with a default: a scene without `damping` is undamped, as with `{ kind = "none" }`."""
    text = shipped_text().replace('damping = { kind = "modal", ratio = 0.1357 }', "")
    path = tmp_path / "scene.toml"
    path.write_text(text)
    assert load_scene(path).effects.damping == NoDampingSection()
    path.write_text(text.replace("proximal_bending = 3", 'proximal_bending = 3\ndamping = { kind = "none" }'))
    assert load_scene(path).effects.damping == NoDampingSection()


def test_a_word_stands_for_a_table_of_its_kind_alone() -> None:
    """Where a kind has no other key that must be given, its name is enough."""
    scene = load_scene("barnard2012-6kg")
    for key, word in (
        ("effects.damping", "none"),
        ("trajectory.profile", "bang-bang"),
        ("cosimulation.loop_solver", "anderson"),
        ("cosimulation.loop_solver", "fixed-point"),
    ):
        assert scene.replace({key: word}) == scene.replace({key: {"kind": word}})


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


def test_a_scene_survives_the_way_through_plain_data() -> None:
    """`replace` without changes is the identity, so no default gets lost."""
    scene = load_scene("barnard2012-0.1kg")
    assert scene.replace({}) == scene


def shipped_text() -> str:
    from importlib.resources import files

    return files("flexfmu.model.scene").joinpath("scenes/barnard2012-6kg.toml").read_text()


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.lists(st.integers(), max_size=3),
    st.just({}),
)
KEYS = [
    "name",
    "mechanism.base_half_distance",
    "mechanism.material",
    "payload",
    "effects.gravity",
    "effects.damping",
    "trajectory.blend.kind",
    "trajectory.profile",
    "cosimulation.step",
    "nonsense.key",
]


@pytest.mark.slow
@settings(max_examples=300)
@given(st.sampled_from(KEYS), JUNK)
def test_junk_is_a_scene_or_a_scene_error_never_a_crash(key: str, value: object) -> None:
    """Any value at any key either makes a valid scene or is refused on one line."""
    message = ""
    try:
        load_scene("barnard2012-6kg").replace({key: value})
    except SceneError as error:
        message = str(error)
    assert "\n" not in message


@pytest.mark.parametrize("name", [".", "..", "-", "+."])
def test_names_are_names_of_folders_too(name: str) -> None:
    """Results go into a folder of the scene's name: dots alone would lead elsewhere."""
    with pytest.raises(SceneError, match="name"):
        load_scene("barnard2012-6kg").replace({"name": name})


def test_values_have_no_keys() -> None:
    """A dotted key that goes on below a value is told with that value."""
    with pytest.raises(SceneError, match=r"payload\.mass\.x: payload\.mass is the value 6\.0, not a section"):
        load_scene("barnard2012-6kg").replace({"payload.mass.x": 3})


@pytest.mark.parametrize(
    ("old", "new", "hint"),
    [
        ("youngs_modulus = 70e9", "youngs_modulus = 210.0", r"= 210 Pa is below 1e8 Pa: it is in Pa, 1 GPa is 1e9 Pa"),
        ("density = 2710.0", "density = 2.71", r"= 2\.71 kg/m3 is below 100 kg/m3: 1 g/cm3 is 1000 kg/m3"),
        (
            "diameter = 0.035",
            "diameter = 35.0",
            r"`mechanism\.proximal\.diameter` = 35 m is above half the length, 0\.24 m",
        ),
    ],
)
def test_values_that_suggest_another_unit_are_hinted_at(tmp_path: Path, old: str, new: str, hint: str) -> None:
    """Soft, light or thick links can be meant, so the scene is read; the warning names key, value and the likely unit."""
    path = tmp_path / "scene.toml"
    path.write_text(shipped_text().replace(old, new, 1))
    with pytest.warns(SceneWarning, match=hint):
        scene = load_scene(path)
    assert load_scene("barnard2012-6kg").unit_hints == ()
    assert all(each.startswith("`mechanism.") for each in scene.unit_hints)
