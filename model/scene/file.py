"""Reading scene files and shipped scenes (TOML)."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from hashlib import file_digest
from importlib.resources import files
from pathlib import Path
from typing import Any

from flexfmu.errors import read_text
from flexfmu.model.scene.errors import SceneError, SceneWarning
from flexfmu.model.scene.keys import parse_toml, set_value, value_at
from flexfmu.model.scene.messages import listed
from flexfmu.model.scene.schema import Scene, parse_scene

PAPER = ("barnard2012-0.1kg", "barnard2012-6kg")
"""The shipped scenes of the paper, whose effects are those of its model."""

LARGEST_SCENE = 4_000_000
"""Largest scene file [bytes]: a thousand times the usual size."""

PAPER_KEYS = (
    *(f"mechanism.{key}" for key in ("base_half_distance", "working_mode", "assembly_mode", "proximal", "distal")),
    *("mechanism.material.density", "mechanism.material.youngs_modulus", "payload.mass", "payload.inertia"),
    *(f"trajectory.{key}" for key in ("kind", "start", "lift", "height", "width", "duration")),
)
"""What makes a scene the paper's; blends, profiles and drives vary there."""


def shipped_scenes() -> tuple[str, ...]:
    """Names of the scenes that come with the package, sorted."""
    names = [entry.name for entry in _scene_folder().iterdir()]
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


def scene_schema() -> str:
    """The JSON Schema of scene files, for editors; `generators/scene_schema.py` writes it."""
    return files(__package__).joinpath("scene.schema.json").read_text(encoding="utf-8")


def as_scene(source: Scene | Path | str) -> Scene:
    """Return a scene as it is, or load it from its file or by the name of a shipped scene.

    Raises:
        SceneError: the scene doesn't exist, one of its keys or values is invalid, or it is a model from equations.
        TypeError: the source is of another type.
    """
    if isinstance(source, Scene):
        return source
    if isinstance(source, str | Path):
        return load_scene(source)
    if type(source).__name__ == "SymbolicModel":
        raise SceneError(
            "a model from equations is no scene: simulate, build, sweep and linearize take it; for its margins and modes give "
            "flexfmu.linearize(model, point) to python-control"
        )
    raise TypeError(
        f"expected a Scene, the path of a scene file or the name of a shipped scene, got {type(source).__name__}: {source!r:.60}"
    )


def file_digests(scene: Scene) -> dict[str, str]:
    """SHA-256 of each file that a scene names: FMUs, C and Python sources, tables."""

    def texts(value: Any) -> Iterator[str]:
        if isinstance(value, str):
            yield value
        elif isinstance(value, Mapping):
            if value.get("kind") == "python":
                yield f"{value['folder']}/{value['source'].partition(':')[0].replace('.', '/')}.py"
            for each in value.values():
                yield from texts(each)
        elif isinstance(value, list | tuple):
            for each in value:
                yield from texts(each)

    named = sorted(set(texts(scene.model_dump(mode="json", exclude={"name"}))))
    digests = {}
    for text in filter(_is_file, named):
        with open(text, "rb") as file:
            digests[text] = file_digest(file, "sha256").hexdigest()
    return digests


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):  # too long, or with a zero
        return False


def load_scene(source: str | Path, changes: Mapping[str, Any] | None = None) -> Scene:
    """Read a scene from a TOML file or by the name of a shipped scene.

    Args:
        source: path of a scene file, or a name out of `shipped_scenes`.
        changes: dotted key → value, as if it stood in the file; keys as for `Scene.replace`.

    Warns:
        SceneWarning: a value suggests another unit, see `Scene.unit_hints`.

    Raises:
        SceneError: there is no such scene, the file isn't TOML, or a key or value is invalid.
    """
    text, label, folder = read_scene_text(source)
    try:
        data = parse_toml(text)
    except SceneError as error:
        raise SceneError(f"{error} ({label})") from error
    for key, value in (changes or {}).items():
        set_value(data, key, value, label)
    scene = parse_scene(data, f"{label}, changed: {', '.join(changes)}" if changes else label, folder)
    scene.__dict__["origin"] = str(source)
    # valid values that suggest a wrong unit
    for hint in scene.unit_hints:
        warnings.warn(f"{hint} ({label})", SceneWarning, stacklevel=2)
    return scene


def basis_hint(scene: Scene) -> str:
    """A sentence for a scene that has the paper's basis and isn't one of the paper's; empty for others."""
    effects = scene.effects
    elastic = effects.proximal_bending or effects.proximal_axial or effects.distal_axial
    if effects.select or effects.basis != "assumed-modes" or effects.distal_bending or not elastic:
        return ""
    own, *papers = (each.model_dump() for each in (scene, *map(load_scene, PAPER)))
    # keys in which it differs from the nearest of the paper's scenes
    keys = min(([key for key in PAPER_KEYS if value_at(own, key) != value_at(each, key)] for each in papers), key=len)
    if not keys:
        return ""
    return (
        '`effects.basis = "assumed-modes"` without `distal_bending` is the model of the paper, up to 37 % off in its residual '
        f"vibration, and this scene differs from the paper's in `{'`, `'.join(keys)}`: take "
        '`basis = "craig-bampton"` with one mode each of `proximal_bending`, `distal_axial` and `distal_bending`'
    )


def scene_path(name: str) -> Path:
    """The file of a shipped scene."""
    return Path(str(_scene_folder().joinpath(f"{name}.toml")))


def _scene_folder() -> Any:
    return files("flexfmu.model.scene").joinpath("scenes")


def read_scene_text(source: str | Path) -> tuple[str, str, Path | None]:
    """Text, name for messages, and folder of a scene file; no folder for a shipped scene.

    Raises:
        SceneError: there is no such scene, or it can't be read.
    """
    # a shipped scene
    path = Path(source)
    if path.suffix != ".toml" and str(source) in shipped_scenes():
        return _scene_folder().joinpath(f"{source}.toml").read_text(encoding="utf-8"), f"shipped scene {source}", None
    # a file
    try:
        return read_text(path, LARGEST_SCENE), str(path), path.resolve().parent
    except FileNotFoundError:
        raise SceneError(
            f"no scene file '{source}': give a path, or one of the shipped scenes {listed(shipped_scenes())}"
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise SceneError(f"cannot read scene file '{source}': {reason}") from None
