"""Reproducible archives, written completely or not at all."""

from __future__ import annotations

import errno
import os
import struct
import tracemalloc
import zipfile
from contextlib import suppress
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.fmu_build.archive import DAMAGED, MOST_MEMBERS, open_archive, pack, read_member, write_atomically
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


def says(content: bytes, size: int) -> bytes:
    """An archive whose last member says in the central directory that it has another size."""
    changed = bytearray(content)
    place = changed.rfind(b"PK\x01\x02") + 24
    changed[place : place + 4] = struct.pack("<I", size)
    return bytes(changed)


def refusal(path: Path, content: bytes) -> str:
    """The message of an archive that isn't opened."""
    path.write_bytes(content)
    with pytest.raises(ArchiveError) as caught:
        open_archive(path)
    assert len(str(caught.value)) < 300 + len(str(path))
    return str(caught.value)


def test_sizes_and_names_are_checked_before_anything_is_unpacked(tmp_path: Path) -> None:
    """Bombs, crowds, paths that leave the folder, links and repeated paths are one sentence each; a large sound archive opens."""
    path = tmp_path / "x.fmu"
    assert "at most 100 times" in refusal(path, says(pack({"z": b"0"}), 4_000_000_000))
    assert "times its size, 65 MB; at most 100 times" in refusal(path, pack({"z": bytes(65_000_000)}))
    assert "has a model description of more than 300 MB" in refusal(
        path, says(pack({"a": os.urandom(5_000_000), "modelDescription.xml": b""}), 400_000_000)
    )
    assert f"holds {MOST_MEMBERS + 1} files" in refusal(path, pack({str(i): b"" for i in range(MOST_MEMBERS + 1)}))
    for name in ("../x", "a/../../x", "/x", "C:x", "..\\x", "\\x", "../" + 60_000 * "x"):
        assert "which leaves its folder" in refusal(path, pack({name: b""}))
    assert "holds 'a/b' twice" in refusal(path, pack({"a/b": b"", "a//b": b""}))
    linked = zipfile.ZipInfo("link")
    linked.external_attr = 0o120777 << 16
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(linked, "/etc/passwd")
    assert "holds 'link', a symbolic link" in refusal(path, path.read_bytes())
    for name, reason in {"/dev/zero": "not a zip file", "x" * 300: "File name too long"}.items():
        with pytest.raises(ArchiveError, match=reason):
            open_archive(Path(name))
    # libraries and tables, packed a hundred to one
    path.write_bytes(pack({"resources/table": os.urandom(1_000_000) + bytes(60_000_000)}))
    open_archive(path).close()


def test_a_member_ends_at_the_size_that_it_states(tmp_path: Path) -> None:
    """Zeros that say that they are a thousand are damaged, and take no memory."""
    path = tmp_path / "x.fmu"
    path.write_bytes(says(pack({"z": bytes(60_000_000)}), 1000))
    with open_archive(path) as archive:
        tracemalloc.start()
        with pytest.raises(zipfile.BadZipFile, match="CRC"):
            read_member(archive, archive.infolist()[0])
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
        tracemalloc.stop()


@settings(max_examples=100, derandomize=True, deadline=None, database=None)
@given(st.lists(st.tuples(st.integers(0, 400), st.binary(min_size=1, max_size=4)), min_size=1, max_size=3))
def test_damage_is_one_error_of_those_expected(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[int, bytes]]
) -> None:
    """Whatever bytes of an archive are overwritten, it opens and is read, or raises what callers expect."""
    content = bytearray(pack({"modelDescription.xml": b"<a/>" * 20, "b/c": b"12"}))
    for place, drawn in changes:
        place %= len(content)
        content[place : place + len(drawn)] = drawn
    path = tmp_path_factory.getbasetemp() / "drawn.fmu"
    path.write_bytes(content)
    with suppress(ArchiveError, *DAMAGED), open_archive(path) as archive:
        for member in archive.infolist():
            read_member(archive, member)
