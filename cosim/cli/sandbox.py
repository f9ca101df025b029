"""Runs a command again with fewer rights: for scenes, SSP files and FMUs of people whose programs one wouldn't run otherwise.

The process may read what its user may read, but writes nowhere but into its folders, has no network, and is limited in memory, files
and processes. With bubblewrap on the path it also sees no other processes; otherwise Linux' Landlock and name spaces confine it.

Sources: landlock(7), user_namespaces(7), setrlimit(2), bwrap(1).
"""

from __future__ import annotations

import ctypes
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.temporary import temporary_folder

WITHIN = "FLEXFMU_SANDBOX"
"""Environment variable of a process that is confined."""

MEMORY, FILE_SIZE, FILES, PROCESSES = 8 << 30, 4 << 30, 1024, 4096
"""Limits of a confined process: address space and size of a file [bytes], open files, processes of its user."""

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
"""System calls of Landlock, the same numbers on all processors."""

_WRITING = {1: 0x1FF2, 2: 0x3FF2, 3: 0x7FF2}
"""Version of Landlock → rights to the file system but for executing and reading: write, remove, make, move, truncate."""

_TCP = 0x3
"""Rights to bind and to connect, from version 4 on."""

_NEW_USER, _NEW_NETWORK = 0x10000000, 0x40000000
_NO_NEW_PRIVILEGES, _PATH_BENEATH, _PATH = 38, 1, 0x200000


def run_in_sandbox(folder: Path) -> int | None:
    """Run this command in a process that writes into this folder and temporary files alone; its exit status, None in that process.

    Raises:
        InputError: this system can't confine a process.
    """
    if WITHIN in os.environ:
        return None
    bubblewrap = shutil.which("bwrap")
    if bubblewrap is None and not _landlock():
        raise InputError(
            "--sandbox needs Linux 5.13 with Landlock, or bubblewrap (bwrap) on the path: run what you don't trust in a "
            "container or a virtual machine"
        )
    with temporary_folder("sandbox") as temporary:
        command = [sys.executable, "-m", "flexfmu", *sys.argv[1:]]
        writable = [str(folder.resolve()), temporary]
        environment = {**os.environ, WITHIN: "1", "TMPDIR": temporary}
        if bubblewrap is not None:
            bound = [word for path in writable for word in ("--bind", path, path)]
            apart = ["--unshare-net", "--unshare-pid", "--unshare-ipc", "--die-with-parent"]
            command = [bubblewrap, "--ro-bind", "/", "/", "--dev", "/dev", "--proc", "/proc", *bound, *apart, *command]
        process = subprocess.Popen(
            command, env=environment, preexec_fn=lambda: _confine([] if bubblewrap is not None else writable)
        )
        try:
            return process.wait()
        except KeyboardInterrupt:  # the terminal has told the process as well, a signal hasn't
            process.terminate()
            return process.wait()


def _landlock() -> int:
    """Version of Landlock; 0 where there is none."""
    if sys.platform != "linux":
        return 0
    version: int = ctypes.CDLL(None).syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    return max(0, version)


def _confine(writable: Sequence[str]) -> None:
    """Limit this process, which is about to become another program; folders to write into, none where bubblewrap sees to that.

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
    if not writable:
        return
    library, version = ctypes.CDLL(None, use_errno=True), _landlock()

    def call(*arguments: object) -> int:
        found: int = library.syscall(*arguments)
        if found < 0:
            raise OSError(ctypes.get_errno(), "Landlock refuses")
        return found

    # a network of its own, with nothing in it, as the same user; where name spaces are forbidden Landlock still refuses TCP
    user = os.getuid()
    if library.unshare(_NEW_USER | _NEW_NETWORK) == 0:
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
    elif version < 4:
        raise OSError(ctypes.get_errno(), "this system allows no name spaces")
    rights = _WRITING[min(version, 3)]
    handled = struct.pack("QQ", rights, _TCP) if version >= 4 else struct.pack("Q", rights)
    rules = call(_CREATE_RULESET, handled, ctypes.c_size_t(len(handled)), 0)
    for path in (*writable, "/dev/null"):
        descriptor = os.open(path, _PATH | os.O_CLOEXEC)
        allowed = rights if os.path.isdir(path) else rights & 0x4002
        call(_ADD_RULE, rules, _PATH_BENEATH, struct.pack("=Qi", allowed, descriptor), 0)
        os.close(descriptor)
    library.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    call(_RESTRICT_SELF, rules, 0)
    os.close(rules)
