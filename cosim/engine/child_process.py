"""Calls a function in a forked child process, so that code that crashes, exits or hangs can't end the program.

The child starts with a copy of all objects of the parent; nothing is loaded again. Its changes don't reach the parent.

Between the two stands a guard, which ends what the child's code has started; see `flexfmu.fmu_build.guard`.
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
from flexfmu.fmu_build.guard import AVAILABLE, GUARDED, guarded

__all__ = ["AVAILABLE", "CALL_LIMIT", "ChildLostError", "in_child", "portable"]

CALL_LIMIT = 60.0
"""Default limit for the duration of one call of a slave [s]."""

GRACE = 2.0
"""Time that a child may take to end after the user interrupts [s]."""

LOOK = 0.05
"""Interval at which the parent checks the child [s]."""

_END = b"complete"
"""Mark at the end of the data that a child sends."""


class ChildLostError(CosimError):
    """A child process ended, or was ended, without a result; the message says how.

    In the message, "it" is the slave that the child called.
    """


def in_child(action: Callable[[], Any], look: Callable[[], object], limit: float) -> Any:
    """Run an action in a child process and return its result.

    If the user interrupts, the action gets a `KeyboardInterrupt`, as it would in this process.

    Args:
        action: function to call; its result must be picklable.
        look: called every `LOOK` seconds while the child works; a changed result shows that the child makes progress.
        limit: longest time without progress [s].

    Raises:
        ChildLostError: the child ended without a result, or made no progress for longer than the limit.
        KeyboardInterrupt: the user interrupted, and the child sent no result within `GRACE`.
        BaseException: the exception that the action raised.
    """
    reading, writing = os.pipe()
    # block interrupts until the child has set up its signal handlers
    before = signal.pthread_sigmask(signal.SIG_BLOCK, GUARDED)
    try:
        parent, forked = os.getpid(), _fork()
        if forked == 0:
            _be_child(action, writing, parent)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    # receive the result, and end the child in any case
    os.close(writing)
    supervisor = _Supervisor(forked, reading, look, limit)
    try:
        returned, result = pickle.loads(supervisor.received())
    finally:
        supervisor.close()
    if not returned:
        raise result
    return result


class _Supervisor:
    """Receives the result of a child, and has its guard end it if it makes no progress."""

    def __init__(self, process: int, reading: int, look: Callable[[], object], limit: float) -> None:
        self._guard, self._reading, self._look, self._limit = process, reading, look, limit
        self._status: int | None = None

    def received(self) -> bytes:
        """Return the data that the child sends, with the mark at its end."""
        data = bytearray()
        try:
            self._wait(data)
        except KeyboardInterrupt:
            # the child may still send its result; a second interrupt ends the wait
            os.kill(self._guard, signal.SIGTERM)
            self._limit, self._look = GRACE, lambda: None
            try:
                self._wait(data)
            except ChildLostError:
                raise KeyboardInterrupt from None
        if data[-len(_END) :] != _END:
            raise ChildLostError(self._how())
        return bytes(data)

    def _wait(self, data: bytearray) -> None:
        """Append what the child sends to ``data``, until it closes the pipe or has ended."""
        poll = select.poll()
        poll.register(self._reading, select.POLLIN)
        seen, idle, last = self._look(), 0.0, monotonic()
        while True:
            # read while there is data
            if poll.poll(1e3 * LOOK):
                if not (chunk := os.read(self._reading, 1 << 16)):
                    return
                data += chunk
                continue
            if self._gone():
                return  # another process keeps the other end of the pipe open
            # time during which this process was suspended, too, doesn't count
            now, at = monotonic(), self._look()
            idle = 0.0 if at != seen else idle + min(now - last, 2.0 * LOOK)
            seen, last = at, now
            if idle > self._limit:
                raise ChildLostError(
                    f"it hasn't returned for {self._limit:g} s (`call_limit` is longer if it needs more)"
                )

    def _gone(self) -> bool:
        """Return whether the child has ended."""
        if self._status is None and os.waitid(os.P_PID, self._guard, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            self._end()
        return self._status is not None

    def _how(self) -> str:
        """Return how the child, which has closed the pipe, ended without a result."""
        # after closing the pipe the child may need a moment to end
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
        """Close the pipe, and have the child killed if it is still running."""
        os.close(self._reading)
        if not self._gone():
            self._end()

    def _end(self) -> None:
        """End the guard, and with it all that the child has started; keep the status."""
        os.kill(self._guard, signal.SIGHUP)
        self._status = os.waitpid(self._guard, 0)[1]


def _flush() -> None:
    """Flush the output buffers of Python and C; otherwise the child would write their content again."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):  # no stream, a closed one, or a broken pipe
            stream.flush()
    ctypes.CDLL(None).fflush(None)


def _fork() -> int:
    """Fork; return 0 in the child, and the child's process ID in the parent."""
    _flush()
    with warnings.catch_warnings():
        # Python warns of other threads (numerical libraries, progress bar); the child uses none of them
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _be_child(action: Callable[[], Any], writing: int, parent: int) -> Never:
    """Run the action in a child of this process, its guard; send its result or exception, and exit without the parent's clean-up."""
    code = 1
    try:
        guarded(parent)
        # keep the garbage collector off the parent's objects: it would copy their memory pages
        gc.freeze()
        # slaves print to standard error: standard output is for results
        with suppress(OSError):
            os.dup2(2, 1)
        sys.stdout = sys.stderr
        # bypass the progress bar, whose thread doesn't exist in the child
        sys.stdout, sys.stderr = (getattr(each, "rich_proxied_file", each) for each in (sys.stdout, sys.stderr))
        # signals of the child must not reach the parent's event loop
        signal.set_wakeup_fd(-1)
        # the parent passes Ctrl-C on as SIGTERM
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, GUARDED)
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
    """Return the error if it can be pickled, else ``instead``."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return instead
    return error
