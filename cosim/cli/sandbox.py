"""Runs a command again with fewer rights: for scenes, SSP files and FMUs of people whose programs one wouldn't run otherwise.

The process may read what its user may read, but writes nowhere but into its folders, has no network, is limited in memory, files and
processes, and what it has started ends with it. With bubblewrap on the path it also sees no other processes; otherwise Linux' Landlock
and name spaces confine it, below a guard.

Sources: landlock(7), user_namespaces(7), setrlimit(2), bwrap(1).
"""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import shutil
import signal
import struct
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import typer

from flexfmu.cosim.cli.console import FAILURE
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.files import OutputFolder
from flexfmu.errors import remove_empty
from flexfmu.fmu_build.guard import guarded
from flexfmu.fmu_build.temporary import temporary_folder

WITHIN = "FLEXFMU_SANDBOX"
"""Environment variable of a process that is confined."""

MEMORY, FILE_SIZE, FILES, PROCESSES = 8 << 30, 4 << 30, 1024, 4096
"""Limits of a confined process: address space and size of a file [bytes], open files, processes of its user."""

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
"""System calls of Landlock, the same numbers on all processors."""

_WRITING = {1: 0x1FF2, 2: 0x3FF2, 3: 0x7FF2}
"""Version of Landlock → rights to the file system but for executing and reading: write, remove, make, move, truncate."""

_TCP, _SCOPE = 0x3, 0x3
"""Rights to bind and to connect, from version 4 on; abstract sockets and signals to others, from version 6 on."""

_SOCKET = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""Processor → its number in seccomp's data, and that of the system call `socket`."""

_IO_URING, _FOREIGN = 425, 1 << 30
"""System call that does others' work, and the first one of another set of them (x32)."""

_NEW_USER, _NEW_PROCESSES, _NEW_NETWORK = 0x10000000, 0x20000000, 0x40000000
_PARENT_DEATH, _NO_NEW_PRIVILEGES, _SET_SECCOMP, _FILTER, _PATH_BENEATH, _PATH = 1, 38, 22, 2, 1, 0x200000


def run_in_sandbox(folder: Path | None) -> None:
    """Run this command in a process that writes into this folder and temporary files alone, and return in that process alone.

    The folder is made if it is missing.

    Raises:
        typer.Exit: the process has ended, with its exit status.
        InputError: this system can't confine a process.
    """
    if WITHIN in os.environ:
        return
    bubblewrap = shutil.which("bwrap")
    if bubblewrap is None and not _landlock():
        raise InputError(
            "--sandbox needs Linux 5.13 with Landlock, or bubblewrap (bwrap) on the path: run what you don't trust in a "
            "container or a virtual machine"
        )
    with ExitStack() as stack:
        if folder is not None:
            stack.callback(remove_empty, OutputFolder(folder).prepare())
        temporary = stack.enter_context(temporary_folder("sandbox"))
        here, command = os.getpid(), [sys.executable, "-m", "flexfmu", *sys.argv[1:]]
        writable = [temporary] if folder is None else [str(folder.resolve()), temporary]
        environment = {**os.environ, WITHIN: "1", "TMPDIR": temporary, "MPLCONFIGDIR": temporary}
        if bubblewrap is not None:
            bound = [word for path in writable for word in ("--bind", path, path)]
            # a root that keeps its capabilities would mount everything anew
            apart = ["--unshare-all", "--die-with-parent", "--cap-drop", "ALL"]
            settings = [word for path in ("/proc/sys", "/proc/sysrq-trigger") for word in ("--ro-bind-try", path, path)]
            system = ["--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc", *settings]
            command = [bubblewrap, *system, *bound, *apart, *command]
        # without a terminal, into which it could type; this process passes signals on
        process = subprocess.Popen(
            command,
            env=environment,
            stdout=sys.stdout,  # what `keep_stdout` has kept; the process's own is standard error
            preexec_fn=lambda: _confine(here, [] if bubblewrap is not None else writable),
            start_new_session=bubblewrap is not None,  # a guard begins its own
        )
        try:
            status = process.wait()
        except KeyboardInterrupt:
            inner = process.pid
            # a guard passes it on; bubblewrap would end all at once; below it and its first process is ours
            with suppress(OSError, IndexError):
                for _ in range(0 if bubblewrap is None else 2):
                    inner = int(Path(f"/proc/{inner}/task/{inner}/children").read_text().split()[0])
            os.kill(inner, signal.SIGTERM)
            process.wait()
            raise typer.Exit(FAILURE) from None
        raise typer.Exit(status if status >= 0 else 128 - status)


def _landlock() -> int:
    """Version of Landlock; 0 where there is none."""
    if sys.platform != "linux":
        return 0
    version: int = ctypes.CDLL(None).syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    return max(0, version)


def _confine(parent: int, writable: Sequence[str]) -> None:
    """Limit this process, which is about to become another program, and leave guards above it.

    Args:
        parent: the process that has forked this one, whose end is that of this one.
        writable: folders to write into; none where bubblewrap sees to that, and to the end of processes.

    Raises:
        OSError: the system refuses.
    """
    import resource

    for kind, limit in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_FSIZE, FILE_SIZE),
        (resource.RLIMIT_NOFILE, FILES),
        (resource.RLIMIT_NPROC, PROCESSES),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        least = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (least, least))
    library, version = ctypes.CDLL(None, use_errno=True), _landlock()
    library.prctl(_PARENT_DEATH, signal.SIGKILL)
    library.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    _refuse_local_sockets(library)
    if not writable:
        return

    def call(*arguments: object) -> int:
        found: int = library.syscall(*arguments)
        if found < 0:
            raise OSError(ctypes.get_errno(), "Landlock refuses")
        return found

    # a network of its own, with nothing in it, as the same user; where name spaces are forbidden Landlock still refuses TCP
    user = os.getuid()
    if library.unshare(_NEW_USER | _NEW_NETWORK | _NEW_PROCESSES) == 0:
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        guarded(parent)
        parent = 0  # below here is the first process of a name space, whose end is that of all in it
    elif version < 4:
        raise OSError(ctypes.get_errno(), "this system allows no name spaces")
    guarded(parent)
    rights = _WRITING[min(version, 3)]
    handled = struct.pack("QQQ", rights, _TCP, _SCOPE)[: 24 if version >= 6 else 16 if version >= 4 else 8]
    rules = call(_CREATE_RULESET, handled, ctypes.c_size_t(len(handled)), 0)
    for path in (*writable, "/dev/null"):
        descriptor = os.open(path, _PATH | os.O_CLOEXEC)
        allowed = rights if os.path.isdir(path) else rights & 0x4002
        call(_ADD_RULE, rules, _PATH_BENEATH, struct.pack("=Qi", allowed, descriptor), 0)
        os.close(descriptor)
    call(_RESTRICT_SELF, rules, 0)
    os.close(rules)


def _refuse_local_sockets(library: ctypes.CDLL) -> None:
    """Refuse sockets to programs of this machine, a desktop's bus or tmux for example, which would do what this process mustn't.

    They are files, from which neither Landlock nor a network of its own keeps off: a filter of seccomp, in Berkeley's packet filter code.

    Raises:
        OSError: the system refuses.
    """
    if platform.machine() not in _SOCKET:
        return
    from socket import AF_UNIX

    processor, opening = _SOCKET[platform.machine()]
    load, equal, at_least, end = 0x20, 0x15, 0x35, 0x06
    filters = (  # operation, instructions that are passed over if it holds and if not, value
        *((load, 0, 0, 4), (equal, 0, 8, processor)),
        *((load, 0, 0, 0), (at_least, 6, 0, _FOREIGN)),
        *((equal, 4, 0, _IO_URING), (equal, 0, 2, opening)),
        *((load, 0, 0, 16), (equal, 1, 0, AF_UNIX)),
        *((end, 0, 0, 0x7FFF0000), (end, 0, 0, 0x50000 | errno.EACCES), (end, 0, 0, 0x80000000)),  # allow, refuse, kill
    )
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *each) for each in filters))
    program = struct.pack("H6xQ", len(filters), ctypes.addressof(code))
    if library.prctl(_SET_SECCOMP, _FILTER, program, 0, 0):
        raise OSError(ctypes.get_errno(), "seccomp refuses")
