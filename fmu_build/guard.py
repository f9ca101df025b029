"""A guard: a process between a program and the foreign code that it runs, which ends all that this code has started (Linux).

What that code starts, in another session or orphaned too, descends from the guard (a "child subreaper"), which runs nothing foreign. It
ends them when its child or the program has ended, a program that is killed included.

Source: prctl(2), pid_namespaces(7).
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Never

AVAILABLE = sys.platform == "linux"
"""Other systems can't fork, or not safely once numerical libraries are loaded."""

GUARDED = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGCHLD} if sys.platform == "linux" else set()
"""Signals that a guard waits for: SIGHUP, from the program or because that has ended, ends it; SIGTERM is for the child."""

_PR_SET_PDEATHSIG, _PR_SET_DUMPABLE, _PR_SET_CHILD_SUBREAPER = 1, 4, 36

_MOST_FILES = 1 << 16


def guarded(parent: int) -> None:
    """Make this process, which its parent has just forked, the guard of a child of its own, in which this returns.

    The guard ends like its child: with the same exit status or signal.

    Args:
        parent: process whose end is that of the guard.
    """
    # a child that ends is kept until it is asked for, whatever the parent did
    before = signal.pthread_sigmask(signal.SIG_BLOCK, GUARDED)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    _follow(parent, signal.SIGHUP)
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    guard, child = os.getpid(), os.fork()
    if child == 0:
        _follow(guard, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return
    status = 1 << 8
    try:
        os.closerange(3, _MOST_FILES)  # pipes that end with their last process
        status = _watched(child)
    finally:
        _end_like(status)


def _follow(parent: int, ending: signal.Signals) -> None:
    """Begin a session, in which a signal tells when the parent ends; exit if it has ended already."""
    with suppress(PermissionError):  # it leads one
        os.setsid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, ending)
    if os.getppid() not in (parent, 0):  # 0: it isn't in this name space of processes
        os._exit(1)


def _watched(child: int) -> int:
    """Wait for the end of the child or the parent, end all that descends from this process, and return the child's status."""
    is_running = True
    while is_running and (number := signal.sigwait(GUARDED)) != signal.SIGHUP:
        if number == signal.SIGTERM:
            os.kill(child, signal.SIGTERM)
        # those whose parents die become the guard's own
        while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None and is_running:
            is_running = ended.si_pid != child
            if is_running:
                os.waitpid(ended.si_pid, 0)
    os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    # the end of the first process of a name space ends all in it, of which /proc may be another one's
    while os.readlink("/proc/self") == str(os.getpid()) and (below := Path("/proc/thread-self/children").read_text()):
        for each in below.split():
            os.kill(int(each), signal.SIGKILL)
        os.wait()
    return status


def _end_like(status: int) -> Never:
    """End this process as one of that status has ended."""
    if (code := os.waitstatus_to_exitcode(status)) < 0:
        with suppress(OSError):  # the action of SIGKILL can't be set
            signal.signal(-code, signal.SIG_DFL)
        ctypes.CDLL(None).prctl(_PR_SET_DUMPABLE, 0)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {-code})
        os.kill(os.getpid(), -code)
        code = 128 - code  # the first process of a name space can't send itself signals
    os._exit(code)
