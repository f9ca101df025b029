"""The cache: nothing damaged or misplaced is used, it has a limit and belongs to its user; and temporary folders of dead processes go."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from flexfmu.cosim.cli.main import app
from flexfmu.fmu_build import cache, temporary
from flexfmu.fmu_build.cache import cached, cached_files, read_cached, store
from flexfmu.fmu_build.errors import CacheWarning, SettingError

NAMES = [f"{digit * 64}.fmu" for digit in "0123456789"]


def _unused_for(seconds: float, name: str, folder: Path) -> None:
    os.utime(folder / name, (time.time() - seconds,) * 2)


def test_only_what_was_stored_under_the_name_is_used(cache_folder: Path) -> None:
    """A file that is damaged, or with its seal was put in the place of another, isn't loaded."""
    a, b = (store(name, name.encode()) for name in NAMES[:2])
    assert read_cached(NAMES[0]) == NAMES[0].encode()
    for suffix in ("", ".seal"):
        shutil.copy(f"{a}{suffix}", f"{b}{suffix}")
    assert cached(NAMES[1]) is None
    a.write_bytes(b"damaged")
    assert cached(NAMES[0]) is None
    assert len(cached_files()) == 2


def test_what_was_used_longest_ago_goes_first(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The limit holds, a read counts as use, what was just stored stays, and files of others are let alone."""
    monkeypatch.setenv("FLEXFMU_CACHE_LIMIT", "1")
    (cache_folder / "own.txt").write_text("mine")
    (cache_folder / f".{NAMES[0]}.half").write_text("left by a killed process")
    _unused_for(2e4, f".{NAMES[0]}.half", cache_folder)
    for i, name in enumerate(NAMES):
        store(name, bytes(200_000))
        _unused_for(1e4 - i, name, cache_folder)
        assert read_cached(NAMES[0]) is not None
        _unused_for(900.0 - i, NAMES[0], cache_folder)
    kept = {each.path.name for each in cached_files()}
    assert kept == {NAMES[0], *NAMES[-3:]}
    assert sum(each.size for each in cached_files()) <= 1e6
    monkeypatch.setenv("FLEXFMU_CACHE_LIMIT", "0")
    assert store(NAMES[1], bytes(200_000)).is_file()
    monkeypatch.setenv("FLEXFMU_CACHE_LIMIT", "much")
    with pytest.raises(SettingError, match=r"FLEXFMU_CACHE_LIMIT .* in MB, got 'much'"):
        store(NAMES[1], b"")
    assert (cache_folder / "own.txt").is_file()


@pytest.mark.skipif(os.name != "posix", reason="POSIX permissions")
def test_folder_is_its_users_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is made so whatever the umask; one that others can write to, or that is another one's, is replaced, with a remedy."""
    folder = tmp_path / "a" / "cache"
    monkeypatch.setenv("FLEXFMU_CACHE", str(folder))
    before = os.umask(0)
    try:
        store(NAMES[0], b"1")
    finally:
        os.umask(before)
    assert {stat.S_IMODE(each.stat().st_mode) for each in (folder, folder.parent)} == {0o700}
    folder.chmod(0o770)
    with pytest.warns(CacheWarning, match=f"{folder} .others can write to it; `chmod go-w`.*FLEXFMU_CACHE"):
        assert cached(NAMES[0]) is None
    assert store(NAMES[0], b"2").parent != folder
    other = tmp_path / "other"
    other.mkdir(mode=0o700)
    monkeypatch.setenv("FLEXFMU_CACHE", str(other))
    monkeypatch.setattr(os, "geteuid", lambda: other.stat().st_uid + 1)
    with pytest.warns(CacheWarning, match=f"{other} .it belongs to user"):
        assert store(NAMES[0], b"2").parent != other


def test_command_shows_and_clears(cache_folder: Path) -> None:
    """Where, how much, and gone; what isn't of the cache stays."""
    store(NAMES[0], bytes(5000))
    (cache_folder / "own.txt").write_text("mine")
    shown = CliRunner().invoke(app, ["cache"])
    assert shown.stdout.replace("\n", "").endswith("1 files, 0.0123 MB of at most 1000 MB"), shown.output
    assert CliRunner().invoke(app, ["cache", "--clear", "--json"]).exit_code == 0
    assert cached_files() == []
    assert (cache_folder / "own.txt").is_file()


@pytest.mark.skipif(os.name != "posix", reason="POSIX processes")
def test_folders_of_dead_processes_are_removed(tmp_path: Path) -> None:
    """The next process removes what one that was killed has left; not what living ones, or those of another machine have."""
    script = (
        "import os; from pathlib import Path; from flexfmu.fmu_build.temporary import temporary_folder as new\n"
        "kept = new('x', Path(os.environ['TMPDIR'])); os.kill(os.getpid(), 9)"
    )
    where = tmp_path / "temporary"
    where.mkdir()
    subprocess.run([sys.executable, "-c", script], env={**os.environ, "TMPDIR": str(where)}, check=False)
    (left,) = where.iterdir()
    process = left.name.split("-")[2]
    others = {left.name.replace(f"-{process}-", f"-{os.getpid()}-"), f"flexfmu-00000000-{process}-x", "flexfmu-notes"}
    for name in others:
        (where / name).mkdir()
    with temporary.temporary_folder("y", where) as mine:
        assert {each.name for each in where.iterdir()} == {*others, Path(mine).name}


@pytest.mark.skipif(os.name != "posix", reason="POSIX limits")
def test_folders_are_removed_with_few_file_descriptors(tmp_path: Path) -> None:
    """One descriptor does for folders within folders."""
    script = (
        "import resource; from pathlib import Path; from flexfmu.fmu_build.temporary import temporary_folder as new\n"
        f"with new('x', Path({str(tmp_path)!r})) as name:\n"
        " (deep := Path(name, 'a', 'b', 'c')).mkdir(parents=True); (deep / 'd').write_text('')\n"
        " resource.setrlimit(resource.RLIMIT_NOFILE, (4, 4))"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
    assert not list(tmp_path.glob("flexfmu-*"))


def test_old_files_without_a_seal_are_counted(cache_folder: Path) -> None:
    """What was killed between a file and its seal doesn't stay for ever."""
    (cache_folder / NAMES[0]).write_text("")
    assert [each.path.name for each in cached_files()] == [NAMES[0]]
    cache.remove_cached(cached_files()[0])
    assert cached_files() == []


def test_the_limit_holds_when_a_process_ends(cache_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what it has used, and what one that runs may be about to load; folders within are private whatever the umask."""
    monkeypatch.setenv("FLEXFMU_CACHE_LIMIT", "1")
    before = os.umask(0)
    try:
        for name in NAMES:
            monkeypatch.setattr(cache, "_used", set())
            store(f"other/{name}", bytes(400_000))
            cache._leave()
            assert sum(each.size for each in cached_files()) <= 1e6
    finally:
        os.umask(before)
    assert {each.path.name for each in cached_files()} == {*NAMES[-2:]}
    assert stat.S_IMODE((cache_folder / "other").stat().st_mode) == 0o700
