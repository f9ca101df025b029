"""Scene files from anybody: every one is a scene or one short line."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.errors import LONGEST_MESSAGE
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import LARGEST_SCENE, load_scene, scene_path
from flexfmu.model.scene.keys import parse_toml

TEXT = scene_path("barnard2012-6kg").read_text(encoding="utf-8")


@pytest.mark.parametrize(("text", "message"), [
    (f"x = {'9' * 5000}", "a number has thousands of digits"),
    (f"x = {'[' * 5000}{']' * 5000}", "nested deeper than 50 levels"),
    (f"{'a.' * 500}a = 1", "nested deeper than 50 levels"),
    (f"[effects.{'n' * 100_000}]", "`effects.nnn.* \\.\\.\\. .*x.toml"),
    ("".join(f"[faulty{i}]\na = 1\n" for i in range(2000)), "`faulty19` are not known keys"),
    (f"x = '{LARGEST_SCENE * 'n'}'", "larger than 4 MB"),
])  # fmt: skip
def test_sizes_and_depths(tmp_path: Path, text: str, message: str) -> None:
    """Long numbers, deep arrays, long names and many mistakes are one line of a few hundred characters."""
    path = tmp_path / "x.toml"
    path.write_text(f"{TEXT}\n{text}\n")
    with pytest.raises(SceneError, match=message) as caught:
        load_scene(path)
    assert len(str(caught.value)) <= LONGEST_MESSAGE + 10


def test_devices_and_byte_order_marks(tmp_path: Path) -> None:
    """A device isn't read, and a file of Notepad is."""
    with pytest.raises(SceneError, match="it is a device"):
        load_scene("/dev/zero")
    (tmp_path / "x.toml").write_text(f"\ufeff{TEXT}", encoding="utf-8")
    assert load_scene(tmp_path / "x.toml") == load_scene("barnard2012-6kg")


@settings(max_examples=100, derandomize=True, deadline=None, database=None)
@given(st.text(alphabet="a.=[]{}\"'\n0123456789e-+_#, ", max_size=60))
def test_drawn_texts_are_one_error(text: str) -> None:
    """Whatever the text is, it is TOML or refused."""
    with suppress(SceneError):
        parse_toml(text)


def test_many_faulty_keys_are_not_read() -> None:
    """A line, before they are parsed or checked."""
    for text in ("[[controller]]\nkind = 'pd'\n" * 100_000, "".join(f"k{i} = 1\n" for i in range(100_000))):
        with pytest.raises(SceneError, match=r"not a scene: it has \d+ keys and sections, and at most 5000 are read"):
            parse_toml(text)
    with pytest.raises(SceneError, match="it has 10000 keys"):
        parse_toml(f"a = {{ {', '.join(f'k{i} = 1' for i in range(10_000))} }}")


def test_a_pipe_that_nothing_writes_into_is_refused(tmp_path: Path) -> None:
    """At once; one with a writer is read."""
    os.mkfifo(path := tmp_path / "pipe.toml")
    with pytest.raises(SceneError, match="it is a pipe that nothing writes into, no regular file"):
        load_scene(path)
    reading, writing = os.pipe()
    os.write(writing, scene_path("barnard2012-6kg").read_bytes())
    os.close(writing)
    assert load_scene(f"/dev/fd/{reading}").name == "barnard2012-6kg"
    os.close(reading)
