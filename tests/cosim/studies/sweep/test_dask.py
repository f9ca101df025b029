"""A sweep on the workers of a Dask cluster, one of which is killed in the middle."""

from __future__ import annotations

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


@pytest.mark.parametrize("small", [executor.SMALL, 0], ids=["small job", "large job"])
def test_workers_come_and_one_is_lost(
    distributed: Any, small: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None is there at first, four come, and one is killed with its shares: the same bytes as by own processes."""
    flexfmu.sweep(SCENE, CASES, metrics=METRICS, out=tmp_path / "here", processes=2)
    monkeypatch.setattr(executor, "INTERVAL", 0.0 if small else 0.01)
    monkeypatch.setattr(executor, "SMALL", small)
    rooms, killed, room = list[int](), list[int](), executor.DaskWorkers.room
    monkeypatch.setattr(executor.DaskWorkers, "room", lambda self: rooms.append(room(self)) or rooms[-1])
    with distributed.LocalCluster(n_workers=0, threads_per_worker=1, dashboard_address=None) as cluster:

        def kill_one(fraction: float) -> None:
            if fraction > 0.0 and not killed:
                # on a slow machine they could come after the last case
                cluster.wait_for_workers(4, timeout=60)
            if fraction > 0.3 and not killed and cluster.workers:
                killed.append(next(iter(cluster.workers.values())).pid)
                os.kill(killed[0], signal.SIGKILL)

        joining = Timer(0.5, cluster.scale, [4])
        joining.start()
        address = cluster.scheduler_address
        found = flexfmu.sweep(SCENE, CASES, metrics=METRICS, out=tmp_path / "there", dask=address, progress=kill_one)
        joining.join()
    assert killed
    assert rooms[0] == 1
    assert max(rooms) == 8
    assert not found.failed
    assert (tmp_path / "there" / "sweep.csv").read_bytes() == (tmp_path / "here" / "sweep.csv").read_bytes()


def test_no_scheduler_is_an_error(distributed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line within seconds."""
    monkeypatch.setattr(executor, "PATIENCE", "1s")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(InputError, match="no Dask scheduler at"):
            flexfmu.sweep(SCENE, CASES, metrics=METRICS, dask="tcp://127.0.0.1:9")
