"""Processes that work for another one end with it, and so does what foreign code has started."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Timer
from time import monotonic, sleep
from typing import Any

import pytest

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.fmu_build.validation.supervisor import _end_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks at processes as Linux shows them")

WORKING = """
import os, sys, time
from flexfmu.cosim.many.executor import mapping

def work(item):
    # in one piece: two workers share the pipe
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(600)

with mapping(work, 2) as mapped:
    list(mapped([1, 2]))
"""

ENDING = """
import sys, time, typer
from flexfmu.cosim.cli.console import one_line_errors, orderly_termination

def command():
    with one_line_errors():
        print("ready", flush=True)
        time.sleep(600)

with orderly_termination():
    typer.run(command)
"""


LONGEST = 120.0
"""How long a process may take, so that no test waits for ever for what it prints [s]."""


def started(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    """A Python process whose output is read, and which is killed after `LONGEST`."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, *arguments], text=True, **pipes, **options)
    limit = Timer(LONGEST, process.kill)
    limit.daemon = True
    limit.start()
    return process


def said(process: subprocess.Popen[str], stream: str = "stdout") -> str:
    """The next line that it prints."""
    return str(getattr(process, stream).readline())


def is_running(process: int) -> bool:
    """Whether there is such a process that hasn't ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def ended(process: int) -> bool:
    """Whether a process ends soon."""
    end = monotonic() + 60.0
    while is_running(process) and monotonic() < end:
        sleep(0.02)
    return not is_running(process)


def test_busy_workers_end_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    """SIGKILL leaves the parent no time to end them."""
    (tmp_path / "working.py").write_text(WORKING)
    parent = started(str(tmp_path / "working.py"))
    workers = [int(said(parent)) for _ in range(2)]
    parent.kill()
    parent.wait()
    assert all(map(ended, workers))
    parent.communicate()


STARTING = """
import subprocess, sys, time
from flexfmu.cosim.engine.child_process import in_child

def foreign():
    subprocess.run("(sleep 600 & echo $!; setsid sleep 600 & echo $!) ", shell=True)
    exec(sys.argv[1])

try:
    in_child(foreign, lambda: None, 1.0)
except Exception as error:
    print(error)
time.sleep(600)
"""


@pytest.mark.parametrize(
    ("ending", "told"),
    [
        ("time.sleep(600)", ""),
        ("pass", ""),
        ("sys.exit(3)", ""),
        ("time.sleep(600)", "it hasn't returned"),
        ("__import__('os').abort()", "it crashed with SIGABRT"),
    ],
)
def test_what_foreign_code_starts_ends_with_its_run(ending: str, told: str) -> None:
    """However that ends, or the program itself; also what is orphaned or has begun a session of its own."""
    parent = started("-c", STARTING, ending)
    others = [int(said(parent, "stderr")) for _ in range(2)]
    if told:
        assert told in said(parent)
    elif "sleep" in ending:
        assert all(map(is_running, others))
        parent.kill()
    assert all(map(ended, others))
    parent.kill()
    parent.communicate()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_signals_end_a_command_in_good_order(number: signal.Signals) -> None:
    """With one line, and the status that shells expect, also where a library swallows the interruption; not under nohup."""
    swallowed = "\n        try: time.sleep(600)\n        except BaseException: pass"
    for ignored in (False, True) if number is signal.SIGHUP else (False,):
        # shells ignore SIGQUIT in what runs in their background, these tests for example
        hold = partial(signal.signal, number, signal.SIG_IGN if ignored else signal.SIG_DFL)
        script = ENDING.replace("\n        time.sleep(600)", swallowed) if number is signal.SIGQUIT else ENDING
        process = started("-c", script, preexec_fn=hold)
        assert said(process) == "ready\n"
        os.kill(process.pid, number)
        if ignored:
            sleep(0.2)
            os.kill(process.pid, signal.SIGTERM)
        problem = process.communicate(timeout=60)[1]
        assert process.returncode == 128 + (signal.SIGTERM if ignored else number)
        assert problem == "flexfmu: interrupted\n"


CLAIMING = """
import sys, time
from pathlib import Path
from flexfmu.cosim.engine.files import OutputFolder, replacing
folder = OutputFolder(Path(sys.argv[1]))
folder.prepare()
with folder.claimed(), replacing(folder.path / "results.csv") as part:
    part.touch()
    print("ready", flush=True)
    time.sleep(600)
"""


def test_two_commands_do_not_work_in_one_folder(tmp_path: Path) -> None:
    """The second one is told; when the first one is gone, however it ended, the folder is free and nothing is left in it, half a file neither."""
    first = started("-c", CLAIMING, str(tmp_path / "out"))
    assert said(first) == "ready\n"
    folder = OutputFolder(tmp_path / "out")
    refused = pytest.raises(ResultsError, match=r"another command works in .*out: wait for its end, or choose")
    with refused, folder.claimed():
        pass
    first.kill()
    first.communicate()
    with folder.claimed():
        pass
    assert list(folder.path.iterdir()) == []


def test_what_an_fmu_under_test_starts_ends_with_its_check() -> None:
    """Also in a session of its own."""
    code = "import subprocess; print(subprocess.Popen(['setsid', 'sleep', '600']).pid, flush=True, file=__import__('sys').stderr)"
    with TemporaryDirectory() as folder:
        status, last = _end_of([sys.executable, "-c", code], Path(folder), 60.0)
    assert status == 0
    assert not is_running(int(last))
