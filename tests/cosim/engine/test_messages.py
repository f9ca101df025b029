"""What is refused: one table of calls, and of the words that say why and what to do instead."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import fmpy
import numpy as np
import pytest
from python_slave import Block, SampledSlave

from flexfmu.cosim.engine.errors import AlgebraicLoopError, FmuFileError, InputError, ResultsError, WiringError
from flexfmu.cosim.engine.fmu.sampled_slave import fmu_slave
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.grid import Clock, time_grid
from flexfmu.cosim.engine.master.iteration import Anderson
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.step_control import StepDoubling
from flexfmu.cosim.engine.master.system import Wire, connect
from flexfmu.cosim.engine.results import FORMATS, Column, Recording, Selection
from flexfmu.cosim.engine.slave import SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.model.scene.loop import FmuSection

FMI_1 = """<fmiModelDescription fmiVersion="1.0" modelName="old" modelIdentifier="old" guid="1" numberOfContinuousStates="0"
numberOfEventIndicators="0"><ModelVariables/><Implementation><CoSimulation_StandAlone><Capabilities/></CoSimulation_StandAlone>
</Implementation></fmiModelDescription>"""

MANY = '<VendorAnnotations><Tool name="flexfmu"><InputDerivatives maxOrder="many"/></Tool></VendorAnnotations>'
ORDER = (
    ("<CoSimulation ", '<CoSimulation canInterpolateInputs="true" '),
    ("<ModelVariables>", f"{MANY}<ModelVariables>"),
)

CLOCK = (
    (
        '<Int32 name="ticks"',
        '<Clock name="beat" valueReference="50" causality="input" intervalVariability="triggered"/><Int32 name="ticks"',
    ),
    ('hasEventMode="true"', ""),
)


class Sampler(SampledSlave):
    """Samples in one call, with direct feedthrough."""

    variables = (SlaveVariable("u1", "input", "m", 0.0), SlaveVariable("y1", "output", "m"))

    def __init__(self, sample_time: float = 0.1, offset: float = 0.0) -> None:
        super().__init__("sampler")
        self.sample_time, self.offset = sample_time, offset

    def sample(self, time: float) -> None:
        self.memory[1] = self.memory[0]


def wired(*wires: Wire, unit: str = "m", **more: Any) -> None:
    """Two slaves whose outputs follow from states."""
    connect([Block(name, unit, y1=(), y2=()) for name in ("a", "b")], wires, **more)


def sampled(sample_time: float, offset: float = 0.0) -> None:
    """A slave with these times at a communication step of 0.2 ms."""
    simulate(connect([Sampler(sample_time, offset)], []), 1.0, 2e-4)


def written(folder: Path, text: str, name: str = "") -> Path:
    """A file with this text, or an archive with such a file."""
    path = folder / "broken.fmu"
    if not name:
        path.write_text(text)
        return path
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(name, text)
    return path


def fmi2(it: Any, **parameters: Any) -> None:
    """The FMI 2.0 FMU with these parameters."""
    fmu_slave(it.decay(), "it", parameters)


def fmi3(it: Any, **parameters: Any) -> None:
    """The FMI 3.0 FMU with these parameters."""
    fmu_slave(it.events(), "it", parameters)


Call = Callable[[Any], object]

MODEL_EXCHANGE = "CoSimulation modelIdentifier", "ModelExchange modelIdentifier"
SCHEDULED = "CoSimulation modelIdentifier", "ScheduledExecution modelIdentifier"

CASES: dict[type[Exception], dict[str, Call]] = {
    WiringError: {
        "a.y9.*no such output; did you mean a.y": lambda it: wired(("a.y9", "b.u1")),
        "b.w1.*no such input; did you mean b.u": lambda it: wired(("a.y1", "b.w1")),
        "there is no slave 'c'; slaves: a, b": lambda it: wired(("c.y1", "b.u1")),
        "'a.u1' is no output": lambda it: wired(("a.u1", "b.u1")),
        "'b.y1' is no input": lambda it: wired(("a.y1", "b.y1")),
        "there is no slave 'y1'": lambda it: wired(("y1", "b.u1")),
        r"a\.y1 is in rad, b\.u1 in m": lambda it: wired(("a.y1", "b.u1"), unit="rad"),
        r"b\.u1 is connected twice": lambda it: wired(("a.y1", "b.u1"), ("a.y2", "b.u1")),
        "two slaves are named 'a'": lambda it: connect([Block("a"), Block("a")], []),
        "take a name without a dot": lambda it: connect([Block("a.b")], []),
        "sampler can't be repeated to solve the algebraic loop .*two phases": lambda it: connect(
            [Sampler(), Block("b")], [("sampler.y1", "b.u1"), ("b.y1", "sampler.u1")], loops=Anderson()
        ),
    },
    # a slave that says nothing about feedthrough is taken to pass everything on
    AlgebraicLoopError: {
        "a.y1 -> b.u1 -> b.y1 -> a.u2 -> a.y1; put a slave with a state": lambda it: connect(
            [Block("a"), Block("b", y1=("u1",))], [("a.y1", "b.u1"), ("b.y1", "a.u2")]
        )
    },
    InputError: {
        # step control, references, recordings
        "step control needs.* 2": lambda it: StepDoubling(tolerance=2.0),
        "step control needs.* -1": lambda it: StepDoubling(absolute=-1.0),
        "step control needs.* 1": lambda it: StepDoubling(smallest=2.0, largest=1.0),
        "must be 0 to 9": lambda it: TrajectorySlave(it.swing, order=10),
        "order 0, 1 or 2, got 3": lambda it: Selection(order=3),
        "a list of names": lambda it: Selection("joint1.torque"),
        "interval of the recorded instants must be above 0 s": lambda it: Selection(step=0.0),
        f"no format 'xlsx' of results; choose from {', '.join(FORMATS)}": lambda it: it.recording.write("a.xlsx"),
        r"read from \.csv, \.parquet and \.mat files": lambda it: Recording.read("results.mcap"),
        # grids: a step in the wrong unit is an error, not a full memory
        "step must be above 0 s and finite, got 0 s": lambda it: time_grid(0.0, 1.0, 0),
        "got nan s": lambda it: time_grid(0.0, 1.0, np.nan),
        "must end after its start, got start 1 s, stop 1 s": lambda it: time_grid(1, 1, 0.1),
        "stop nan s": lambda it: time_grid(0.0, np.nan, 0.1),
        r"makes 1e\+09 steps; take a larger one": lambda it: time_grid(0.0, 1.0, 1e-9),
        # sample times without a common tick with the communication step are named, and values that fit
        r"sampler: .*time of 0\.000314159265359 s.*step of 0\.0002 s.*0\.0004 s.*0\.00015707963": lambda it: sampled(
            np.pi * 1e-4
        ),
        r"sampler: .*offset of 0\.000123457 s.*step of 0\.0002 s": lambda it: sampled(1e-3, 0.000123457),
        r"sample time of 7\.77777e-06 s.*7\.69230769231e-06 s": lambda it: sampled(7.77777e-6),
        r"sampler: .*sample time of 0\.0 s": lambda it: sampled(0.0),
        r"sampler: .*offset must be zero or positive, got -0\.001 s": lambda it: sampled(1e-3, -1e-3),
        "sampler: .*sample time of nan s": lambda it: sampled(float("nan")),
        "the sample times of a .* b .* have no common tick": lambda it: time_grid(
            0.0, 1.0, 1e-3, clocks=[Clock("a", 1e-3 / 997), Clock("b", 1e-3 / 991), Clock("c", 1e-3)]
        ),
        # parameters of FMUs
        "n has the type 'Int'; a variable is one of Real,": lambda it: SlaveVariable("n", "output", type=it.int),
        "no parameter 'rats'; did you mean 'rate'": lambda it: fmi2(it, rats=1.0),
        "must be one of none, fails, ends, forgets": lambda it: fmi2(it, trouble="sings"),
        r"must be one of 1 \(none\), 2 \(fails\), .*, got 99": lambda it: fmi2(it, trouble=99),
        r"trouble must be a whole number, got 0\.5": lambda it: fmi2(it, trouble=0.5),
        "inverted must be true or false, got 2": lambda it: fmi2(it, inverted=2),
        "inverted is a number, got 'yes'": lambda it: fmi2(it, inverted="yes"),
        r"rate must be one number, got \[1\.0, 2\.0\]": lambda it: fmi2(it, rate=[1.0, 2.0]),
        r"rate must be a finite number, got 10": lambda it: fmi2(it, rate=10**400),
        r"UInt8\.in must be at least 0 and at most 255, got 256": lambda it: fmi3(it, **{"UInt8.in": 256}),
        "n must be at least 0 and at most 4, got 5": lambda it: fmi3(it, n=5),
        r"A is an array: give 4 values, row by row, .* A\[1,1\]; got 3": lambda it: fmi3(it, A=[1, 2, 3]),
        "output_order must be zero or positive, got -1": lambda it: FmuSlave(it.decay(), output_order=-1),
        r"an offset of 0\.1 s needs a sample time": lambda it: fmu_slave(it.decay(), offset=0.1),
    },
    # FMUs that are broken, of another kind, or for another platform
    FmuFileError: {
        "No such file": lambda it: FmuSlave(it.folder / "none.fmu"),
        "not a zip": lambda it: FmuSlave(written(it.folder, "no zip")),
        "broken FMU": lambda it: FmuSlave(written(it.folder, "", "readme.txt")),
        r"is an FMU of FMI 1\.0; .*export it": lambda it: FmuSlave(written(it.folder, FMI_1, "modelDescription.xml")),
        "is a broken FMU: .*fmi2": lambda it: FmuSlave(it.decay(MODEL_EXCHANGE)),
        "is a broken FMU: .*fmi3": lambda it: FmuSlave(it.events(MODEL_EXCHANGE)),
        "broken FMU: .*ScheduledExecution": lambda it: FmuSlave(it.events(SCHEDULED)),
        r"has clocks but no event mode \(hasEventMode\)": lambda it: FmuSlave(it.events(*CLOCK)),
        "FMI 4.0|Unsupported FMI version": lambda it: FmuSlave(it.events(('fmiVersion="3.0"', 'fmiVersion="4.0"'))),
        r"InputDerivatives are .'maxOrder': 'many'": lambda it: FmuSlave(it.decay(*ORDER)),
        "has no binary for .* .it has: amiga64": lambda it: FmuSlave(it.decay(platform="amiga64")),
        rf"no binary for {fmpy.platform_tuple} \(it has: riscv": lambda it: FmuSlave(it.events(platform="riscv-linux")),
    },
    ResultsError: {
        "'x' has 3 values for 2 instants": lambda it: Recording(np.zeros(2), {"x": Column("m", np.zeros(3))})
    },
    ValueError: {"output_order": lambda it: FmuSection(kind="fmu", path="a.fmu", output_order=-1)},
}


@pytest.mark.parametrize(("error", "words"), [(error, words) for error, cases in CASES.items() for words in cases])
def test_what_is_refused(
    make_decay: Callable[..., Path],
    make_events: Callable[..., Path],
    tmp_path: Path,
    error: type[Exception],
    words: str,
) -> None:
    """Before anything runs, in one line with the name, the value and a remedy."""
    recording = Recording(np.arange(2.0), {})
    it = SimpleNamespace(decay=make_decay, events=make_events, folder=tmp_path, recording=recording)
    it.swing, it.int = object(), "Int"
    with pytest.raises(error, match=words) as caught:
        CASES[error][words](it)
    assert "\n" not in str(caught.value) or error is ValueError
