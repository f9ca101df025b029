"""The shipped JSON Schema is the one of the sections; it accepts our scenes and rejects wrong ones, as flexfmu does."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from flexfmu.cosim.cli.scenes import new
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import scene_schema
from flexfmu.model.scene.keys import set_value
from flexfmu.model.scene.schema import parse_scene

ROOT = Path(__file__).parents[3]
FILES = [*(ROOT / "examples").glob("*.toml"), *(ROOT / "model" / "scene" / "scenes").glob("*.toml")]
SIX = ROOT / "model" / "scene" / "scenes" / "barnard2012-6kg.toml"


@pytest.fixture(scope="module")
def shipped() -> dict[str, Any]:
    """The schema as it comes with the package."""
    found: dict[str, Any] = json.loads(scene_schema())
    return found


@pytest.fixture(scope="module")
def accepts(shipped: dict[str, Any]) -> Callable[[dict[str, Any]], bool]:
    """Whether the schema accepts a scene."""
    return Draft7Validator(shipped).is_valid


def test_shipped_schema_is_up_to_date(shipped: dict[str, Any]) -> None:
    """A new key needs a sentence in generators/scene_keys.toml, and `python generators/scene_schema.py`."""
    spec = spec_from_file_location("scene_schema", ROOT / "generators" / "scene_schema.py")
    assert spec is not None
    assert spec.loader is not None
    generator = module_from_spec(spec)
    spec.loader.exec_module(generator)
    Draft7Validator.check_schema(shipped)
    assert json.loads(json.dumps(generator.schema())) == shipped


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.stem))
def test_our_scenes_are_accepted(path: Path, accepts: Callable[[dict[str, Any]], bool]) -> None:
    """The shipped scenes, and those of the examples."""
    assert accepts(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("effects.damping", "none"),
        ("trajectory.profile", "poly5"),
        ("effects.joint_friction", {"coulomb": 1.0}),
        ("effects.quasi_static", ["distal_axial"]),
        ("cosimulation.step", "auto"),
        ("cosimulation.loop_solver", "anderson"),
        ("shaper", [{"kind": "zvd", "modes": "along-path"}]),
        ("controller", [{"kind": "pd", "proportional": [1e3, 2e3], "derivative": 10.0, "sample_time": 1e-3}]),
        ("payload.mass", 3),
    ],
)
def test_short_forms_are_accepted(key: str, value: Any, accepts: Callable[[dict[str, Any]], bool]) -> None:
    """What flexfmu reads, editors don't underline."""
    scene = tomllib.loads(SIX.read_text(encoding="utf-8"))
    set_value(scene, key, value, "test")
    parse_scene(scene, "test")
    assert accepts(scene)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("payload.mass", -1.0),
        ("payload.mass", "6 kg"),
        ("payload.weight", 6.0),
        ("mechanism.working_mode", "up"),
        ("mechanism.proximal", {"length": 0.24}),
        ("effects.proximal_bending", 2.5),
        ("effects.proximal_bending", 41),
        ("effects.damping", {"kind": "modal"}),
        ("effects.damping", "modal"),
        ("effects.gravity", -9.81),
        ("trajectory.start", [0.1, 0.2, 0.3]),
        ("trajectory.blend.kind", "round"),
        ("cosimulation.tolerance", 1.0),
        ("controller", [{"kind": "pd", "proportional": 1e3}]),
    ],
)
def test_wrong_scenes_are_rejected(key: str, value: Any, accepts: Callable[[dict[str, Any]], bool]) -> None:
    """Wrong values, types, words, units' places and missing keys, by schema and flexfmu alike."""
    scene = tomllib.loads(SIX.read_text(encoding="utf-8"))
    table = scene
    *path, last = key.split(".")
    for name in path:
        table = table[name]
    table[last] = value
    assert not accepts(scene)
    with pytest.raises(SceneError):
        parse_scene(scene, "test")


def test_new_scene_names_the_schema(tmp_path: Path) -> None:
    """Editors find the schema by the first line of a scene from `flexfmu new`."""
    assert new(tmp_path / "robot.toml") == 0
    first = (tmp_path / "robot.toml").read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("#:schema file://")
    assert Path(first.removeprefix("#:schema file://")).read_text(encoding="utf-8") == scene_schema()
