"""One thread of BLAS around work on small matrices.

OpenBLAS, MKL and BLIS share a product, or an eigenvalue problem, of some 50 rows out to all processors, where their threads spin while
they wait for each other: that takes several times the processor time of one thread, and more where processors have other work.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any

_limited = Lock()
"""Is held while BLAS is limited."""


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread; also a decorator.

    The limit is the process's: a call within another one, or beside it in another thread, changes nothing, so that the number of
    threads before is there again when the first one ends.
    """
    if not _limited.acquire(blocking=False):
        yield
        return
    try:
        with _limit():
            yield
    finally:
        _limited.release()


def keep_one_blas_thread() -> None:
    """Limit BLAS to one thread for the rest of the process, for those that share work with other processes."""
    if _limited.acquire(blocking=False):
        _limit()


def _limit() -> Any:
    import scipy.linalg  # noqa: F401 - a limit holds for libraries that are loaded, and SciPy has a BLAS of its own
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1, user_api="blas")
