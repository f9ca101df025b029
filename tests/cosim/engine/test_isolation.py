"""Slaves that crash, exit or hang end their run alone, with their name, the time and all that was recorded."""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import FmuFileError, InputError
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master import simulator as module
from flexfmu.cosim.engine.master.outcome import message_of
from flexfmu.cosim.engine.master.simulator import Outcome, Simulation, isolation, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")

QUICK, PATIENT = 0.3, 30.0
"""Time limits of a call [s]: for slaves that hang, and for those that end by themselves, however busy the machine is."""


@pytest.fixture(autouse=True)
def quiet_crashes() -> Iterator[None]:
    """Crashes on purpose need no traceback."""
    faulthandler.disable()
    yield
    faulthandler.enable(sys.__stderr__)


class Ramp(PythonSlave):
    """x = t; at 0.5 s it does something else."""

    name = "ramp"
    variables = (SlaveVariable("x", "output"),)
    feedthrough = {"x": ()}  # noqa: RUF012

    def __init__(self, deed: Callable[[], object] = lambda: None) -> None:
        super().__init__()
        self._deed = deed

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.time

    def step(self, time: float, step: float) -> None:
        super().step(time, step)
        if self.time > 0.5 + 1e-9:
            self._deed()

    def save(self) -> object:
        return self.time

    def restore(self, state: object) -> None:
        self.time = float(str(state))


def stubborn() -> None:
    """Raises what can't go from one process to another."""
    raise RuntimeError("no", lambda: None)


def sleep() -> None:
    """Doesn't return, and can't be interrupted."""
    while True:
        try:
            time.sleep(0.1)
        except BaseException:
            continue


def assert_recorded(run: Simulation, name: str, words: str) -> None:
    """Half of the way was recorded, and the message says whose fault the rest is."""
    assert run.outcome is Outcome.STEP_FAILED
    assert run.message.startswith(f"{name} failed at 0.5 s: ")
    assert words in run.message
    assert run.recording.time[-1] == pytest.approx(0.5)
    assert run.steps == 50


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        ("aborts", "it crashed with SIGABRT"),
        ("crashes", "it crashed with SIGSEGV"),
        ("hangs", "it hasn't returned for 0.3 s"),
        ("exits", "it ended its process with exit status 0"),
        ("fails", "decay is tired after 50 steps"),
    ],
)
def test_an_fmu_in_trouble(foreign_fmu: Path, trouble: str, words: str, compiled: bool) -> None:
    """Named among others, in C and in Python; what it recorded is what it records without trouble."""
    slaves = [Ramp(), FmuSlave(foreign_fmu, "guest", {"trouble": trouble})]
    limit = QUICK if trouble == "hangs" else PATIENT
    run = simulate(connect(slaves, []), 1.0, 0.01, compiled=compiled, isolation=limit)
    assert_recorded(run, "guest", words)
    assert run.recording["guest.x"].values == pytest.approx(np.exp(-run.recording.time), rel=1e-12)
    assert np.array_equal(run.recording["ramp.x"].values, run.recording.time)


@pytest.mark.parametrize(
    ("deed", "words"),
    [
        (lambda: os._exit(3), "exit status 3"),
        (lambda: sys.exit(0), "it called sys.exit(0)"),
        (sleep, "hasn't returned"),
        (stubborn, "RuntimeError: ('no'"),
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_a_python_slave_in_trouble(deed: Callable[[], object], words: str) -> None:
    """However it ends the run, all is recorded until then; nor can sys.exit end the program without isolation."""
    limit = QUICK if deed is sleep else PATIENT
    assert_recorded(simulate(connect([Ramp(deed)], []), 1.0, 0.01, isolation=limit), "ramp", words)
    if "sys.exit" in words:
        assert_recorded(simulate(connect([Ramp(deed)], []), 1.0, 0.01), "ramp", words)


HANGING = """
import signal, sys, time, threading
from pathlib import Path
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from test_isolation import Ramp

# a shell's background jobs ignore it, and so would this process
signal.signal(signal.SIGINT, signal.default_int_handler)

def hang():
    print("hanging", file=sys.stderr, flush=True)
    {loop}

run = simulate(connect([Ramp(hang)], []), 1.0, 0.01, isolation=60.0)
print(run.outcome.name, run.steps, flush=True)
"""


@pytest.mark.parametrize(
    ("loop", "number"),
    [("time.sleep(60)", signal.SIGINT), ("test_isolation.sleep()", signal.SIGINT), ("time.sleep(60)", signal.SIGKILL)],
)
def test_interrupted_and_killed(loop: str, number: signal.Signals) -> None:
    """Ctrl-C keeps what was recorded, also where the slave doesn't listen; a parent that is killed leaves no child behind."""
    script = HANGING.format(loop=f"import test_isolation; {loop}")
    folder = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (folder, folder.parents[1])))}
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", script], start_new_session=True, env=environment, **pipes) as parent:
        assert parent.stdout is not None
        assert parent.stderr is not None
        # what slaves print isn't a result
        assert parent.stderr.readline() == "hanging\n"
        (child,) = Path(f"/proc/{parent.pid}/task/{parent.pid}/children").read_text().split()
        if number is signal.SIGINT:
            os.killpg(parent.pid, number)  # as a terminal does
            assert parent.stdout.read() == "INTERRUPTED 50\n"
        else:
            parent.kill()
    end = time.monotonic() + 600.0
    while _runs(child):
        assert time.monotonic() < end
        time.sleep(0.01)


def _runs(process: str) -> bool:
    """Whether there is such a process; one that nobody has asked how it ended is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_the_same_numbers_and_reports(foreign_fmu: Path) -> None:
    """Isolation changes no bit of a run, and what the FMU says afterwards arrives, run after run."""
    slave = FmuSlave(foreign_fmu, "guest", {"rate": 2.0})
    seen: list[float] = []
    here = simulate(connect([slave], []), 1.0, 0.01)
    there = simulate(connect([slave], []), 1.0, 0.01, isolation=PATIENT, progress=seen.append)
    assert there.outcome is Outcome.COMPLETED
    assert np.array_equal(here.recording.time, there.recording.time)
    assert np.array_equal(here.recording["guest.x"].values, there.recording["guest.x"].values)
    assert slave.statistics == {"steps": 100}
    assert seen[-1] == 1.0


def test_a_library_that_crashes_when_it_is_loaded(
    foreign_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is a broken FMU, not the end of the program."""
    monkeypatch.setenv("DECAY_CRASHES", "yes")
    copy = tmp_path / "copy.fmu"  # with other content: libraries are loaded once
    copy.write_bytes(foreign_fmu.read_bytes() + b" ")
    with pytest.raises(FmuFileError, match="loading its library, it crashed with SIGABRT"):
        FmuSlave(copy)


def test_who_is_isolated(foreign_fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other tools' FMUs and a scene's Python slaves are, unless the user says no; our own slaves and objects whose state the
    caller may look at aren't, unless the user says yes."""
    guest, python = FmuSlave(foreign_fmu), Ramp()
    assert isolation(None, [guest], 1.0, caller_owned=True) == 1.0
    assert isolation(None, [python], 1.0, caller_owned=False) == 1.0
    assert isolation(None, [guest, python], 1.0, caller_owned=True) is None
    assert isolation(False, [guest], 1.0, caller_owned=False) is None
    assert isolation(True, [python], 1.0, caller_owned=True) == 1.0
    assert isolation(None, [], 1.0, caller_owned=False) is None
    monkeypatch.setattr(module, "AVAILABLE", False)
    assert isolation(None, [guest], 1.0, caller_owned=False) is None
    with pytest.raises(InputError, match="needs Linux"):
        isolation(True, [], 1.0, caller_owned=False)


def test_an_exit_that_was_pickled_keeps_its_status() -> None:
    """Dask's tblib makes SystemExit pickle without its code; the status is among the arguments too."""
    error = SystemExit(3)
    error.code = None
    assert "it called sys.exit(3)" in message_of(error, Outcome.STEP_FAILED, "ramp", 0.5)
