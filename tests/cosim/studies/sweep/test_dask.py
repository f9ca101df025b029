"""A sweep on the workers of a Dask cluster, one of which is killed in the middle."""

from __future__ import annotations

import logging
import os
import signal
import warnings
from pathlib import Path
from threading import Timer
from typing import Any

import pytest

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.many import executor

SCENE = flexfmu.load_scene("barnard2012-6kg").replace(
    {"trajectory.duration": 0.2, "trajectory.dwell": 0.02, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-3}
)
CASES = {"trajectory.duration": "0.2:0.25:20", "payload.mass": [5.0, 6.0]}
METRICS = ["end_position_error"]

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]


@pytest.fixture(scope="module")
def distributed() -> Any:
    """Dask's package."""
    return pytest.importorskip("distributed")


def test_a_lost_worker_costs_nothing(distributed: Any, tmp_path: Path) -> None:
    """The same bytes as by own processes."""
    flexfmu.sweep(SCENE, CASES, metrics=METRICS, out=tmp_path / "here", processes=2)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        killed: list[int] = []

        def kill_one(fraction: float) -> None:
            if fraction > 0.3 and not killed:
                killed.append(pids[0])
                os.kill(pids[0], signal.SIGKILL)

        found = flexfmu.sweep(
            SCENE, CASES, metrics=METRICS, out=tmp_path / "there", dask=cluster.scheduler_address, progress=kill_one
        )
    assert killed
    assert not found.failed
    assert (tmp_path / "there" / "sweep.csv").read_bytes() == (tmp_path / "here" / "sweep.csv").read_bytes()


@pytest.mark.parametrize("small", [executor.SMALL, 0], ids=["small job", "large job"])
def test_workers_come_and_leave(distributed: Any, small: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """None is there at first; each that comes gets shares, and those that leave take nothing with them."""
    monkeypatch.setattr(executor, "INTERVAL", 0.0 if small else 0.01)
    monkeypatch.setattr(executor, "SMALL", small)
    flexfmu.sweep(SCENE, CASES, metrics=METRICS, out=tmp_path / "here", processes=1)
    cluster = distributed.LocalCluster(
        n_workers=0, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=logging.CRITICAL
    )
    in_flight, first = list[int](), set[str]()

    def scale(count: int) -> None:
        cluster.scale(count)
        cluster.sync(cluster._correct_state)
        with distributed.Client(cluster, set_as_default=False) as client:
            client.wait_for_workers(count)

    def come_and_leave(fraction: float) -> None:
        # one at first, four from a quarter on, then none of the first
        there = cluster.scheduler.workers
        in_flight.append(
            sum(each.state in ("processing", "no-worker", "queued") for each in cluster.scheduler.tasks.values())
        )
        if 0.2 < fraction < 0.3 and len(there) == 1:
            first.update(there)
            scale(4)
        if fraction > 0.6 and first & set(there):
            cluster.sync(cluster.scheduler.retire_workers, workers=[*first], close_workers=True, remove=True)

    with cluster:
        joining = Timer(0.5, scale, [1])
        joining.start()
        found = flexfmu.sweep(
            SCENE,
            CASES,
            metrics=METRICS,
            out=tmp_path / "there",
            dask=cluster.scheduler_address,
            progress=come_and_leave,
        )
        joining.join()
    assert not found.failed
    assert max(in_flight) > 4
    assert (tmp_path / "there" / "sweep.csv").read_bytes() == (tmp_path / "here" / "sweep.csv").read_bytes()


def test_no_scheduler_is_an_error(distributed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line within seconds."""
    monkeypatch.setattr(executor, "PATIENCE", "1s")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError, match="no Dask scheduler at"):
            flexfmu.sweep(SCENE, CASES, metrics=METRICS, dask="tcp://127.0.0.1:9")
