"""The recorder: what it holds, where, and for how long."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.child_process import AVAILABLE, in_child
from flexfmu.cosim.engine.master import recorder as module
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.slave import SlaveVariable

COUNT = 3000


def make_port() -> Any:
    """A port with values and a derivative."""
    variables = (SlaveVariable("y", "output", "m"), SlaveVariable("z", "output"))
    slave = SimpleNamespace(name="source", variables=variables)
    return SimpleNamespace(slave=slave, recorded=2, indices=np.arange(2), signals=np.zeros((3, 2)))


def fill(port: Any, recorder: Recorder, count: int = COUNT, offset: float = 0.0) -> None:
    """Record instants 0, 1, 2, .. with known signals."""
    for n in range(count):
        port.signals[:] = [[n + offset, -n], [2 * n, 3 * n], [np.nan, np.nan]]
        recorder.append(float(n))


def check(recorder: Recorder, count: int = COUNT, offset: float = 0.0) -> None:
    """Compare with what `fill` records."""
    recording, n = recorder.recording(), np.arange(count)
    assert np.array_equal(recording.time, n)
    y, z = recording["source.y"], recording["source.z"]
    assert y.unit == "m"
    assert np.array_equal(y.values, n + offset)
    for found, expected in ((y.first, 2 * n), (z.values, -n), (z.first, 3 * n)):
        assert found is not None
        assert np.array_equal(found, expected)
    assert y.second is None


@pytest.fixture(params=["memory", "file", "shared", "shared file"])
def recorder_of(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any, int], Recorder]:
    """Makes recorders with each kind of memory."""
    if "file" in request.param:
        monkeypatch.setattr(module, "LARGE", 1)
        monkeypatch.setattr(module, "RELEASED", 700)
    if "shared" in request.param and not AVAILABLE:
        pytest.skip("needs Linux")
    return lambda port, capacity: Recorder([port], capacity, shared="shared" in request.param)


@pytest.mark.parametrize("capacity", [1, 100, COUNT, 2 * COUNT])
def test_what_is_appended_is_recorded(recorder_of: Callable[[Any, int], Recorder], capacity: int) -> None:
    """Whatever the expected number of instants, also after some have been deleted."""
    port = make_port()
    recorder = recorder_of(port, capacity)
    fill(port, recorder)
    recorder.rewind(COUNT // 5)
    for n in range(COUNT // 5, COUNT):
        port.signals[:] = [[n, -n], [2 * n, 3 * n], [0.0, 0.0]]
        recorder.append(float(n))
    assert recorder.last == COUNT - 1
    check(recorder)


def test_a_recording_survives_the_next_run(recorder_of: Callable[[Any, int], Recorder]) -> None:
    """The next run has memory of its own, be it that a part of an array is kept."""
    port = make_port()
    recorder = recorder_of(port, COUNT)
    fill(port, recorder)
    kept = recorder.recording()["source.y"].values[2:]
    recorder.rewind(0)
    assert recorder.count == 0
    fill(port, recorder, offset=0.5)
    check(recorder, offset=0.5)
    assert np.array_equal(kept, np.arange(2.0, COUNT))


def test_results_are_the_recorders_memory() -> None:
    """Nothing is copied where the number of instants is known, and little is held beyond what is recorded."""
    port = make_port()
    recorder = Recorder([port], COUNT)
    fill(port, recorder)
    recording = recorder.recording()
    (_, columns), *_ = recorder.blocks
    assert np.shares_memory(recording["source.y"].values, columns)
    held: Any = columns.base
    assert held.nbytes < 1.02 * 5 * 8 * COUNT


def test_only_what_is_kept_takes_memory() -> None:
    """Of a port that is read as a whole, with the same numbers."""
    port = make_port()
    recorder = Recorder([port], COUNT, keeps=lambda name: name == "source.z")
    fill(port, recorder)
    recording = recorder.recording()
    assert [*recording.columns] == ["source.z"]
    z = recording["source.z"]
    assert np.array_equal(z.values, -np.arange(COUNT))
    assert z.first is not None
    assert np.array_equal(z.first, 3 * np.arange(COUNT))
    assert recorder.values == 2 * COUNT


@pytest.mark.skipif(not AVAILABLE, reason="needs Linux")
@pytest.mark.parametrize("large", [False, True])
def test_a_child_records_for_its_parent(large: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also beyond the memory that was there when the child began."""
    monkeypatch.setattr(module, "LARGE", 1 if large else module.LARGE)
    port = make_port()
    recorder = Recorder([port], 100, shared=True)
    in_child(lambda: fill(port, recorder), lambda: None, 60.0)
    assert recorder.catch_up() == COUNT
    check(recorder)
