"""Work on small matrices takes the processor time of one thread, whatever the variables of BLAS say."""

from __future__ import annotations

import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

import flexfmu
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.model.one_thread import keep_one_blas_thread, one_blas_thread

OTHERS = 0.05
"""Share of the processor time that other threads than the caller's may take."""


def _processor_times() -> tuple[float, float]:
    """What margins of a loop take of this process and of its calling thread [s], while BLAS has two threads."""
    controller = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}
    loop = flexfmu.load_scene("barnard2012-6kg").replace(
        {"cosimulation.drive": "torque", "effects.motor_inertia": 0.1, "controller": [controller]}
    )
    with threadpool_limits(2, user_api="blas"):
        # threads of BLAS go on for some time after they had work
        time.sleep(1.0)
        whole, own = time.process_time(), time.thread_time()
        scene_margins(loop, poses=1)
        return time.process_time() - whole, time.thread_time() - own


def _threads() -> set[int]:
    """Numbers of threads of all BLAS libraries."""
    return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}


@pytest.fixture
def two_threads() -> Any:
    """BLAS with two threads, as on any machine where no variable says otherwise."""
    with threadpool_limits(2, user_api="blas"):
        if _threads() != {2}:
            pytest.skip("no ELF library of BLAS here has threads")
        yield


@pytest.mark.slow
def test_no_processor_time_of_other_threads(two_threads: None) -> None:
    """A process takes the time of the calling thread; those of BLAS would add a fifth of it or more, and half on a busy machine."""
    # a new process, without threads that other tests have left
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        whole, own = pool.submit(_processor_times).result()
    assert whole - own < OTHERS * own, (whole, own)


def test_the_number_before_comes_back(two_threads: None) -> None:
    """After nested limits, and after an error."""

    @one_blas_thread()
    def inner() -> set[int]:
        return _threads()

    with one_blas_thread():
        assert inner() == {1}
        assert _threads() == {1}
    assert _threads() == {2}
    with pytest.raises(np.linalg.LinAlgError), one_blas_thread():
        scipy.linalg.cholesky(-np.eye(2))
    assert _threads() == {2}


def test_two_callers_at_once(two_threads: None) -> None:
    """Whoever ends last, the caller here, gives the number before back."""
    begun, finish = Event(), Event()

    def other() -> None:
        with one_blas_thread():
            begun.set()
            finish.wait(10.0)

    thread = Thread(target=other)
    with one_blas_thread():
        thread.start()
        assert begun.wait(10.0)
        finish.set()
        thread.join()
        assert _threads() == {1}
    assert _threads() == {2}


@pytest.mark.slow
def test_processes_of_their_own_keep_one_thread() -> None:
    """Also those that begin anew instead of as a copy of this one."""
    with ProcessPoolExecutor(1, get_context("spawn"), initializer=keep_one_blas_thread) as pool:
        assert pool.submit(_threads).result() == {1}
