"""Runs many items of work, whatever they are: by processes of this machine, or by the workers of a Dask cluster.

`finished` keeps an executor busy and yields results in the order in which they come; `mapping` gives them in the order of the items.
Several items of work that is quick travel together. Where a process ends, of a crash or because the system needs its memory, another
one takes its place and its items are begun again one by one; what ends its process twice has failed, in parts if it has some.
"""

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
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from itertools import islice
from math import inf
from multiprocessing.connection import Connection, wait
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from time import monotonic
from typing import Any, Generic, TypeVar

from flexfmu.cosim.engine.errors import InputError, ResultsError, extra
from flexfmu.fmu_build.temporary import temporary_folder
from flexfmu.model.one_thread import keep_one_blas_thread

S = TypeVar("S")
T = TypeVar("T")

AHEAD, MOST_AHEAD = 0.05, 8
"""How long the items take that a process gets at once [s], and the largest number of them."""

PATIENCE = "10s"
"""How long a Dask scheduler may take to answer."""

INTERVAL = 1.0
"""How often a Dask scheduler is asked for workers that have come or gone [s]."""

SMALL = 1_000_000
"""Bytes of work that is sent with every item."""

TRIALS = 2
"""How often an item is begun whose process ends, before it counts as failed."""


class LostError(ResultsError):
    """The process that worked on an item has ended."""


def finished(
    executor: Executor[S, T], items: Iterable[S], parts: Callable[[S], Sequence[S]], failed: Callable[[S, str], T]
) -> Generator[T, None, None]:
    """Yield the result of each item, in the order in which they come.

    Args:
        executor: is left at the end.
        items: of work.
        parts: an item → what it may be split into when its process has ended.
        failed: an item that can't be split, and why its process has ended → its result.

    Raises:
        InputError, ResultsError: as the executor and its work do.
    """
    left, again = iter(items), deque[tuple[S, int]]()
    going, done, ahead = dict[Any, tuple[list[S], int]](), SimpleQueue[Any](), 1
    with executor:
        while True:
            room = executor.room()
            while len(going) < room:
                # those that a process has lost alone
                some, trial = ([again[0][0]], again.popleft()[1]) if again else ([*islice(left, ahead)], 1)
                if not some:
                    break
                future = executor.submit(some)
                going[future] = some, trial
                future.add_done_callback(done.put)
            if not going:
                return
            try:
                future = done.get(timeout=INTERVAL)
            except Empty:
                continue
            some, trial = going.pop(future)
            try:
                results, seconds = future.result()
            except executor.lost as error:
                if len(some) > 1:
                    again += [(item, 1) for item in some]
                elif trial < executor.trials:
                    again.append((some[0], trial + 1))
                elif len(several := parts(some[0])) > 1:
                    again += [(part, 1) for part in several]
                else:
                    is_here = isinstance(error, LostError)
                    yield failed(some[0], str(error) if is_here else "the Dask workers that simulated it ended")
                continue
            ahead = max(1, min(executor.most, int(AHEAD * len(some) / max(seconds, 1e-6))))
            yield from results


@contextlib.contextmanager
def mapping(work: Callable[[S], T], count: int) -> Iterator[Callable[[Iterable[S]], Iterator[T]]]:
    """A context with a function that yields the results of items in their order: by processes, or by this one alone.

    Results raise `ResultsError` where a process has ended. When the context is left it waits for those that work, whose processor
    time counts, or ends them after an error.
    """
    if count == 1:
        yield lambda items: map(work, items)
        return
    with Processes(partial(_on_one_thread, work), count) as executor:

        def mapped(items: Iterable[S]) -> Iterator[T]:
            return results([executor.submit([item]) for item in items])

        def results(futures: Iterable[Any]) -> Iterator[T]:
            try:
                for future in futures:
                    yield future.result()[0][0]
            except LostError:
                message = "a process ended before its work was done, for lack of memory for example"
                raise ResultsError(message) from None

        yield mapped


def _on_one_thread(work: Callable[[S], T], item: S) -> T:
    """The result of an item, beside processes that work on others."""
    keep_one_blas_thread()
    return work(item)


class Processes(Generic[S, T]):
    """Processes of this machine, each of which calls ``work``; they begin when there are items for them.

    Args:
        work: the result of an item.
        count: number of processes.
        leave: what a process does at its end.

    Attributes:
        trials: how often an item is begun before it counts as failed.
        most: largest number of items that travel together.
        lost: raised by a future whose process has ended.
    """

    trials, most = TRIALS, MOST_AHEAD
    lost: type[Exception] = LostError

    def __init__(self, work: Callable[[S], T], count: int, leave: Callable[[], object] = lambda: None) -> None:
        self._work, self._count, self._leave = work, count, leave
        self._all, self._idle = list[tuple[Any, Connection]](), SimpleQueue[tuple[Any, Connection]]()
        self._starting, self._is_over = Lock(), False

    def __enter__(self) -> Processes[S, T]:
        # what processes unpack is removed at the end, also if they are killed
        self._unpacked = temporary_folder("many")
        # a thread for each process waits for its results
        self._threads = ThreadPoolExecutor(self._count)
        return self

    def room(self) -> int:
        """One call of `submit` for each process, and one that it begins next."""
        return 2 * self._count

    def submit(self, items: Sequence[S]) -> Any:
        """The future of the items' results and of their time [s]."""
        if len(self._all) < self._count:
            self._start()
        return self._threads.submit(self._results, items)

    def _start(self) -> None:
        """Begin a process, one at a time: none has the other one's end of its pipe."""
        with self._starting, warnings.catch_warnings():
            if self._is_over:
                return
            # the new process uses none of this one's threads
            warnings.simplefilter("ignore", DeprecationWarning)
            here, there = multiprocessing.Pipe()
            arguments = self._work, there, here, self._unpacked.name, self._leave
            process = multiprocessing.Process(target=_serve, args=arguments)
            process.start()
            there.close()
            self._all.append((process, here))
            self._idle.put((process, here))

    def _results(self, items: Sequence[S]) -> tuple[list[T], float]:
        process, pipe = self._idle.get()
        try:
            pipe.send(items)
            found = pipe.recv()
        except (EOFError, OSError):
            process.join()
            self._start()
            code = process.exitcode or 0
            cause = signal.Signals(-code).name if -code in {*signal.Signals} else f"status {code}"
            raise LostError(f"the process that simulated it ended with {cause}") from None
        self._idle.put((process, pipe))
        if isinstance(found, BaseException):
            raise found
        return found  # type: ignore[no-any-return]

    def __exit__(self, kind: type[BaseException] | None, *others: object) -> None:
        """End the processes: after Ctrl-C and errors at once, otherwise those that work when they have a result."""
        self._threads.shutdown(wait=kind is None, cancel_futures=True)
        with self._starting:
            self._is_over = True
        idle = list[Any]()
        with contextlib.suppress(Empty):
            while True:
                idle.append(self._idle.get_nowait())
        for process, pipe in self._all:
            if (process, pipe) in idle:
                with contextlib.suppress(OSError):
                    pipe.send(None)
            else:
                process.terminate()
        # a thread that waits for a process has what it waits for
        for process, _ in self._all:
            process.join()
        self._threads.shutdown()
        for _, pipe in self._all:
            pipe.close()
        self._unpacked.cleanup()


def _serve(
    work: Callable[[S], T], pipe: Connection, other: Connection, unpacked: str, leave: Callable[[], object]
) -> None:
    """Work on items until the pipe is closed. What a terminal sends is for the parent, which then ends its processes."""
    for name in {"SIGINT", "SIGHUP", "SIGQUIT"} & set(dir(signal)):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    Thread(target=_end_with_parent, daemon=True).start()
    other.close()
    tempfile.tempdir = unpacked
    # without the locks of a progress bar, and without warnings of every item
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    warnings.simplefilter("ignore")
    with contextlib.suppress(EOFError, OSError):
        while (items := pipe.recv()) is not None:
            found: Any
            try:
                found = _timed(work, items)
            except Exception as error:
                found = error
            pipe.send(found)
    leave()


def _end_with_parent() -> None:
    """End this process when its parent has ended, however long its work would take: nobody waits for the result."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _timed(work: Callable[[S], T], items: Sequence[S]) -> tuple[list[T], float]:
    """The results of items, and their time [s]."""
    begin = monotonic()
    return [work(item) for item in items], monotonic() - begin


class DaskWorkers(Generic[S, T]):
    """The workers of a Dask cluster, also those that come later; items of workers that leave, the cluster begins again itself.

    Args:
        work: the result of an item; can be pickled.
        address: of the cluster's scheduler.

    Attributes:
        trials, most, lost: as of `Processes`.

    Raises:
        InputError: Dask isn't installed, or there is no scheduler at the address.
    """

    trials, most = 1, 1
    lost: type[Exception]

    def __init__(self, work: Callable[[S], T], address: str) -> None:
        with extra("dask"):
            from distributed import Client
            from distributed.scheduler import KilledWorker
        try:
            self._client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise InputError(f"there is no Dask scheduler at {address}: {error}") from error
        self.lost = KilledWorker
        self._address, self._asked, self._threads = address, -inf, 0
        # little work travels with each item; much is a task, which any worker repeats if those that have it leave
        text = pickle.dumps(work)
        self._there = text if len(text) < SMALL else self._client.submit(bytes, text, pure=False)

    def __enter__(self) -> DaskWorkers[S, T]:
        return self

    def room(self) -> int:
        """A few items for each thread of the workers that are there now."""
        if monotonic() - self._asked > INTERVAL:
            self._asked = monotonic()
            with contextlib.suppress(OSError):  # it is gone, which items on their way tell
                self._threads = sum(self._client.nthreads().values())
        return max(1, 2 * self._threads)

    def submit(self, items: Sequence[S]) -> Any:
        """The future of the items' results and of their time [s]."""
        return self._client.submit(_by_dask, self._there, items, pure=False, retries=TRIALS)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, *others: object) -> None:
        from distributed import CancelledError

        self._client.close()
        if isinstance(error, CancelledError):
            raise ResultsError(f"the Dask scheduler at {self._address} is gone: {error}") from error


_one_at_a_time = Lock()


@lru_cache(maxsize=1)
def _loaded(text: bytes) -> Callable[[Any], Any]:
    """What this process works on, with its FMU."""
    work: Callable[[Any], Any] = pickle.loads(text)
    return work


def _by_dask(text: bytes, items: Sequence[Any]) -> tuple[list[Any], float]:
    """The results of items, by a worker of Dask: one thread of it at a time, since they have the FMU in common."""
    with _one_at_a_time, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _timed(_loaded(text), items)


Executor = Processes[S, T] | DaskWorkers[S, T]
"""Whatever works on items."""


def processors() -> int:
    """Number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:
        return os.cpu_count() or 1
