"""A run keeps what it is asked to keep, and that unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import Recording, Selection
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metrics import measure_run
from flexfmu.model.scene.file import load_scene

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
