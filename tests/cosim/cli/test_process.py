"""The command as a process of its own: exit status, streams, pipes, full devices, terminals of some widths, speed of starting."""

from __future__ import annotations

import json
import math
import os
import re
import resource
import shlex
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from fmpy.util import read_csv

from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.metric_table import COMMON_METRICS
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.cosim.reports.summary import summarise
from flexfmu.model.scene.file import load_scene

FLEXFMU = (sys.executable, "-c", "from flexfmu.cosim.cli.main import main; main()")
SCENE = "barnard2012-6kg"
FULL = Path("/dev/full")


def flexfmu(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command and wait for it."""
    return ran([*FLEXFMU, *arguments], env=os.environ | environment)


def ran(command: Sequence[str], **options: Any) -> subprocess.CompletedProcess[str]:
    """A finished process with what it has printed."""
    usual = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "timeout": 600, "check": False}
    return subprocess.run([*command], **usual | options)  # type: ignore[call-overload,no-any-return]


HEAVY = {"casadi", "matplotlib", "rich", "scipy"}
COMMAND = "from flexfmu.cosim.cli.main import app\ntry:\n    app({})\nexcept SystemExit:\n    pass"


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (COMMAND.format(["--help"]), HEAVY | {"numpy", "fmpy", "pydantic", "pydantic_core"}),
        (COMMAND.format(["run", SCENE, "--no-verify", "--json"]), HEAVY),
        (f"import flexfmu\nflexfmu.run({SCENE!r})", HEAVY),
    ],
    ids=["help", "run", "python"],
)
def test_no_heavy_package_is_loaded(code: str, heavy: set[str], tmp_path: Path) -> None:
    """`flexfmu --help` must answer at once; the model in CasADi takes forty times as long as a run of a cached FMU."""
    run = run_scene(load_scene(SCENE))
    summarise(run, measure_run(run, companions=0))  # caches what the command needs of CasADi
    code += f"\nimport sys\nprint(sorted({{name.split('.')[0] for name in sys.modules}} & {heavy}))"
    outcome = ran([sys.executable, "-c", code], check=True, cwd=tmp_path)
    assert outcome.stdout.splitlines()[-1] == "[]"


@pytest.mark.slow
def test_missing_compiler(tmp_path: Path) -> None:
    """Without a compiler a build that isn't in the cache ends with status 1 and says what to do."""
    outcome = flexfmu(
        "build", SCENE, "-o", str(tmp_path / "x.fmu"), CC=str(tmp_path / "no-such-cc"), FLEXFMU_CACHE=str(tmp_path)
    )
    assert (outcome.returncode, outcome.stdout, outcome.stderr.count("\n")) == (1, "", 1)
    assert "no-such-cc" in outcome.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits the address space")
def test_little_memory_is_one_line(tmp_path: Path) -> None:
    """SciPy's library for linear algebra would ask for memory for ever, deaf to signals."""
    command = f"ulimit -v 293000; exec {shlex.join(FLEXFMU)} effects {SCENE} --out {tmp_path}"
    found = ran(["sh", "-c", command], timeout=60)
    assert (found.returncode, found.stdout) == (1, "")
    assert re.fullmatch("flexfmu: out of memory: .*\n", found.stderr)


def test_useless_cache(tmp_path: Path) -> None:
    """A file in place of the cache's folder: one line says so, and the command does its work."""
    (tmp_path / "file").write_text("")
    outcome = flexfmu("run", SCENE, "--out", str(tmp_path / "results"), "--json", FLEXFMU_CACHE=str(tmp_path / "file"))
    assert (outcome.returncode, outcome.stderr.count("\n")) == (0, 1)
    assert outcome.stderr.startswith(f"flexfmu: warning: cannot use the cache's folder {tmp_path / 'file'} (")
    assert json.loads(outcome.stdout)["health"]["outcome"] == "completed"


@pytest.mark.slow
def test_scene_to_results(tmp_path: Path) -> None:
    """build, validate and run: an FMU without findings, a CSV that fmpy reads, metrics of a flexible robot."""
    built = flexfmu("build", SCENE, "-o", str(tmp_path / "robot.fmu"), "--json")
    assert (built.returncode, built.stderr) == (0, "")
    fmu = json.loads(built.stdout)["path"]
    assert flexfmu("validate", fmu).stdout == f"{fmu}: no findings\n"
    run = flexfmu("run", SCENE, "--out", str(tmp_path), "--json")
    assert (run.returncode, run.stderr) == (0, "")
    summary = json.loads(run.stdout)
    assert summary == json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert list(summary["metrics"]) == list(COMMON_METRICS)
    assert all(value is None or math.isfinite(value) for value in summary["metrics"].values())
    assert 60.0 < summary["metrics"]["peak_torque_1"] < 90.0
    assert summary["versions"]["compiler"]
    results = read_csv(tmp_path / "results.csv")
    assert results.dtype.names[0] == "time"
    assert np.all(np.diff(results["time"]) >= 0.0)
    assert results["time"][-1] == pytest.approx(0.68)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX does")
def test_interrupt_is_one_line(tmp_path: Path) -> None:
    """Ctrl-C at any moment: one line and status 1."""
    settings = ("--set", "cosimulation.step=1e-6", "--set", "cosimulation.record_step=0.01")
    long = ("run", SCENE, *settings, "--out", str(tmp_path / "out"))
    process = subprocess.Popen([*FLEXFMU, *long], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not (tmp_path / "out").is_dir():
        time.sleep(0.02)
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert (process.returncode, errors.count("\n")) == (1, 1), errors
    assert "interrupted" in errors


def test_closed_reader_before_the_output_comes() -> None:
    """The pipe's other end is gone before anything is written."""
    command = f"{shlex.join(FLEXFMU)} modes {SCENE} --poses 3 | true"
    outcome = ran(["sh", "-c", command])
    assert outcome.stderr == ""


@pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    "arguments", ["modes barnard2012-6kg --poses 3", "modes barnard2012-6kg --json", "--help", "--version"]
)
def test_full_device_as_standard_output(arguments: str) -> None:
    """A full disk behind standard output is an error in one line, for tables, JSON and help alike."""
    with FULL.open("w") as full:
        outcome = ran([*FLEXFMU, *arguments.split()], stdout=full)
    assert (outcome.returncode, outcome.stderr.count("\n")) == (1, 1)
    assert "can't write to standard output: No space left on device" in outcome.stderr


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="the shell closes streams as POSIX does")
def test_closed_streams() -> None:
    """Started without standard output, the command says so in one line; without standard error it is silent there."""
    modes = f"{shlex.join(FLEXFMU)} modes"
    command = f"{modes} {SCENE} --poses 3 >&-; echo $?; {modes} nowhere 2>&-; echo $?"
    outcome = ran(["sh", "-c", command])
    assert (outcome.stdout, outcome.stderr) == ("1\n2\n", "flexfmu: can't write to standard output: it is closed\n")


MODES = ("modes", "barnard2012-6kg", "--poses", "3", "--set", "effects.proximal_bending=2")
STYLES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def without_width() -> dict[str, str]:
    """The environment without what overrides the terminal's width or style."""
    removed = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE")
    return {key: value for key, value in os.environ.items() if key not in removed} | {"TERM": "xterm-256color"}


def in_terminal(columns: int, *arguments: str) -> str:
    """What a command prints into a terminal with so many columns, styles included; standard error is elsewhere."""
    fcntl, pty, termios = (pytest.importorskip(name) for name in ("fcntl", "pty", "termios"))
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    command, text = [*FLEXFMU, *arguments], b""
    with (
        subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=subprocess.DEVNULL, env=without_width()
        ) as process,
        suppress(OSError),  # Linux' sign of the end
    ):
        os.close(theirs)
        while chunk := os.read(ours, 65536):
            text += chunk
    os.close(ours)
    assert process.returncode == 0
    return text.decode().replace("\r\n", "\n")


@pytest.fixture(scope="module")
def frequencies() -> list[str]:
    """The numbers of the table, from JSON."""
    outcome = flexfmu(*MODES, "--json")
    return [f"{f:.2f}" for pose in json.loads(outcome.stdout)["poses"] for f in pose["frequencies"][:6]]


@pytest.mark.parametrize("columns", [60])
def test_numbers_are_whole_in_a_terminal(columns: int, frequencies: list[str]) -> None:
    """Every frequency can be read, no line is wrapped by the terminal."""
    text = in_terminal(columns, *MODES)
    lines = STYLES.sub("", text).splitlines()
    assert text != STYLES.sub("", text), "the title is bold"
    assert max(map(len, lines)) <= columns
    assert "…" not in text
    words = [word for line in lines for word in line.split()]
    assert all(words.count(number) >= frequencies.count(number) for number in frequencies)
    assert len(frequencies) == 18


def test_a_pipe_has_neither_styles_nor_the_width_of_a_terminal(frequencies: list[str]) -> None:
    """Whatever the terminal that the command is started from: one table of 120 columns, sentences on one line; fewer columns, if
    the environment says so, where rows are blocks."""
    for wish, tables in (({}, 1), ({"COLUMNS": "60"}, 0)):
        text = ran([*FLEXFMU, *MODES], env=without_width() | wish).stdout
        assert "\x1b" not in text
        assert text.count("─\n") + text.count("─ \n") == tables
        assert set(frequencies) <= set(text.split())
        assert text.splitlines()[-1].startswith("The lowest 6 of ")


def test_too_few_descriptors_are_one_line() -> None:
    """Where not even the package's own files can be read."""
    limit = partial(resource.setrlimit, resource.RLIMIT_NOFILE, (7, 7))
    done = ran([*FLEXFMU, "run", SCENE], preexec_fn=limit)
    assert done.returncode == 1
    assert done.stderr == "flexfmu: too few files can be opened: close some, or raise the limit (ulimit -n)\n"


def test_a_command_that_writes_nothing_leaves_no_folder(tmp_path: Path) -> None:
    """An error of the scene; a user's source is named in it, and no file of ours."""
    robot = load_scene(SCENE).replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    about = robot.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    scene = tmp_path / "scene.toml"
    scene.write_text(tomlkit.dumps(about) + '\n[[controller]]\nkind = "python"\nsource = "os:system"\n')
    done = flexfmu("run", str(scene), "--out", str(tmp_path / "new" / "deep"))
    assert done.returncode == 2
    assert "os:system(): TypeError" in done.stderr
    assert "user_slaves" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]
