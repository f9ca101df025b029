"""What commands leave behind when something ends or starves them: a table of command × fault.

python benchmarks/faults.py [--command run --command sweep] [--fault SIGKILL --fault full-output] [--draws 2] [--seed 1] [--keep]

Each command runs in a folder, a temporary folder and a cache of its own. It is judged from outside:

- no traceback, at most one line on standard error beside those of an undisturbed run, of at most `LONGEST` characters;
- the status is one of a program that ended by itself, not of a crash;
- files under their final names are whole, all of them where the command says that it has succeeded, and with the bytes of an undisturbed
  run as far as two undisturbed runs write the same; a journal has whole lines but for the last one. Nothing else is left beside them,
  unless the command was killed by SIGKILL or could not write;
- `validate` says of the FMU what it says undisturbed, or nothing;
- no process is left, nor anything in the temporary folder; what SIGKILL leaves there, the next start removes;
- after a signal the same command goes on to its end, with the files of an undisturbed run.

Prints what fails; status 1 if anything does. Linux. Full and read-only folders are small tmpfs for root; for others they are a limit on
the size of files and folders without permission to write. 300 MB of memory are a limit of the address space, of which Python with its
libraries reserves more than it uses: commands may fail there, in a sentence.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import uuid
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

FLEXFMU = (sys.executable, "-c", "from flexfmu.cosim.cli.main import main; main()")

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"

LONGEST = 800
"""Largest number of characters of what a failed command says; paths of temporary folders are long."""

LIMIT = 180.0
"""A command that takes longer hangs [s]."""

EARLIEST = 0.15
"""Before it Python itself starts [s], which answers signals in its own way."""

GRACE = 3.0
"""Time that processes have to notice that their parent is gone [s]."""

MEMORY = 300_000_000
"""Address space [bytes]."""

SCENE = "barnard2012-6kg"

MARK = "FLEXFMU_FAULTS"
"""Variable by which the processes of a case are found, its children's children too."""

COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", SCENE, "--out", "out"),
    "run-ssp": ("run", "../given/a.ssp", "--out", "out"),
    "sweep": ("sweep", SCENE, "--vary", "payload.mass=1,2,3,4,5,6", "-j", "2", "--out", "out"),
    "tune": (
        *("tune", "../given/loop.toml", "--over", "pd.proportional=4e3:6e3", "--minimise", "rms_tracking_error"),
        *("--trials", "6", "-j", "2", "--out", "out"),
    ),
    "plan": ("plan", SCENE, "--method", "search", "--budget", "600", "--no-robust", "-j", "2", "--out", "out"),
    "margins": ("margins", "../given/loop.toml", "--poses", "1", "--out", "out"),
    "effects": ("effects", SCENE, "--tolerance", "0.5", "--out", "out"),
    "workprec": ("workprec", SCENE, "--only", "communication", "--out", "out"),
    "build": ("build", SCENE, "-o", "out/robot.fmu"),
    "validate": ("validate", "../given/a.fmu"),
    "compare": ("compare", SCENE, "../given/loop.toml", "--out", "out"),
    "export": ("export", SCENE, "-o", "out/a.ssp"),
}
"""Command → arguments, in a folder beside ``given``."""

SIGNALS = {name: signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGKILL")}

BY_TERMINAL = ("SIGINT", "SIGHUP", "SIGQUIT")
"""Signals that a terminal sends to all processes of a command; the others come from `kill`, to the first one alone."""

STARVED = {
    "full-output": "out",
    "full-cache": "cache",
    "full-tmp": "tmp",
    "read-only-output": "out",
    "read-only-cache": "cache",
    "read-only-tmp": "tmp",
}
"""Fault → the folder without room or permission."""

LIMITS: dict[str, tuple[int, int]] = {
    "300-MB": (resource.RLIMIT_AS, MEMORY),
    "8-files": (resource.RLIMIT_NOFILE, 8),
    "20-files": (resource.RLIMIT_NOFILE, 20),
}

FAULTS = (*SIGNALS, *STARVED, *LIMITS, "two-at-once")

TOLD = re.compile(r"fail|can't|out of memory|no space", re.IGNORECASE)
"""What standard output must have where a command that fails says nothing on standard error: a sweep's table of its cases does."""


@dataclass(frozen=True)
class Usual:
    """Two undisturbed runs of a command.

    Attributes:
        duration: of the second one [s].
        lines: on standard error.
        printed: on standard output.
        results: names of the files.
        steady: file → SHA-256, for those that both runs have written alike.
    """

    duration: float
    lines: list[str]
    printed: str
    results: set[str]
    steady: dict[str, str]


@dataclass
class Case:
    """A command in a folder of its own.

    Attributes:
        home: folder with ``out``, ``tmp`` and ``cache``.
        arguments: of the command.
        mark: value of `MARK` in the environment of its processes.
        problems: what was found.
        status: exit status of the command, negative for a signal that ended it.
        printed: its standard output; a sweep tells there what has failed.
    """

    home: Path
    arguments: tuple[str, ...]
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    problems: list[str] = field(default_factory=list)
    status: int = 0
    printed: str = ""

    def start(self, prepare: Callable[[], None] | None = None) -> subprocess.Popen[str]:
        """Start the command in a session of its own."""
        environment = os.environ | {
            MARK: self.mark,
            "TMPDIR": str(self.home / "tmp"),
            "FLEXFMU_CACHE": str(self.home / "cache"),
        }
        return subprocess.Popen(
            [*FLEXFMU, *self.arguments],
            cwd=self.home,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=prepare,
        )

    def end(self, process: subprocess.Popen[str]) -> list[str]:
        """Wait for the command; return the lines that it wrote to standard error."""
        try:
            self.printed, said = process.communicate(timeout=LIMIT)
        except subprocess.TimeoutExpired:
            self.problems.append(f"hangs for {LIMIT:g} s")
            for pid in self.processes():
                os.kill(pid, signal.SIGKILL)
            self.printed, said = process.communicate()
        self.status = process.returncode
        return [line for line in said.splitlines() if line.strip()]

    def processes(self) -> list[int]:
        """Those of the command that are alive."""
        found, wanted = [], f"{MARK}={self.mark}".encode()
        for path in Path("/proc").glob("[0-9]*/environ"):
            with contextlib.suppress(OSError):
                if wanted in path.read_bytes().split(b"\0"):
                    found.append(int(path.parent.name))
        return found

    def check_processes(self) -> None:
        """None may be left; those that are, are ended."""
        deadline = time.monotonic() + GRACE
        while (left := self.processes()) and time.monotonic() < deadline:
            time.sleep(0.05)
        if left:
            self.problems.append(f"{len(left)} processes are left")
        for pid in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def check_said(self, lines: list[str], usual: list[str]) -> None:
        """One line beside those of an undisturbed run."""
        own = [line for line in lines if line not in usual and "warning" not in line]
        if any("Traceback" in line or line.startswith('  File "') for line in lines):
            self.problems.append(f"traceback: {lines[-1][:160]}")
        elif len(own) > 1:
            self.problems.append(f"{len(own)} lines: {' / '.join(own)[:300]}")
        elif self.status > 0 and not own and not TOLD.search(self.printed):
            self.problems.append(f"status {self.status} without a word")
        if any(len(line) > LONGEST for line in own):
            self.problems.append(f"a line of {max(map(len, own))} characters: {max(own, key=len)[:160]}")

    def check_temporary(self) -> None:
        """Nothing may be left in the temporary folder."""
        left = sorted(path.name for path in (self.home / "tmp").iterdir())
        if left:
            self.problems.append(f"left in TMPDIR: {', '.join(left)[:160]}")

    def check_files(self, *, killed: bool = False) -> None:
        """What stands under a final name must be whole, and beside it nothing, unless the command was killed."""
        for path in sorted((self.home / "out").rglob("*")):
            name = str(path.relative_to(self.home / "out"))
            if path.is_dir():
                continue
            if path.name.startswith("."):
                if not killed:
                    self.problems.append(f"left beside the results: {name}")
            elif (reason := broken(path)) is not None:
                self.problems.append(f"half a file {name}: {reason}")
        for path in sorted((self.home / "cache").rglob("*.fmu")):
            if (reason := broken(path)) is not None:
                self.problems.append(f"half a file in the cache, {path.name}: {reason}")

    def check_results(self, usual: Usual) -> None:
        """All files of an undisturbed run are there, with its bytes as far as these are always the same."""
        digests = self.digests()
        if {*digests} != usual.results:
            self.problems.append(f"other files: {sorted({*digests} ^ usual.results)}")
        if changed := [name for name, digest in usual.steady.items() if digests.get(name, digest) != digest]:
            self.problems.append(f"other bytes: {', '.join(changed)}")

    def digests(self) -> dict[str, str]:
        """Files of results, with their SHA-256."""
        out = self.home / "out"
        files = (path for path in out.rglob("*") if path.is_file())
        return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def broken(path: Path) -> str | None:
    """Why a file isn't whole; None if it is, or if its kind is unknown."""
    content = path.read_bytes()
    try:
        match path.suffix:
            case ".json":
                json.loads(content)
            case _ if path.stem == "journal":  # only appended to; the next process cuts a torn line off
                whole = content.decode(errors="replace").splitlines(keepends=True)
                whole = [line for line in whole if line.endswith("\n")]
                if path.suffix == ".jsonl":
                    list(map(json.loads, whole))
                elif len({len(row) for row in csv.reader(whole)}) > 1:
                    return "rows of several widths"
                return None
            case ".toml":
                tomllib.loads(content.decode())
            case ".svg":
                ElementTree.fromstring(content)
            case ".html" if not content.rstrip().endswith(b"</html>"):
                return "no end"
            case ".png" if b"IEND" not in content[-12:]:
                return "no end"
            case ".fmu" | ".ssp":
                with zipfile.ZipFile(path) as archive:
                    return archive.testzip()
            case ".csv":
                widths = {len(row) for row in csv.reader(content.decode().splitlines())}
                if len(widths) != 1 or not content.endswith(b"\n"):
                    return f"rows of {widths} cells"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return None if content else "empty"


def with_limit(which: int, value: int) -> None:
    """Limit this process and its children."""
    resource.setrlimit(which, (value, value))


@contextlib.contextmanager
def starved(folder: Path, fault: str, room: int) -> Iterator[Callable[[], None] | None]:
    """A context in which the folder is full after ``room`` bytes, or read-only; yields what the child does before it starts."""
    kept = folder.with_name(f"{folder.name}-kept")
    options = "ro" if fault.startswith("read-only") else f"size={room}"
    if os.geteuid() != 0:
        folder.chmod(0o555 if options == "ro" else 0o755)
        yield None if options == "ro" else partial(with_limit, resource.RLIMIT_FSIZE, room)
        folder.chmod(0o755)
        return
    shutil.copytree(folder, kept)
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "faults", folder], check=True)
    try:
        yield None
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)
        shutil.rmtree(kept)


class Bench:
    """The undisturbed runs, and the cases beside them.

    Args:
        home: folder of all cases.
        seed: of the instants.
    """

    def __init__(self, home: Path, seed: int) -> None:
        self.home, self.random = home, random.Random(seed)
        self.usual: dict[str, Usual] = {}
        given = self.case("given", ())
        given.home.rename(home / "given-home")
        given = Case(home / "given-home", ())
        (home / "given").mkdir()
        loop = (EXAMPLES / "controller_scene.toml").read_text(encoding="utf-8")
        (home / "given" / "loop.toml").write_text(loop.replace('kind = "pd"', 'kind = "pd"\nname = "pd"'))
        for arguments in (("export", SCENE, "-o", "../given/a.ssp"), ("build", SCENE, "-o", "../given/a.fmu")):
            lines = (one := Case(given.home, arguments)).end(one.start())
            if one.status:
                raise SystemExit(f"faults: {' '.join(arguments)} ends with {one.status}: {lines}")
        self.cache = given.home / "cache"

    def case(self, name: str, arguments: tuple[str, ...]) -> Case:
        """A case with empty folders, and a cache that has what an undisturbed run has left there."""
        home = self.home / name
        for each in ("out", "tmp"):
            (home / each).mkdir(parents=True)
        if hasattr(self, "cache"):
            shutil.copytree(self.cache, home / "cache")
        else:
            (home / "cache").mkdir()
        return Case(home, arguments)

    def undisturbed(self, command: str) -> Usual:
        """Two runs, of which the first one fills the cache."""
        if command not in self.usual:
            first: dict[str, str] = {}
            for number in range(2):
                case = self.case(f"{command}-{number}", COMMANDS[command])
                begin = time.monotonic()
                lines = case.end(case.start())
                duration = time.monotonic() - begin
                if case.status not in (0, 1) or not case.printed:
                    raise SystemExit(f"faults: {' '.join(COMMANDS[command])} ends with {case.status}: {lines}")
                if number == 0:
                    self.cache, first = case.home / "cache", case.digests()
                    continue
                case.check_processes()
                case.check_temporary()
                case.check_files()
                if case.problems:
                    print(f"{command}, undisturbed: {'; '.join(case.problems)}")
            digests = case.digests()
            steady = {name: digest for name, digest in digests.items() if first.get(name) == digest}
            self.usual[command] = Usual(duration, lines, case.printed, {*digests}, steady)
        return self.usual[command]

    def signalled(self, case: Case, command: str, name: str) -> str:
        """Send a signal at a drawn instant; then run the command to its end. Return what was drawn."""
        usual = self.undisturbed(command)
        instant = self.random.uniform(EARLIEST, max(usual.duration, 2.0 * EARLIEST))
        process = case.start()
        time.sleep(instant)
        if process.poll() is None:
            (os.killpg if name in BY_TERMINAL else os.kill)(process.pid, SIGNALS[name])
        lines = case.end(process)
        killed = name == "SIGKILL"
        if case.status not in (0, 1, 128 + SIGNALS[name], -SIGNALS[name]):
            case.problems.append(f"status {case.status}")
        case.check_processes()
        if not killed:
            case.check_said(lines, usual.lines)
            case.check_temporary()
        case.check_files(killed=killed)
        # the same command once more
        again = case.end(case.start())
        if case.status:
            case.problems.append(f"doesn't go on: {again[-1][:200] if again else 'without a word'}")
        case.check_temporary()
        case.check_files()
        case.check_results(usual)
        return f"at {instant:.2f} s of {usual.duration:.2f}"

    def starved(self, case: Case, command: str, fault: str) -> str:
        """Run the command with a full or a read-only folder."""
        folder = case.home / STARVED[fault]
        # an empty cache has to be filled
        room = int(2.0 ** self.random.uniform(12.0, 20.0))
        with starved(folder, fault, room) as prepare:
            lines = case.end(case.start(prepare))
            self._check(case, lines, command)
        return f"{room} bytes" if fault.startswith("full") else ""

    def limited(self, case: Case, command: str, fault: str) -> str:
        """Run the command with little memory or few file descriptors."""
        lines = case.end(case.start(partial(with_limit, *LIMITS[fault])))
        self._check(case, lines, command)
        return f"status {case.status}"

    def twice(self, case: Case, command: str) -> str:
        """Start the command twice in one folder: one of them ends as ever, the other one too or with a sentence."""
        other = Case(case.home, case.arguments, case.mark)
        first, second = case.start(), other.start()
        lines, others = case.end(first), other.end(second)
        if {case.status, other.status} not in ({0}, {0, 1}, {0, 2}):
            case.problems.append(f"status {case.status} and {other.status}: {lines} {others}"[:300])
        other.check_said(others, self.undisturbed(command).lines)
        case.problems += other.problems
        self._check(case, lines, command)
        case.check_results(self.undisturbed(command))
        return f"status {case.status} and {other.status}"

    def judge(self, command: str, fault: str, number: int) -> tuple[str, list[str]]:
        """What was drawn, and the problems of a case."""
        self.undisturbed(command)
        case = self.case(f"{command}-{fault}-{number}", COMMANDS[command])
        if fault in SIGNALS:
            drawn = self.signalled(case, command, fault)
        elif fault in STARVED:
            drawn = self.starved(case, command, fault)
        elif fault in LIMITS:
            drawn = self.limited(case, command, fault)
        else:
            drawn = self.twice(case, command)
        if not case.problems:
            shutil.rmtree(case.home, ignore_errors=True)
        return drawn, case.problems

    def _check(self, case: Case, lines: list[str], command: str) -> None:
        usual = self.undisturbed(command)
        if case.status not in (0, 1, 2):
            case.problems.append(f"status {case.status}")
        if command == "validate" and case.printed not in ("", usual.printed):
            case.problems.append(f"other findings: {case.printed[:300]}")
        if case.status == 0:
            case.check_results(usual)
        case.check_said(lines, usual.lines)
        case.check_processes()
        case.check_temporary()
        case.check_files()


def main() -> None:
    """Judge the chosen commands and faults, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--command", action="append", choices=COMMANDS, help="only this one; may be repeated")
    parser.add_argument("--fault", action="append", choices=FAULTS, help="only this one; may be repeated")
    parser.add_argument("--draws", type=int, default=2, help="instants of each signal")
    parser.add_argument("--seed", type=int, default=1, help="of instants and sizes")
    parser.add_argument("--keep", action="store_true", help="keep the folders of cases that fail")
    options = parser.parse_args()
    home = Path(tempfile.mkdtemp(prefix="flexfmu-faults-"))
    failed, cases = 0, 0
    try:
        bench = Bench(home, options.seed)
        faults = options.fault or FAULTS
        print(f"{'command':10}" + "".join(f"{each:>18}" for each in faults), flush=True)
        for command in options.command or COMMANDS:
            cells, told = [], []
            for fault in faults:
                if fault in STARVED and STARVED[fault] == "out" and not bench.undisturbed(command).results:
                    cells.append("-")  # it writes no files
                    continue
                count = options.draws if fault in SIGNALS else 1
                found = [bench.judge(command, fault, number) for number in range(count)]
                bad = [(drawn, problems) for drawn, problems in found if problems]
                told += [f"    {command}, {fault} {drawn}: {'; '.join(problems)}" for drawn, problems in bad]
                failed, cases = failed + len(bad), cases + count
                cells.append(f"{len(bad)} of {count} fail" if bad else f"{count} ok" if count > 1 else "ok")
            print(f"{command:10}" + "".join(f"{each:>18}" for each in cells), *told, sep="\n", flush=True)
    finally:
        if not (options.keep and failed):
            shutil.rmtree(home, ignore_errors=True)
    print(f"{failed} of {cases} cases fail" + (f"; their folders are in {home}" if options.keep and failed else ""))
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
