"""What is too large to record is refused before the run, with the likely mistake; its size is estimated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import flexfmu
from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.experiment.run_checks import LARGEST_SIZE, recorded_bytes
from flexfmu.cosim.experiment.scene_loop import Loop, loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.cosim.many.prepared_scene import PreparedScene, companion_step, run_scene
from flexfmu.model.scene.file import load_scene

LOOP: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
}


@pytest.mark.parametrize(("changes", "selection"), [
    ({}, EVERYTHING),
    ({"cosimulation.step": 1e-3}, EVERYTHING),
    (LOOP, EVERYTHING),
    ({"cosimulation.step": 1e-4}, Selection(["joint1.torque"], 0, 1e-3)),
])  # fmt: skip
def test_the_estimate_is_what_is_recorded(changes: dict[str, Any], selection: Selection) -> None:
    """Within a fifth of the values that a run has in the end, and its companion's."""
    scene = load_scene("barnard2012-6kg").replace({**changes, "trajectory.dwell": 0.1})
    run = run_scene(scene, record=selection)
    loop: Loop = loop_of(scene)
    parts = scene_system(scene, loop, run.fmu_path)
    needed = PreparedScene(scene, record=selection)._recording.needed
    for each, step in (
        (run, run.communication_step),
        (None, companion_step(parts, loop.motion, run.communication_step)),
    ):
        found = each if each is not None else run.companion and run.companion.run(None)
        assert found is not None
        own = [column for name, column in found.recording.columns.items() if "end_effector.reference" not in name]
        arrays = [part for column in own for part in (column.values, column.first, column.second) if part is not None]
        values = found.recording.time.size * (1 + len(arrays))
        estimated = recorded_bytes(parts, needed, loop.motion.stop_time, step) / 8.0
        assert 0.8 < estimated / values < 1.6


OUT_OF_PROPORTION = {
    "run barnard2012-6kg --set trajectory.duration=430": "`trajectory.duration` = 430 s: 0.43 s?",
    "run barnard2012-6kg --set trajectory.dwell=250": "`trajectory.dwell` = 250 s: 0.25 s?",
    "run barnard2012-6kg --set cosimulation.step=2e-7": "the communication step is 2e-07 s: 0.0002 s?",
    "compare barnard2012-6kg --variant long:trajectory.duration=430": "s: 0.43 s?",
    "plan barnard2012-6kg --set trajectory.duration=900": "s: 0.9 s?",
    "sweep barnard2012-6kg --vary trajectory.duration=900 --metrics peak_torque_1 --no-plot": "s: 0.9 s?",
}
"""Command → the value that was meant."""


@pytest.mark.parametrize("command", OUT_OF_PROPORTION)
def test_values_in_milliseconds_are_asked_about(command: str, tmp_path: Path) -> None:
    """With sizes, duration and the value that was meant; nothing is written, nothing runs for minutes. In a sweep it is the
    case's own failure."""
    found = CliRunner().invoke(app, [*command.split(), "--out", str(tmp_path / "out")])
    assert found.exit_code != 0
    assert OUT_OF_PROPORTION[command] in found.output
    if command.startswith("run"):
        assert found.exit_code == 2
        assert all(part in found.output for part in (" GB and ", " GB for its companion", " s in steps of ", "--yes"))
        assert not any((tmp_path / "out").glob("*"))


def test_python_asks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The keyword accepts it."""
    monkeypatch.setattr("flexfmu.cosim.experiment.run_checks.LARGEST_SIZE", 1e6)
    with pytest.raises(InputError, match=r"record about .* GB for its companion, .*--yes`, in Python accept_size=True"):
        flexfmu.run("barnard2012-6kg")
    assert flexfmu.run("barnard2012-6kg", accept_size=True).completed


def test_shipped_scenes_are_below_the_limit() -> None:
    """All of them, and with the finest step of the benchmarks."""
    for name in ("barnard2012-6kg", "barnard2012-0.1kg"):
        PreparedScene(load_scene(name), communication_step=5e-6).check_size()
    assert LARGEST_SIZE > 1e9
