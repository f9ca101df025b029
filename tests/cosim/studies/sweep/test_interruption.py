"""Sweeps that are interrupted in every way, and continued: the same bytes as without."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import flexfmu

SHORT = {"trajectory.dwell": 0.02, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-3}
SCENE = flexfmu.load_scene("barnard2012-6kg").replace({**SHORT, "trajectory.duration": 0.2})
METRICS = ["end_position_error", "settling_time"]
CASES = {"trajectory.duration": "0.2:0.25:25", **{key: str(value) for key, value in SHORT.items()}}
COMMAND = [
    *(sys.executable, "-m", "flexfmu", "sweep", "barnard2012-6kg", "--no-plot", "--metrics", ",".join(METRICS)),
    *(text for key, value in CASES.items() for text in ("--vary", f"{key}={value}")),
]


class Stop:
    """A progress function that interrupts after some calls."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def __call__(self, fraction: float) -> None:
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


@pytest.mark.slow
def test_interrupted_sweeps_end_in_the_same_bytes(tmp_path: Path) -> None:
    """Stopped twice and continued by other numbers of processes, cases side by side; one by one they are in the command below."""
    sweep: dict[str, Any] = {"cases": {"payload.mass": "0.0:8.0:200"}, "metrics": ["peak_torque_1"]}
    flexfmu.sweep(SCENE, out=tmp_path / "whole", processes=2, **sweep)
    for calls, processes in ((3, 1), (2, 3)):
        with pytest.raises(KeyboardInterrupt):
            flexfmu.sweep(SCENE, out=tmp_path / "out", processes=processes, progress=Stop(calls), **sweep)
        assert 1 < len((tmp_path / "out" / "journal.csv").read_bytes().splitlines()) < 201
    found = flexfmu.sweep(SCENE, out=tmp_path / "out", processes=2, **sweep)
    assert not found.failed
    for name in ("sweep.csv", "sweep.json", "sweep.parquet"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    # a finished sweep is read, not simulated
    assert flexfmu.sweep(SCENE, out=tmp_path / "out", progress=Stop(2), **sweep)[0] == found[0]


def lines(folder: Path) -> int:
    """Number of finished cases in the journal."""
    journal = folder / "journal.csv"
    return max(0, journal.read_bytes().count(b"\n") - 1) if journal.exists() else 0


def interrupted(folder: Path, number: int, sent: signal.Signals, processes: int) -> tuple[int, str]:
    """Start the command, send it a signal after ``number`` cases; its status and what it says. Its own processes end as well."""
    with subprocess.Popen(
        [*COMMAND, "--out", str(folder), "-j", str(processes)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        deadline = time.monotonic() + 600.0
        while lines(folder) < number:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.005)
        # Ctrl-C reaches all processes of the terminal, kill -9 one
        os.killpg(process.pid, sent) if sent == signal.SIGINT else process.send_signal(sent)
        _, said = process.communicate(timeout=600)  # its processes hold the pipe until they have ended
    return process.returncode, said


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="POSIX signals")
def test_killed_commands_continue(tmp_path: Path) -> None:
    """kill -9, then Ctrl-C, then to the end by another number of processes: at most the cases in flight are lost."""
    out = tmp_path / "out"
    status, _ = interrupted(out, 4, signal.SIGKILL, 2)
    assert status == -signal.SIGKILL
    before = lines(out)
    assert 4 <= before < 25
    status, said = interrupted(out, before + 4, signal.SIGINT, 1)
    assert status == 1
    assert "of 25 cases are in" in said
    assert "Traceback" not in said
    assert before + 4 <= lines(out) < 25
    # the end, and the same without an interruption
    shown = subprocess.run([*COMMAND, "--out", str(out), "-j", "2"], check=True, capture_output=True, text=True)
    assert "25 cases over" in shown.stdout
    flexfmu.sweep("barnard2012-6kg", CASES, metrics=METRICS, out=tmp_path / "whole")
    assert (out / "sweep.csv").read_bytes() == (tmp_path / "whole" / "sweep.csv").read_bytes()
