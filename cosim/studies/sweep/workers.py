"""Processes that simulate shares of a sweep, here or on a Dask cluster."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import warnings
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.connection import Connection, wait
from threading import Lock
from typing import Any, Protocol, cast

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.studies.sweep.groups import Share
from flexfmu.cosim.studies.sweep.work import Job, Row

TRIALS = 2
"""How often a case is begun whose process ends, before it counts as failed."""


class Workers(Protocol):
    """Whatever simulates the shares of a job."""

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished."""
        ...


@dataclass(eq=False)
class _Process:
    """A process and its end of the pipe; the share that it works on."""

    process: Any
    pipe: Connection
    share: Share | None = None
    trial: int = 0


@dataclass
class LocalWorkers:
    """Processes of this machine, each of which gets a new share when it has finished one.

    If a process ends, of a slave's crash or because the system needs its memory, another one begins its share again; cases side
    by side are then simulated one by one. A case whose process ends twice counts as failed.

    Attributes:
        count: number of processes.
    """

    count: int
    _retries: list[tuple[Share, int]] = field(default_factory=list, init=False)

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished."""
        left, busy = iter(shares), dict[Connection, _Process]()
        idle: list[_Process] = []
        try:
            while True:
                # a share for every process that has none
                while len(busy) < self.count and (task := self._next(left)) is not None:
                    worker = idle.pop() if idle else _started(job)
                    worker.share, worker.trial = task
                    busy[worker.pipe] = worker
                    with contextlib.suppress(OSError):  # it has ended, which `wait` tells
                        worker.pipe.send(worker.share)
                if not busy:
                    return
                for pipe in wait([*busy]):
                    worker = busy.pop(cast(Connection, pipe))
                    try:
                        found = worker.pipe.recv()
                    except (EOFError, OSError):
                        yield self._lost(job, worker)
                        continue
                    idle.append(worker)
                    if isinstance(found, BaseException):
                        raise found
                    yield found
        finally:
            _end([*busy.values()], [*idle])

    def _next(self, left: Iterator[Share]) -> tuple[Share, int] | None:
        """The next share and which trial it is."""
        if self._retries:
            return self._retries.pop()
        share = next(left, None)
        return None if share is None else (share, 1)

    def _lost(self, job: Job, worker: _Process) -> list[Row]:
        """Rows of a case whose process has ended for the last time; before, its share is to be begun again."""
        worker.process.join()
        share, trial = worker.share, worker.trial
        assert share is not None
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


def _started(job: Job) -> _Process:
    """A new process."""
    here, there = multiprocessing.Pipe()
    process = multiprocessing.Process(target=_work, args=(job, there, here))
    with warnings.catch_warnings():
        # the new process uses none of this one's threads
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    there.close()
    return _Process(process, here)


def _work(job: Job, pipe: Connection, other: Connection) -> None:
    """Simulate shares until the pipe is closed. Ctrl-C is for the parent, which then ends its processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    other.close()
    # without the locks of a progress bar, and without warnings of every case
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    warnings.simplefilter("ignore")
    with contextlib.suppress(EOFError, OSError):
        while (share := pipe.recv()) is not None:
            found: Any
            try:
                found = job.rows(share)
            except Exception as error:
                found = error
            pipe.send(found)
    job.forget()


def _end(busy: Iterable[_Process], idle: Iterable[_Process]) -> None:
    """End processes: at once those that work, which happens after Ctrl-C and errors alone."""
    for worker in busy:
        worker.process.terminate()
    for worker in idle:
        with contextlib.suppress(OSError):
            worker.pipe.send(None)
    for worker in (*busy, *idle):
        worker.process.join()
        worker.pipe.close()


@dataclass
class DaskWorkers:
    """The workers of a Dask cluster, which begin shares of lost workers again themselves.

    Attributes:
        address: of the cluster's scheduler.
    """

    address: str

    def results(self, job: Job, shares: Iterable[Share]) -> Generator[list[Row], None, None]:
        """Yield the results of each share, in the order in which they are finished.

        Raises:
            InputError: Dask isn't installed, or there is no scheduler at the address.
        """
        try:
            from distributed import CancelledError, Client, as_completed
            from distributed.scheduler import KilledWorker
        except ImportError:
            raise InputError('a sweep on Dask needs its package: pip install "flexfmu[dask]"') from None
        try:
            client = Client(self.address, timeout="10s", set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"there is no Dask scheduler at {self.address}: {error}") from error
        with client:
            left = iter(shares)
            there = client.scatter(job, broadcast=True, hash=False)
            # a few shares for each thread are on their way
            ahead = 2 * max(1, sum(client.nthreads().values()))
            known: dict[str, Share] = {}

            def submit(share: Share) -> Any:
                future = client.submit(_rows, there, share, pure=False, retries=TRIALS)
                known[future.key] = share
                return future

            going = as_completed([submit(share) for share in islice(left, ahead)])
            for future in going:
                share = known.pop(future.key)
                try:
                    yield future.result()
                except CancelledError as error:
                    raise ResultsError(f"the Dask scheduler at {self.address} is gone: {error}") from error
                except KilledWorker:
                    # side by side no more, or failed
                    if len(share.numbers) == 1:
                        yield [job.failed(share.numbers[0], "the Dask workers that simulated it ended")]
                    for number in share.numbers if len(share.numbers) > 1 else ():
                        going.add(submit(Share(share.group, (number,))))
                following = next(left, None)
                if following is not None:
                    going.add(submit(following))


_one_at_a_time = Lock()


def _rows(job: Job, share: Share) -> list[Row]:
    """The results of a share, by a worker of Dask: one thread of it at a time, since they have the FMU in common."""
    with _one_at_a_time, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return job.rows(share)


def processors() -> int:
    """Number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
