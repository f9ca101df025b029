"""What a stranger's scene may do: `flexfmu run --sandbox` takes the rights away, and code from elsewhere is named before it runs."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
import tomlkit

from flexfmu.cosim.cli.console import load_named
from flexfmu.cosim.cli.sandbox import _confine, _landlock
from flexfmu.model.scene.file import load_scene

CONTROLLER = """
import ctypes, os, socket
from pathlib import Path
import flexfmu

def mount():  # the root file system once more, to be written
    if ctypes.CDLL(None, use_errno=True).mount(b"none", b"/", None, 32 | 4096, None):
        raise OSError(ctypes.get_errno(), "refused")

def attempt(what, action):
    try:
        action()
        print(what, "done")
    except (OSError, MemoryError):
        print(what, "refused")

@flexfmu.controller(sample_time=1e-3, symbolic=False)
def mine(t, reference, measurement, state):
    if t == 0.0:
        attempt("write", lambda: Path({elsewhere!r}, "written").write_text("x"))
        attempt("remove", lambda: (os.remove(Path({elsewhere!r}, "there")), Path({elsewhere!r}, "there").touch()))
        attempt("network", lambda: socket.create_connection(("127.0.0.1", {port}), 1.0))
        attempt("program", lambda: socket.socket(socket.AF_UNIX).connect({local!r}))
        attempt("signal", lambda: os.kill({other}, 0))
        attempt("mount", mount) if {confined} else None
        attempt("memory", lambda: bytearray(1 << 40))
    return [0.0, 0.0], state
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene whose controller tries what it shouldn't, with a server that would answer it and a folder to write into."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "there").touch()
    robot = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.3, "trajectory.dwell": 0.0})
    robot = robot.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    folder = tmp_path / "strange"
    folder.mkdir()
    path = folder / "scene.toml"
    about = robot.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    path.write_text(tomlkit.dumps(about) + '\n[[controller]]\nkind = "python"\nsource = "mine:mine"\n')
    return path


@pytest.mark.skipif(not _landlock(), reason="a sandbox on Linux with Landlock")
def test_a_confined_process_writes_into_its_folder_alone(tmp_path: Path) -> None:
    """Also what it starts: neither a file beside the folder nor a datagram, and no more memory than its limit."""
    own, other = tmp_path / "own", tmp_path / "other"
    own.mkdir(), other.mkdir()
    here = os.getpid()
    code = f"""
import socket, subprocess
from pathlib import Path
def refused(action):
    try:
        action()
    except (OSError, MemoryError):
        return True
    return False
datagram = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
print(
    refused(lambda: Path({str(own)!r}, "x").write_text("x")),
    refused(lambda: Path({str(other)!r}, "x").write_text("x")),
    refused(lambda: datagram.sendto(b"x", ("127.0.0.1", 9))),
    refused(lambda: bytearray(1 << 40)),
    refused(lambda: socket.socket(socket.AF_UNIX)),
    subprocess.run(["touch", {str(other / "y")!r}], stderr=subprocess.DEVNULL).returncode,
)
Path({str(own)!r}, "left").write_text("left")
subprocess.run("exec >&- 2>&-; setsid sh -c 'sleep 600; rm {own}/left' &", shell=True)
"""
    ran = subprocess.run(
        [sys.executable, "-c", code], preexec_fn=lambda: _confine(here, [str(own)]), stdout=subprocess.PIPE, text=True
    )
    assert ran.stdout == "False True True True True 1\n"
    assert list(other.iterdir()) == []
    # what it has started in a session of its own has ended
    assert str(own / "left").encode() not in b"".join(path.read_bytes() for path in _command_lines())


def _command_lines() -> Iterator[Path]:
    """Files with the command lines of other processes."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        if path.parent.name != str(os.getpid()) and path.exists():
            yield path


@pytest.mark.slow
@pytest.mark.skipif(not _landlock(), reason="a sandbox on Linux with Landlock")
@pytest.mark.parametrize("kind", ["none", "landlock", "bubblewrap"])
def test_a_sandbox_takes_rights_away(scene: Path, tmp_path: Path, kind: str) -> None:
    """Without it the same scene does it all, which is what a scene may do; the results are the same."""
    if kind == "bubblewrap" and shutil.which("bwrap") is None:
        pytest.skip("no bubblewrap")
    # programs without bubblewrap
    programs, confined = tmp_path / "programs", kind != "none"
    programs.mkdir()
    for folder in os.environ["PATH"].split(":"):
        for path in Path(folder).glob("*") if kind == "landlock" else ():
            if path.name != "bwrap" and not (programs / path.name).is_symlink():
                (programs / path.name).symlink_to(path)
    with (
        TemporaryDirectory(prefix="s") as short,
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.socket(socket.AF_UNIX) as program,
    ):
        local = f"{short}/s"
        program.bind(local)
        program.listen()
        places = {"elsewhere": str(tmp_path / "elsewhere"), "port": server.getsockname()[1], "local": local}
        code = CONTROLLER.format(**places, other=os.getpid(), confined=confined)
        (scene.parent / "mine.py").write_text(code)
        out = tmp_path / "out"
        options = ["run", str(scene), "--out", str(out), "--no-verify", "--no-report", *["--sandbox"] * confined]
        environment = os.environ | ({"PATH": str(programs)} if kind == "landlock" else {})
        ran = subprocess.run(
            [sys.executable, "-m", "flexfmu", *options], capture_output=True, text=True, timeout=600, env=environment
        )
    assert ran.returncode == 0, ran.stderr
    assert "Peak torque" in ran.stdout
    told = {line for line in ran.stderr.splitlines() if line.endswith((" done", " refused"))}
    kinds = ("write", "remove", "network", "program", "signal", *["mount"] * confined)
    assert told == {f"{kind} {'refused' if confined else 'done'}" for kind in kinds} | {"memory refused"}
    assert {"results.csv", "summary.json"} <= {path.name for path in out.iterdir()}
    assert (tmp_path / "elsewhere" / "written").exists() is not confined


def test_code_from_outside_the_scenes_folder_is_named(scene: Path, tmp_path: Path) -> None:
    """A line before anything runs; code beside the scene needs none."""
    for place, named in ((tmp_path, True), (scene.parent, False)):
        (place / "gain.fmu").write_text("no archive")
        text = scene.read_text().partition("[[controller]]")[0]
        path = f"{place / 'gain.fmu'}"
        scene.write_text(f"{text}[[controller]]\nkind = \"fmu\"\npath = '{path}'\nsample_time = 1e-3\n")
        ran = subprocess.run(
            [sys.executable, "-m", "flexfmu", "run", str(scene)], capture_output=True, text=True, timeout=600
        )
        assert (f"the scene runs code from outside its folder: {path}" in ran.stderr) is named, ran.stderr


def test_modules_from_elsewhere_are_named(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Python's own, built in or not; those beside the scene aren't."""
    (scene.parent / "package").mkdir()
    (scene.parent / "package" / "__init__.py").touch()
    text = scene.read_text()
    for source, named in (("subprocess:run", "subprocess.py"), ("posix:system", "of Python"), ("package:f", "")):
        scene.write_text(text.replace("mine:mine", source))
        load_named(str(scene))
        told = capsys.readouterr().err
        assert (f"code from outside its folder: {source} (" in told and named in told) if named else not told
