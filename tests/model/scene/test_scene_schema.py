"""The shipped JSON Schema is the one of the sections; it accepts our scenes and rejects wrong ones, as flexfmu does."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from contextlib import nullcontext
from functools import reduce
from importlib.util import module_from_spec, spec_from_file_location
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from flexfmu.cosim.cli.scenes import new
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import scene_schema
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
    assert not Draft7Validator(shipped["properties"]["accuracy"]).is_valid({"peak_torque": 1e-3})
    assert json.loads(json.dumps(generator.schema())) == shipped


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.stem))
def test_our_scenes_are_accepted(path: Path, accepts: Callable[[dict[str, Any]], bool]) -> None:
    """The shipped scenes, and those of the examples."""
    assert accepts(tomllib.loads(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize(("key", "value", "valid"), [
    ("effects.damping", "none", True),
    ("effects.joint_friction", {"coulomb": 1.0}, True),
    ("cosimulation.step", "auto", True),
    ("cosimulation.loop_solver", "anderson", True),
    ("shaper", [{"kind": "zvd", "modes": "along-path"}], True),
    ("controller", [{"kind": "pd", "proportional": [1e3, 2e3], "derivative": 10.0, "sample_time": 1e-3}], True),
    ("accuracy", {"peak_torque_1": 1e-3, "gain_margin": "0.1"}, True),
    ("payload.mass", -1.0, False),
    ("payload.weight", 6.0, False),
    ("mechanism.working_mode", "up", False),
    ("mechanism.proximal", {"length": 0.24}, False),
    ("effects.proximal_bending", 2.5, False),
    ("effects.damping", {"kind": "modal"}, False),
    ("trajectory.start", [0.1, 0.2, 0.3], False),
    ("controller", [{"kind": "pd", "proportional": 1e3}], False),
])  # fmt: skip
def test_schema_and_flexfmu_agree(key: str, value: Any, valid: bool, accepts: Callable[[dict[str, Any]], bool]) -> None:
    """Short forms that flexfmu reads, editors don't underline; wrong values, words and missing keys they do."""
    scene = tomllib.loads(SIX.read_text(encoding="utf-8"))
    *path, last = key.split(".")
    reduce(getitem, path, scene)[last] = value
    assert accepts(scene) == valid
    with nullcontext() if valid else pytest.raises(SceneError):
        parse_scene(scene, "test")


def test_new_scene_names_the_schema(tmp_path: Path) -> None:
    """Editors find the schema by the first line of a scene from `flexfmu new`."""
    assert new(tmp_path / "robot.toml") == 0
    first = (tmp_path / "robot.toml").read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("#:schema file://")
    assert Path(first.removeprefix("#:schema file://")).read_text(encoding="utf-8") == scene_schema()
