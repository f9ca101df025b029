"""The recorder: what it holds, where, and for how long; a run keeps what it is asked to keep, and that unchanged."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.child_process import AVAILABLE, in_child
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.master import recorder as module
from flexfmu.cosim.engine.master.recorder import Recorder
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene

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


SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.02})


def assert_same_columns(found: Recording, all_of_it: Recording, order: int) -> None:
    """What was kept is to the last bit what is there without selection; higher derivatives are gone."""
    assert np.array_equal(found.time, all_of_it.time)
    for name, column in found.columns.items():
        full = all_of_it[name]
        kept = [column.values, column.first, column.second]
        expected = [full.values, full.first, full.second]
        for k, (mine, its) in enumerate(zip(kept, expected, strict=True)):
            if k <= order or name.startswith("end_effector.reference"):
                assert np.array_equal(mine, its), (name, k)
            else:
                assert mine is None, (name, k)


SOME = ["joint2.torque", "end_effector.position.x", "joint1.reference.velocity", "end_effector.reference.position.y"]


@pytest.mark.parametrize(("names", "order"), [(SOME, 0), (SOME, 1), (SOME, 2), (None, 0)])
def test_what_is_kept_is_unchanged(names: list[str] | None, order: int) -> None:
    """Some signals with some derivatives: the plant's, what feeds it, and the rigid motion; nothing else. Metrics, which
    are properties of the continuous solution, refuse values alone."""
    everything = PreparedScene(SCENE, communication_step=1e-3).run()
    found = PreparedScene(SCENE, communication_step=1e-3, record=Selection(names, order)).run()
    assert found.completed
    assert set(found.recording.columns) == set(names or everything.recording.columns)
    assert_same_columns(found.recording, everything.recording, order)
    if names is None:
        with pytest.raises(ResultsError, match="time derivatives"):
            measure_run(found)


def test_a_signal_that_does_not_exist() -> None:
    """The error names the nearest one, before anything is simulated."""
    with pytest.raises(InputError, match=r"'joint1.torqe'.*did you mean 'joint1.torque'"):
        PreparedScene(SCENE, record=Selection(["joint1.torqe"]))
    with pytest.raises(InputError, match=r"'nope' to record; there are: .*joint1.torque"):
        PreparedScene(SCENE, record=Selection(["nope"]))
    recording = PreparedScene(SCENE).run().recording
    with pytest.raises(KeyError, match=r"'joint1.torqe' was recorded; did you mean 'joint1.torque'"):
        recording["joint1.torqe"]
    with pytest.raises(KeyError, match=r"there are: .* and \d+ others") as caught:
        recording["nope"]
    assert len(str(caught.value)) < 200
    with pytest.raises(InputError, match="is empty"):
        PreparedScene(SCENE, record=Selection([]))


class Counter(PythonSlave):
    """Two outputs that count steps, and a note of which were read."""

    name = "counter"
    variables = (SlaveVariable("a", "output"), SlaveVariable("b", "output"))

    def __init__(self) -> None:
        super().__init__()
        self.read: set[int] = set()

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.memory[:] = 0.0

    def get(self, indices: Indices, values: RealArray) -> None:
        self.read |= set(indices.tolist())
        super().get(indices, values)

    def step(self, time: float, step: float) -> None:
        self.memory += 1.0


@pytest.mark.parametrize("compiled", [True, False])
def test_what_nobody_wants_is_not_read(compiled: bool) -> None:
    """An output that is neither recorded nor connected costs nothing, in C and in Python."""
    slave = Counter()
    found = simulate(connect([slave], []), 1.0, 0.1, compiled=compiled, record=Selection(["counter.b"]))
    assert slave.read == {1}
    assert list(found.recording.columns) == ["counter.b"]
    assert found.recording["counter.b"].values.tolist() == [*range(11)]
