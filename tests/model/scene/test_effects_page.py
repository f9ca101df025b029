"""The README and the pages of docs/ name every key of a scene's physics and run, and their examples can be read."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from flexfmu.model.scene.choice import ChoiceSection
from flexfmu.model.scene.cosimulation import Cosimulation
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.mechanism import Mechanism, Payload
from flexfmu.model.scene.motion import TrajectorySection

ROOT = Path(__file__).parents[3]
PAGES = [
    (ROOT / "docs" / name).read_text(encoding="utf-8")
    for name in ("effects.md", "control-loop.md", "motions.md", "motors.md")
]
TEXT = "\n".join([(ROOT / "README.md").read_text(encoding="utf-8"), *PAGES])


def words(annotation: Any) -> Iterator[str]:
    """Keys of sections and words that are values, those of sections inside included; not what flexfmu writes itself."""
    if isinstance(annotation, str):
        yield annotation
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel) and annotation is not ChoiceSection:
        for name, field in annotation.model_fields.items():
            yield name
            yield from words(field.annotation)
    for part in get_args(annotation):
        yield from words(part)


@pytest.mark.parametrize("section", [Mechanism, Payload, Effects, TrajectorySection, Cosimulation])
def test_every_key_and_word_is_named(section: type[BaseModel]) -> None:
    """Whoever adds a key, or a word that it may have, tells of it."""
    for word in set(words(section)):
        assert re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", TEXT), word


@pytest.mark.parametrize("block", re.findall(r"```toml\n(.*?)```", PAGES[0], flags=re.DOTALL))
def test_examples_are_scenes(block: str) -> None:
    """What the page shows can be copied into a scene file."""
    changes = {f"effects.{key}": value for key, value in tomllib.loads(block)["effects"].items()}
    effects = load_scene("barnard2012-6kg").replace(changes).effects
    assert all(getattr(effects, key.partition(".")[2]) for key in changes)
