"""The master: sources are ahead of their targets, jumps have two sides, failures keep what was recorded. The loop in C: every instruction under
the address and undefined-behaviour sanitizers, and the numbers of the loop in Python."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from importlib.resources import as_file, files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from python_slave import PythonSlave

from flexfmu.cosim.engine.errors import SlaveError
from flexfmu.cosim.engine.master.compiled_loop import load
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.shared_library import shared_library
from flexfmu.cosim.engine.slave import Indices, RealArray, SlaveVariable
from flexfmu.cosim.experiment import scene_build
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.experiment.system import scene_system
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene


class Source(PythonSlave):
    """y = sin(3 t), without any derivatives or knowledge of the future."""

    name = "source"
    variables = (SlaveVariable("y", "output"),)

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = np.sin(3.0 * self.time)


class Recorder(PythonSlave):
    """Passes its input on as its output and notes everything that it is told."""

    max_input_order = 1
    variables = (SlaveVariable("u", "input", start=7.0), SlaveVariable("y", "output"))

    def __init__(self, name: str = "recorder") -> None:
        super().__init__(name)
        self.steps: list[tuple[float, float]] = []
        self.inputs: list[tuple[float, float]] = []
        self.terminated = 0
        self.input = [7.0, 0.0]

    def set(self, indices: Indices, values: RealArray) -> None:
        self.input = [float(values[0]), 0.0]

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.input[1] = float(derivatives[0, 0])

    def get(self, indices: Indices, values: RealArray) -> None:
        values[0] = self.input[0]

    def step(self, time: float, step: float) -> None:
        self.steps.append((time, step))
        self.inputs.append((self.input[0], self.input[1]))
        self.input[0] += self.input[1] * step

    def terminate(self) -> None:
        self.terminated += 1


def test_feedforward_is_interpolated() -> None:
    """In a chain the source is advanced first, however the slaves are listed: the target's input interpolates between
    both ends of the step, and passes through every value of the source."""
    target = Recorder()
    result = simulate(connect([target, Source()], [("source.y", "recorder.u")]), stop=1.0, step=0.1)
    values = result.recording["source.y"].values
    np.testing.assert_allclose([value for value, _ in target.inputs], values[:-1], rtol=0, atol=1e-15)
    np.testing.assert_allclose([rate for _, rate in target.inputs], np.diff(values) / 0.1, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(result.recording["recorder.y"].values, values, rtol=0, atol=1e-15)


class Wave(Source):
    """The same with some derivatives."""

    def __init__(self, order: int) -> None:
        super().__init__()
        self.max_output_order = order

    def get_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        for k, row in enumerate(derivatives, start=1):
            row[:] = 3.0**k * np.sin(3.0 * self.time + 0.5 * k * np.pi)


class Limited(Recorder):
    """Takes so many derivatives and no more."""

    def __init__(self, order: int) -> None:
        super().__init__()
        self.max_input_order = order
        self.orders: set[int] = set()

    def set_derivatives(self, indices: Indices, derivatives: RealArray) -> None:
        self.orders.add(len(derivatives))


@pytest.mark.parametrize("taken", range(7))
@pytest.mark.parametrize("given", range(4))
def test_nobody_is_told_more_derivatives_than_he_takes(given: int, taken: int) -> None:
    """Whatever the source knows; the interpolating polynomial has the highest odd degree that fits."""
    target = Limited(taken)
    result = simulate(connect([Wave(given), target], [("source.y", "recorder.u")]), stop=1.0, step=0.1)
    assert result.outcome is Outcome.COMPLETED, result.message
    degree = max(min(given, taken), min(2 * given + 1, taken - (taken + 1) % 2))
    assert target.orders == ({degree} if taken else set())


class Troublemaker(Recorder):
    """Does something bad in its fourth step."""

    def __init__(self, trouble: Callable[[], None]) -> None:
        super().__init__("troublemaker")
        self.trouble = trouble

    def step(self, time: float, step: float) -> None:
        super().step(time, step)
        if len(self.steps) == 4:
            self.trouble()


def fail(error: BaseException, *_: object) -> None:
    """Raise that error."""
    raise error


@pytest.mark.parametrize(
    ("error", "outcome", "message"),
    [
        (SlaveError("troublemaker", "no\nsolution"), Outcome.STEP_FAILED, "troublemaker failed at 0.3 s: no solution"),
        (SlaveError("troublemaker", "gave up", 0.35), Outcome.STEP_FAILED, "troublemaker failed at 0.35 s: gave up"),
        (ZeroDivisionError("by zero"), Outcome.STEP_FAILED, "troublemaker failed at 0.3 s: ZeroDivisionError: by zero"),
        (KeyboardInterrupt(), Outcome.INTERRUPTED, "the simulation was interrupted; the results end there"),
    ],
)
@pytest.mark.parametrize("compiled", [True, False])
def test_a_failure_keeps_what_was_recorded(
    error: BaseException, outcome: Outcome, message: str, compiled: bool
) -> None:
    """Whatever happens in a slave, the run ends with its name, time and reason, the results up to there, and all slaves
    terminated, in C and in Python alike."""
    bystander, troublemaker = Recorder("bystander"), Troublemaker(partial(fail, error))
    result = simulate(connect([bystander, troublemaker], []), stop=1.0, step=0.1, compiled=compiled)
    assert (result.outcome, result.message, result.error) == (outcome, message, error)
    np.testing.assert_allclose(result.recording.time, [0.0, 0.1, 0.2, 0.3])
    assert result.steps == 3
    assert (bystander.terminated, troublemaker.terminated) == (1, 1)


class Row(PythonSlave):
    """Seven outputs, all of them 1e308 but for one from 50 ms on."""

    variables = tuple(SlaveVariable(f"x{i}", "output") for i in range(7))

    def __init__(self, place: int, value: float) -> None:
        super().__init__("row")
        self.place, self.value = place, value

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = 1e308
        values[self.place] = 1e308 if self.time < 0.05 else self.value


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(7))
@pytest.mark.parametrize("compiled", [True, False])
def test_outputs_must_be_finite(place: int, value: float, compiled: bool) -> None:
    """NaN and infinity stop the run, whichever output it is, and don't get into the results; huge numbers do no harm."""
    run = simulate(connect([Row(place, value)], []), 0.1, 1e-3, compiled=compiled)
    assert (run.outcome, run.message) == (Outcome.NOT_FINITE, f"row failed at 0.05 s: x{place} became {value}")
    assert run.recording.time[-1] == pytest.approx(0.049)
    assert run.recording[f"row.x{place}"].values.tolist() == [1e308] * 50


def test_interruption_keeps_what_was_recorded() -> None:
    """Ctrl-C between two points ends the run as it does within a slave."""

    def interrupt(fraction: float) -> None:
        if fraction >= 0.5:
            raise KeyboardInterrupt

    run = simulate(connect([Source()], []), 0.1, 1e-3, progress=interrupt)
    assert run.outcome is Outcome.INTERRUPTED
    assert run.recording.time[-1] == pytest.approx(0.05)


def test_failing_initialisation() -> None:
    """A slave that can't be initialised ends the run before it begins; the others are terminated all the same."""
    bystander, other = Recorder("bystander"), Recorder("other")
    other.initialize = partial(fail, SlaveError("other", "mass must be positive"))  # type: ignore[method-assign]
    result = simulate(connect([bystander, other], []), stop=1.0, step=0.1)
    assert (result.outcome, result.recording.time.size) == (Outcome.INITIALISATION_FAILED, 0)
    assert result.message == "other failed at 0 s: mass must be positive"
    assert bystander.terminated == 1


@pytest.mark.parametrize(
    ("error", "message", "end"),
    [
        (None, "other failed at 1 s: OSError: the port is closed", 1.0),
        (ZeroDivisionError("by zero"), "other failed at 0.3 s: ZeroDivisionError: by zero", 0.3),
    ],
)
def test_failing_termination(error: Exception | None, message: str, end: float) -> None:
    """A slave that can't end well is told like any that fails, unless that hides an earlier failure, and the others are
    terminated all the same."""
    bystander, other = Recorder("bystander"), Troublemaker(partial(fail, error) if error else lambda: None)
    other.name = "other"
    other.terminate = partial(fail, OSError("the port is closed"))  # type: ignore[method-assign]
    result = simulate(connect([other, bystander], []), stop=1.0, step=0.1)
    assert (result.outcome, result.message) == (Outcome.STEP_FAILED, message)
    assert result.recording.time[-1] == pytest.approx(end)
    assert bystander.terminated == 1


COMPILER = next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SOURCES = Path(__file__).parent / "c-master"


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize(
    ("source", "tested", "arguments"),
    [("program.c", "master.c", []), ("program.c", "master.c", ["step"]), ("dense_program.c", "dense.c", [])],
    ids=["not finite", "failed step", "interpolation"],
)
def test_programs(source: str, tested: str, arguments: list[str], tmp_path: Path) -> None:
    """What all instructions write, when they are carried out, and where a failure is reported; all derivatives of two
    signals, at a point and between the last ones."""
    program = tmp_path / "program"
    with as_file(files("flexfmu.cosim.engine.master") / "c-master") as folder:
        command = [COMPILER, *FLAGS, *SANITIZERS, "-I", folder, SOURCES / source, folder / tested, "-lm", "-o", program]
        built = subprocess.run([str(each) for each in command], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    outcome = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


SCENE = load_scene("barnard2012-6kg").replace({"trajectory.duration": 0.2, "trajectory.dwell": 0.02})

CONTROLLED = SCENE.replace(
    {
        "cosimulation.drive": "torque",
        "effects.motor_inertia": 0.1,
        "controller": [
            {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 5e-4},
            {"kind": "feedforward", "sample_time": 1e-3},
        ],
        "shaper": [{"kind": "zv", "apply": "sampled", "sample_time": 1e-3, "modes": [{"frequency": 58.0}]}],
        "imperfection": [
            {"kind": "encoder", "counts_per_turn": 1e6},
            {"kind": "noise", "signal": "torque", "standard_deviation": 0.1},
            {"kind": "lag", "time_constant": 3e-4},
        ],
    }
)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, CONTROLLED], ids=["motion-driven", "controlled"])
def test_the_same_numbers(scene: Scene) -> None:
    """Every signal and derivative at every instant, with streamed references and with sampled slaves of all kinds; it is
    also the second run of the same slaves, which repeats the first to the last bit."""
    loop = loop_of(scene, plan(scene))
    parts = scene_system(scene, loop, build_scene(scene).path)
    system = connect(parts.slaves, parts.wiring.connections)
    found, exact = (
        simulate(system, loop.motion.stop_time, 5e-4, tolerance=1e-6, compiled=each).recording for each in (True, False)
    )
    assert found.time.size > 400
    np.testing.assert_array_equal(found.time, exact.time)
    assert list(found.columns) == list(exact.columns)
    for name, column in found.columns.items():
        for part in ("values", "first", "second"):
            np.testing.assert_array_equal(getattr(column, part), getattr(exact[name], part), name)


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The run goes on in Python; a scene's FMU brings the C libraries into the cache, where they need no compiler."""
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "built"))
    monkeypatch.setattr(scene_build, "build_fmu", lambda *_, **__: SimpleNamespace(cached=False))
    build_scene(SCENE)
    monkeypatch.setenv("CC", "there-is-no-such-compiler")
    shared_library.cache_clear()
    assert load.__wrapped__() is not None
    assert shared_library("metrics").metrics_peak
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "empty"))
    shared_library.cache_clear()
    assert load.__wrapped__() is None
