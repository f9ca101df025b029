"""Processes that simulate shares of a sweep, here or on a Dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import warnings
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from math import inf
from multiprocessing.connection import Connection, wait
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from threading import Lock
from time import monotonic
from typing import Any, Protocol, cast

from flexfmu.cosim.engine.errors import InputError, ResultsError, extra
from flexfmu.cosim.studies.sweep.groups import Share
from flexfmu.cosim.studies.sweep.work import Job, Row

AHEAD, MOST_AHEAD = 0.05, 8
"""How long the shares take that a process gets at once [s], and the largest number of them."""

PATIENCE = "10s"
"""How long a Dask scheduler may take to answer."""

INTERVAL = 1.0
"""How often a Dask scheduler is asked for workers that have come or gone [s]."""

SMALL = 1_000_000
"""Bytes of a job that is sent with every share."""

TRIALS = 2
"""How often a case is begun whose process ends, before it counts as failed."""


class Workers(Protocol):
    """Whatever simulates the shares of a job."""

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished."""
        ...


@dataclass(eq=False)
class _Process:
    """A process and its end of the pipe; the shares that it works on, each with the number of the trial, and since when."""

    process: Any
    pipe: Connection
    tasks: deque[tuple[Share, int]] = field(default_factory=deque)
    since: float = 0.0

    def begin(self, tasks: Iterable[tuple[Share, int]]) -> None:
        """Send shares."""
        self.tasks.extend(tasks)
        self.since = monotonic()
        with contextlib.suppress(OSError):  # it has ended, which its pipe tells next
            self.pipe.send([share for share, _ in self.tasks])


@dataclass
class LocalWorkers:
    """Processes of this machine, each of which gets new shares when it has finished its own: several at once where these are quick.

    If a process ends, of a slave's crash or because the system needs its memory, another one begins its share again; cases side
    by side are then simulated one by one. A case whose process ends twice counts as failed.

    Attributes:
        count: number of processes.
    """

    count: int
    _retries: list[tuple[Share, int]] = field(default_factory=list, init=False)
    _ahead: int = field(default=1, init=False)

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished."""
        left, workers, idle = iter(shares), list[_Process](), list[_Process]()
        # what processes unpack is removed at the end, also if they are killed
        with TemporaryDirectory(prefix="flexfmu-sweep-", ignore_cleanup_errors=True) as unpacked:
            try:
                yield from self._results(job, left, workers, idle, unpacked)
            finally:
                _end(workers, idle)

    def _results(
        self, job: Job, left: Iterator[Share], workers: list[_Process], idle: list[_Process], unpacked: str
    ) -> Iterator[list[Row]]:
        """Yield the results; ``workers`` are all processes, ``idle`` those without work."""
        while True:
            # shares for every process that has none
            while (idle or len(workers) < self.count) and (tasks := self._next(left)):
                if not idle:
                    workers.append(_started(job, unpacked))
                (idle.pop() if idle else workers[-1]).begin(tasks)
            if len(idle) == len(workers):
                return
            busy = {worker.pipe: worker for worker in workers}
            for pipe in wait([*busy]):
                worker = busy[cast(Connection, pipe)]
                try:
                    found = worker.pipe.recv()
                except (EOFError, OSError):
                    workers.remove(worker)
                    idle[:] = [each for each in idle if each is not worker]
                    yield self._lost(job, worker)
                    continue
                if isinstance(found, BaseException):
                    raise found
                self._finished(worker, idle)
                yield found

    def _next(self, left: Iterator[Share]) -> list[tuple[Share, int]]:
        """The next shares, each with the number of the trial; those that a process has lost alone."""
        if self._retries:
            return [self._retries.pop()]
        return [(share, 1) for share in islice(left, self._ahead)]

    def _finished(self, worker: _Process, idle: list[_Process]) -> None:
        """A process has finished a share. Results are sent one by one, but quick shares several at once."""
        now = monotonic()
        self._ahead = max(1, min(MOST_AHEAD, int(AHEAD / max(now - worker.since, 1e-6))))
        worker.since = now
        worker.tasks.popleft()
        if not worker.tasks:
            idle.append(worker)

    def _lost(self, job: Job, worker: _Process) -> list[Row]:
        """Rows of a case whose process has ended for the last time; before, its share is to be begun again."""
        worker.process.join()
        worker.pipe.close()
        if not worker.tasks:
            return []
        # those behind it have not begun
        (share, trial), *others = worker.tasks
        self._retries += others
        if trial < TRIALS:
            self._retries.append((share, trial + 1))
        elif len(share.numbers) > 1:
            self._retries += [(Share(share.group, (number,)), 1) for number in reversed(share.numbers)]
        else:
            return [job.failed(share.numbers[0], _cause(worker.process.exitcode))]
        return []


def _cause(code: int | None) -> str:
    """Why a process has ended."""
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return f"the process that simulated it ended with {signal.Signals(-code).name}"
    return f"the process that simulated it ended with status {code}"


def _started(job: Job, unpacked: str) -> _Process:
    """A new process."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.Process(target=_work, args=(job, there, here, unpacked))
    with warnings.catch_warnings():
        # the new process uses none of this one's threads
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    there.close()
    return _Process(process, here)


def _work(job: Job, pipe: Connection, other: Connection, unpacked: str) -> None:
    """Simulate shares until the pipe is closed. Ctrl-C is for the parent, which then ends its processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    other.close()
    tempfile.tempdir = unpacked
    # without the locks of a progress bar, and without warnings of every case
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    warnings.simplefilter("ignore")
    with contextlib.suppress(EOFError, OSError):
        while (shares := pipe.recv()) is not None:
            for share in shares:
                found: Any
                try:
                    found = job.rows(share)
                except Exception as error:
                    found = error
                pipe.send(found)
    job.forget()


def _end(workers: Iterable[_Process], idle: Iterable[_Process]) -> None:
    """End processes: at once those that work, which happens after Ctrl-C and errors alone."""
    for worker in workers:
        if worker in idle:
            with contextlib.suppress(OSError):
                worker.pipe.send(None)
        else:
            worker.process.terminate()
    for worker in workers:
        worker.process.join()
        worker.pipe.close()


@dataclass
class DaskWorkers:
    """The workers of a Dask cluster, also those that come later; shares of workers that leave, the cluster begins again itself.

    Attributes:
        address: of the cluster's scheduler.
    """

    address: str

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished.

        Raises:
            InputError: Dask isn't installed, or there is no scheduler at the address.
        """
        with extra("dask"):
            from distributed import CancelledError, Client
            from distributed.scheduler import KilledWorker
        try:
            client = Client(self.address, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"there is no Dask scheduler at {self.address}: {error}") from error
        with client:
            left, waiting = iter(shares), deque[Share]()
            # a small job travels with each share; a larger one is a task, which any worker repeats if those that have it leave
            text = pickle.dumps(job)
            there = text if len(text) < SMALL else client.submit(bytes, text, pure=False)
            going, finished = dict[str, tuple[Any, Share]](), SimpleQueue[Any]()
            asked, threads = -inf, 0
            try:
                while True:
                    # a few shares for each thread of the workers that are there now
                    if monotonic() - asked > INTERVAL:
                        asked = monotonic()
                        with contextlib.suppress(OSError):  # it is gone, which shares on their way tell
                            threads = sum(client.nthreads().values())
                    while len(going) < max(1, 2 * threads):
                        share = waiting.popleft() if waiting else next(left, None)
                        if share is None:
                            break
                        future = client.submit(_rows, there, share, pure=False, retries=TRIALS)
                        going[future.key] = future, share
                        future.add_done_callback(finished.put)
                    if not going:
                        return
                    with contextlib.suppress(Empty):
                        future, share = going.pop(finished.get(timeout=INTERVAL).key)
                        try:
                            yield future.result()
                        except KilledWorker:
                            # side by side no more, or failed
                            if len(share.numbers) == 1:
                                yield [job.failed(share.numbers[0], "the Dask workers that simulated it ended")]
                            else:
                                waiting.extend(Share(share.group, (number,)) for number in share.numbers)
            except CancelledError as error:
                raise ResultsError(f"the Dask scheduler at {self.address} is gone: {error}") from error


_one_at_a_time = Lock()


@lru_cache(maxsize=1)
def _loaded(text: bytes) -> Job:
    """The job that this process works on, with its FMU."""
    job: Job = pickle.loads(text)
    return job


def _rows(text: bytes, share: Share) -> list[Row]:
    """The results of a share, by a worker of Dask: one thread of it at a time, since they have the FMU in common."""
    with _one_at_a_time, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _loaded(text).rows(share)


def processors() -> int:
    """Number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
