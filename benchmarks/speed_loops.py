"""What closed loops cost: a sample of a controller beside the plant, as a block, as an FMU and in Python, and a long run. Used by
`speed.py`; not a script of its own."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import process_time
from timeit import repeat
from typing import Any

import numpy as np
from idle import idle_fmu
from paper_scene import SCENE, Timed, best_times, timed
from speed_figure import SpeedFigure

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.own_function import controller
from flexfmu.cosim.engine.fmu.sampled_slave import SampledFmu
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.master.simulator import Simulator
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.results import EVERYTHING, Selection
from flexfmu.cosim.engine.slave import Indices, RealArray, Slave
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.symbolic import SymbolicBlock

DRIVEN = SCENE.replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})

SAMPLE_TIME = 2.5e-4
"""Of all controllers, and the communication step [s]: 4 kHz."""

SECONDS = 4.0
"""Length of the runs that tell what a sample costs."""

ROUNDS = 4
"""Rounds of runs of which the fastest counts."""

ONE_SIGNAL = Selection(["plant.joint1.position"], order=0)

LONG_LOOP = {
    "cosimulation.step": SAMPLE_TIME,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": SAMPLE_TIME}],
    "imperfection": [{"kind": "encoder", "counts_per_turn": 1e6}],
}


C_PD = Path(__file__).with_name("pd.c")
GAINS = {"kp": 1e3, "kd": 10.0}


def pd_function(reference: Any, measurement: Any, *, kp: float = 1e3, kd: float = 10.0) -> Any:
    """PD control as a function."""
    error = reference - measurement
    return kp * error[:2] + kd * error[2:]


class PdInPython:
    """A user's controller as in `examples/custom_controller.py`."""

    name = "own"
    sample_time = SAMPLE_TIME

    def __init__(self, like: BlockSlave) -> None:
        self.variables = tuple(each for each in like.variables if each.causality != "parameter")
        self.values = np.zeros(len(self.variables))
        self.outputs = slice(len(self.variables) - 2, len(self.variables))

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.sample(start_time)

    def set(self, indices: Indices, values: RealArray) -> None:
        self.values[indices] = values

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.values[indices]

    def sample(self, time: float) -> None:
        reference, rate, angle, velocity = self.values[:8].reshape(4, 2)
        self.values[self.outputs] = 1e3 * (reference - angle) + 10.0 * (rate - velocity)

    def step(self, time: float, step: float) -> None: ...

    def own_call(self) -> float:
        """Processor time [s] of its methods at a sample, called from Python."""
        inputs = np.array([i for i, each in enumerate(self.variables) if "feedforward" not in each.name][:-2])
        outputs = np.arange(self.outputs.start, self.outputs.stop)
        values, torques = np.zeros(inputs.size), np.zeros(outputs.size)

        def call() -> None:
            self.set(inputs, values)
            self.sample(0.0)
            self.get(outputs, torques)

        return min(repeat(call, timer=process_time, number=10_000, repeat=20)) / 10_000


def sampled(controller: Slave | None, idle: Path) -> Timed:
    """A run of a plant that does nothing, under a controller whose measurements are its references."""
    motion = plan(DRIVEN)
    references, plant = TrajectorySlave(motion.joints), FmuSlave(idle, "plant", output_order=0)
    slaves: list[Slave] = [references, plant]
    connections = []
    if controller is not None:
        slaves.append(controller)
        names = [
            each.name for each in controller.variables if each.causality == "input" and "feedforward" not in each.name
        ]
        sources = [name if ".reference." in name else name.replace(".", ".reference.", 1) for name in names]
        connections = [(f"trajectory.{a}", f"{controller.name}.{b}") for a, b in zip(sources, names, strict=True)]
        connections += [(f"{controller.name}.joint{joint}.torque", f"plant.joint{joint}.torque") for joint in (1, 2)]
    simulator = Simulator(connect(slaves, connections), SECONDS, SAMPLE_TIME, record=ONE_SIGNAL)
    if (result := simulator.run()).outcome is not Outcome.COMPLETED:
        raise SystemExit(result.message)
    return timed(simulator.run)


def built(**section: Any) -> SymbolicBlock:
    """The block of a controller's section."""
    (slave,) = loop_of(DRIVEN.replace({"controller": [section | {"sample_time": SAMPLE_TIME}]})).controllers
    assert isinstance(slave, BlockSlave)
    return slave.block


def sample_figures(folder: Path) -> Iterator[SpeedFigure]:
    """A sample of each kind of controller: the run's time beyond that of the plant alone."""
    idle = idle_fmu(build_scene(DRIVEN).path, folder)
    c_pd = {"kind": "c-function", "source": str(C_PD), "function": "pd", "parameters": GAINS}
    block, dynamic = (
        built(kind=kind, proportional=gains[0], derivative=gains[1])
        for kind, gains in (("pd", (1e3, 10.0)), ("computed-torque", (1e4, 200.0)))
    )
    own = PdInPython(BlockSlave(block))
    names = [each.name for each in block.inputs if "feedforward" not in each.name]
    outputs = [each.name for each in block.outputs]
    in_c = built(**c_pd, inputs=names, outputs=outputs)
    traced, called = (
        controller(sample_time=SAMPLE_TIME, symbolic=symbolic)(pd_function).slave() for symbolic in (True, False)
    )
    controllers: list[Slave | None] = [
        None,
        BlockSlave(block),
        BlockSlave(dynamic),
        SampledFmu(build_fmu(block).path, "exported"),
        own,
        BlockSlave(in_c),
        traced,
        called,
    ]
    times = best_times([sampled(each, idle) for each in controllers], ROUNDS)
    alone, *others = times
    pd_sample, torque_sample, exported, python, c_sample, traced_sample, called_sample = (
        (each - alone) * SAMPLE_TIME / SECONDS for each in others
    )
    note = f"{1e6 * alone * SAMPLE_TIME / SECONDS:.2f} µs a step with a plant that does nothing"
    yield SpeedFigure("PD, a sample beside the plant", 1e6 * pd_sample, 1.0, "µs", note=note)
    yield SpeedFigure("computed torque, a sample beside the plant", 1e6 * torque_sample, 2.0, "µs")
    note = f"{1e6 * exported:.2f} µs a sample"
    yield SpeedFigure("PD as an FMU, in terms of the block", exported / pd_sample, 2.0, "×", note=note)
    yield SpeedFigure("PD as a function in C, a sample", 1e6 * c_sample, 1.0, "µs")
    yield SpeedFigure("PD as a traced Python function, a sample", 1e6 * traced_sample, 1.0, "µs")
    yield SpeedFigure("PD as a Python function that isn't traced, a sample", 1e6 * called_sample, 30.0, "µs")
    call = own.own_call()
    note = f"{1e6 * call:.2f} µs for the methods by themselves"
    yield SpeedFigure("PD in Python, a sample beyond its methods", 1e6 * (python - call), 2.0, "µs", note=note)


def long_figures() -> Iterator[SpeedFigure]:
    """A minute at 4 kHz."""
    minute = DRIVEN.replace({**LONG_LOOP, "trajectory.dwell": 60.0 - DRIVEN.trajectory.duration})
    for tolerance, record, what in (
        (1e-3, ONE_SIGNAL, "one signal"),
        (1e-6, ONE_SIGNAL, "one signal"),
        (1e-3, EVERYTHING, "everything recorded"),
    ):
        prepared = PreparedScene(minute, tolerance=tolerance, record=record)
        run = timed(prepared.run)
        first, second = run(), run()
        name = f"60 s of PD with encoder, 4 kHz, {tolerance:.0e}, {what}"
        yield SpeedFigure(name, second, 1.5, "s", note=f"{first:.2f} s the first time")


def loop_figures() -> Iterator[SpeedFigure]:
    """All lines."""
    with tempfile.TemporaryDirectory(prefix="flexfmu-loops-") as name:
        yield from sample_figures(Path(name))
    yield from long_figures()
