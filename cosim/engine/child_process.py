"""Calls a function in a forked child process, so that code which crashes, exits or hangs can't take the program with it.

The child has all objects as they are, and nothing has to be loaded again. What it changes in them stays in the child.
"""

from __future__ import annotations

import ctypes
import gc
import os
import pickle
import select
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from time import monotonic, sleep
from typing import Any, Never

from flexfmu.cosim.engine.errors import CosimError

AVAILABLE = sys.platform == "linux"
"""Elsewhere a process can't be forked safely once numerical libraries are loaded, or not at all."""

CALL_LIMIT = 60.0
"""How long a slave may stay in one call by default [s]."""

GRACE = 2.0
"""How long a child may take to end when the user interrupts [s]."""

LOOK = 0.05
"""How often the parent looks [s]."""

_PR_SET_PDEATHSIG = 1

_END = b"complete"
"""Behind what a child sends."""


class ChildLostError(CosimError):
    """A child process has ended, or was ended, without a result; the message says how.

    The message is a predicate: its subject is the slave that was called.
    """


def in_child(action: Callable[[], Any], look: Callable[[], object], limit: float) -> Any:
    """What an action returns in a child process.

    When the user interrupts, the action meets a `KeyboardInterrupt` like here.

    Args:
        action: what to do; it returns something that can be pickled.
        look: called now and then while the child works; its result changes when the child goes on.
        limit: how long that may stay the same [s].

    Raises:
        ChildLostError: the child ended without a result, or didn't get on.
        KeyboardInterrupt: the user interrupted, and the child didn't end by itself.
        BaseException: what the action raised.
    """
    reading, writing = os.pipe()
    # interruptions wait until the child is ready for them
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        parent, child = os.getpid(), _fork()
        if child == 0:
            _be_child(action, writing, parent)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    # collect what it sends; it is gone when the result is there
    os.close(writing)
    supervisor = _Supervisor(child, reading, look, limit)
    try:
        returned, result = pickle.loads(supervisor.received())
    finally:
        supervisor.close()
    if not returned:
        raise result
    return result


class _Supervisor:
    """Watches a child until it has sent its result, and sees that it is gone afterwards."""

    def __init__(self, child: int, reading: int, look: Callable[[], object], limit: float) -> None:
        self._child, self._reading, self._look, self._limit = child, reading, look, limit
        self._status: int | None = None

    def received(self) -> bytes:
        """All that the child sends."""
        data = bytearray()
        try:
            self._wait(data)
        except KeyboardInterrupt:
            # the child gets as far as it can; a second interruption doesn't wait
            os.kill(self._child, signal.SIGTERM)
            self._limit, self._look = GRACE, lambda: None
            try:
                self._wait(data)
            except ChildLostError:
                raise KeyboardInterrupt from None
        if data[-len(_END) :] != _END:
            raise ChildLostError(self._how())
        return bytes(data)

    def _wait(self, data: bytearray) -> None:
        """Collect what the child sends until it has sent all or is gone."""
        poll = select.poll()
        poll.register(self._reading, select.POLLIN)
        seen, idle, last = self._look(), 0.0, monotonic()
        while True:
            # what it sends, as long as it sends
            if poll.poll(1e3 * LOOK):
                if not (chunk := os.read(self._reading, 1 << 16)):
                    return
                data += chunk
                continue
            if self._gone():
                return  # another process holds the other end of the pipe open
            # time in which this process sleeps as well doesn't count
            now, at = monotonic(), self._look()
            idle = 0.0 if at != seen else idle + min(now - last, 2.0 * LOOK)
            seen, last = at, now
            if idle > self._limit:
                raise ChildLostError(
                    f"it hasn't returned for {self._limit:g} s (`call_limit` is longer if it needs more)"
                )

    def _gone(self) -> bool:
        """Whether the child has ended."""
        if self._status is None:
            process, status = os.waitpid(self._child, os.WNOHANG)
            self._status = status if process else None
        return self._status is not None

    def _how(self) -> str:
        """How the child, which sends nothing any more, has ended without a result."""
        # it may need a moment to end
        end = monotonic() + GRACE
        while not self._gone() and monotonic() < end:
            sleep(1e-3)
        if self._status is None:
            return "it closed the files of its process"
        if (code := os.waitstatus_to_exitcode(self._status)) >= 0:
            return f"it ended its process with exit status {code}; a slave must return from every call"
        # ended by a signal
        number = signal.Signals(-code)
        hint = "; perhaps the memory was full" if number is signal.SIGKILL else ""
        return f"it crashed with {number.name} ({signal.strsignal(number)}){hint}"

    def close(self) -> None:
        """End the child if it is still there."""
        os.close(self._reading)
        if not self._gone():
            os.kill(self._child, signal.SIGKILL)
            self._status = os.waitpid(self._child, 0)[1]


def _flush() -> None:
    """Write all that Python and C have buffered, so that it is written once."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # there is no stream, it is closed, or its reader is gone
            stream.flush()
    ctypes.CDLL(None).fflush(None)


def _fork() -> int:
    """0 in the child, its process number in the parent."""
    _flush()
    with warnings.catch_warnings():
        # threads of numerical libraries and of the progress bar: the child needs neither
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _be_child(action: Callable[[], Any], writing: int, parent: int) -> Never:
    """Do it, send what comes of it, and end without the parent's clean-up."""
    code = 1
    try:
        # never outlive the parent, which may be gone already
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(code)
        # leave the parent's objects where they are, or the collector copies them all
        gc.freeze()
        # what slaves print isn't a result
        with suppress(OSError):
            os.dup2(2, 1)
        sys.stdout = sys.stderr
        # a progress bar has a thread, which isn't here
        sys.stdout, sys.stderr = (getattr(each, "rich_proxied_file", each) for each in (sys.stdout, sys.stderr))
        # handlers of the parent's signals have nothing to do with those of its child
        signal.set_wakeup_fd(-1)
        # the parent hears of Ctrl-C, too, and passes it on
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            sent = pickle.dumps((True, action()))
        except BaseException as error:
            sent = pickle.dumps((False, portable(error, CosimError(f"{type(error).__name__}: {error}"))))
        _flush()
        sent += _END
        while sent:
            sent = sent[os.write(writing, sent) :]
        code = 0
    finally:
        os._exit(code)


def portable(error: BaseException, instead: BaseException) -> BaseException:
    """The error if it can go to another process, else the other one."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return instead
    return error
