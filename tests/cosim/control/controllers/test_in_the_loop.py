"""Controllers in the master's loop, and as FMUs: the same numbers everywhere."""

from __future__ import annotations

import control
import numpy as np
from blocks import lqg
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.from_control import control_block
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, Slave, SlaveVariable
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3


class Signals:
    """Held signals, one row for each step of H."""

    name = "signals"

    def __init__(self, names: tuple[str, ...], values: Array) -> None:
        self.variables = tuple(SlaveVariable(name, "output") for name in names)
        self.values = values
        self.row = 0

    def initialize(self, start_time: float, stop_time: float, tolerance: float | None) -> None:
        self.row = 0

    def set(self, indices: Indices, values: RealArray) -> None: ...

    def get(self, indices: Indices, values: RealArray) -> None:
        values[:] = self.values[self.row][indices]

    def step(self, time: float, step: float) -> None:
        self.row = round((time + step) / H)


def linear_plant() -> tuple[control.StateSpace, control.StateSpace]:
    """An oscillator, discrete and strictly proper, and a controller with direct feedthrough."""
    plant = control.c2d(control.tf([50.0], [1.0, 4.0, 100.0]), H, "zoh")
    controller = control.ss([[0.9, 0.1], [0.0, 0.5]], [[1.0], [0.5]], [[-0.4, 0.3]], [[6.0]], H)
    return control.ss(plant), controller


def test_closed_loop() -> None:
    """Controller and plant as two slaves in the master's loop move as `control.feedback` of both says."""
    plant, controller = linear_plant()
    count = 300
    reference = np.random.default_rng(1).normal(size=count + 1)
    error = control.ss([], [], [], [[1.0, -1.0]], H, inputs=["r", "y"], outputs=["e"])
    slaves: list[Slave] = [
        BlockSlave(control_block(plant, inputs=["u"], outputs=["y"]), "plant"),
        BlockSlave(control_block(controller, inputs=["e"], outputs=["u"]), "controller"),
        BlockSlave(control_block(error), "comparison"),
        Signals(("r",), reference[:, None]),
    ]
    wires = [
        ("plant.y", "comparison.y"),
        ("signals.r", "comparison.r"),
        ("comparison.e", "controller.e"),
        ("controller.u", "plant.u"),
    ]
    result = simulate(connect(slaves, wires), stop=count * H, step=H)
    assert result.outcome is Outcome.COMPLETED, result.message
    loop = control.feedback(control.series(controller, plant), 1)
    wanted = control.forced_response(loop, H * np.arange(count + 1), reference).outputs
    time = result.recording.time
    last = np.searchsorted(time, H * np.arange(count + 1) + H / 4.0) - 1
    found = result.recording["plant.y"].values[last]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12 * abs(wanted).max())


def test_only_ratios_of_lqg_weights_count() -> None:
    """Twice all costs, or twice all standard deviations, is the same controller; other ratios are another one."""
    scene = load_scene("barnard2012-6kg").replace({"effects.proximal_bending": 1, "effects.distal_axial": 0})
    costs = {"position_error": 2e-3, "velocity_error": 0.2, "torque_deviation": 20.0}
    twice = {**costs, "torque_noise": 3.0, "measurement_noise": 3e-5}
    one, same, another = (
        _step_of(lqg(scene=scene, sample_time=H, **each)) for each in ({}, twice, {"torque_noise": 3.0})
    )
    np.testing.assert_allclose(same, one, rtol=1e-6, atol=1e-9 * abs(one).max())
    assert abs(another - one).max() > 1e-3 * abs(one).max()


def _step_of(block: SymbolicBlock) -> Array:
    """(50, outputs) what a controller puts out when a measured angle jumps by a milliradian."""
    slave = BlockSlave(block)
    inputs = [each.start or 0.0 for each in block.inputs]
    first = [each.name for each in block.inputs].index("joint1.position")
    outputs = np.arange(len(block.inputs) + len(block.parameters), len(slave.variables))
    slave.initialize(0.0, 1.0, None)
    found = np.empty((50, outputs.size))
    for k in range(len(found)):
        slave.set(np.array([first]), np.array([inputs[first] + 1e-3]))
        slave.sample(k * block.sample_time)
        slave.get(outputs, found[k])
    return found
