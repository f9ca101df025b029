"""Reproducible archives, written completely or not at all."""

from __future__ import annotations

import errno
import os
import zipfile
from io import BytesIO
from pathlib import Path

import pytest

from flexfmu.fmu_build.archive import pack, write_atomically
from flexfmu.fmu_build.errors import ArchiveError


def test_entries_are_sorted_and_readable() -> None:
    """Any zip tool gets back what was put in, in whatever order; libraries are executable."""
    files = {"b/x.so": b"1", "a.txt": b"2"}
    assert pack(files) == pack(dict(reversed(files.items())))
    with zipfile.ZipFile(BytesIO(pack(files))) as archive:
        assert archive.namelist() == ["a.txt", "b/x.so"]
        assert archive.read("b/x.so") == b"1"
        assert [entry.external_attr >> 16 & 0o777 for entry in archive.infolist()] == [0o644, 0o755]


def test_places_that_take_no_file_are_errors(tmp_path: Path) -> None:
    """A folder where a file name is wanted, and a path through a file, give one sentence."""
    (tmp_path / "file").write_text("")
    with pytest.raises(ArchiveError, match="it is a folder"):
        write_atomically(tmp_path, b"1")
    with pytest.raises(ArchiveError, match="cannot write"):
        write_atomically(tmp_path / "file" / "x.fmu", b"1")


def test_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failed write keeps what was there and leaves no half file behind."""
    target = tmp_path / "out" / "x.fmu"
    write_atomically(target, b"old")

    def fail(_source: str, _target: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(ArchiveError, match="No space left on device; choose a writable folder"):
        write_atomically(target, b"new")
    assert [path.name for path in target.parent.iterdir()] == ["x.fmu"]
    assert target.read_bytes() == b"old"
