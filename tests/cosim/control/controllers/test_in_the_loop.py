"""Controllers in the master's loop, and as FMUs: the same numbers everywhere."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import control
import numpy as np
import pytest
from blocks import computed_torque, learning, lqg, pid
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.from_control import LinearSystem, control_block, from_control, state_space
from flexfmu.cosim.control.controllers.state_feedback import (
    Equilibrium,
    state_feedback,
    static_feedforward,
)
from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.simulator import Outcome, simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.engine.slave import Indices, RealArray, Slave, SlaveVariable
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.linear import linearize, operating_point
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


def multivariable() -> SymbolicBlock:
    """Order 5, two inputs, three outputs, direct feedthrough."""
    rng = np.random.default_rng(7)
    A = rng.normal(size=(5, 5))
    A *= 0.95 / abs(np.linalg.eigvals(A)).max()
    return control_block(control.ss(A, rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2)), H))


def observer() -> SymbolicBlock:
    """State feedback with an observer and reference feedforward for the oscillator."""
    plant = from_control(linear_plant()[0])
    K = control.place(plant.A, plant.B, [0.9, 0.92])
    L = control.place(plant.A.T, plant.C.T, [0.5, 0.6]).T
    return state_feedback(plant, K, L, reference=static_feedforward(plant, ["y[0]"]))


BLOCKS: dict[str, Callable[[], SymbolicBlock]] = {
    "state space": multivariable,
    "observer": observer,
    "pid": lambda: pid(50.0, 300.0, 2.0, sample_time=H, filter_time=2e-3, torque_limit=[20.0, 30.0]),
    "learning": lambda: learning(gain=[1.0, 2.0], cycles=2, period=25 * H, sample_time=H, lead=2, forgetting=0.02),
    "computed torque": lambda: computed_torque(400.0, 40.0, sample_time=H),
}


@pytest.mark.parametrize("kind", BLOCKS)
def test_slave_and_fmu_agree(kind: str, tmp_path: Path) -> None:
    """A controller that leaves as an FMU gives what its Python slave gave, to rounding, sample by sample."""
    block, count = BLOCKS[kind](), 120
    names = tuple(variable.name for variable in block.inputs)
    values = np.random.default_rng(5).normal(size=(count + 1, len(names)))
    path = build_fmu(block, tmp_path / "block.fmu").path
    recordings = []
    for slave in (BlockSlave(block, "controller"), FmuSlave(path, "controller", {})):
        wires = [(f"signals.{name}", f"controller.{name}") for name in names]
        result = simulate(connect([Signals(names, values), slave], wires), stop=count * H, step=H)
        assert result.outcome is Outcome.COMPLETED, result.message
        time = result.recording.time
        middle = np.searchsorted(time, H * np.arange(1, count) + H / 4.0) - 1
        recordings.append(
            np.array([result.recording[f"controller.{each.name}"].values[middle] for each in block.outputs])
        )
    scale = abs(recordings[0]).max()
    assert scale > 0.0
    np.testing.assert_allclose(recordings[0], recordings[1], rtol=0, atol=1e-12 * scale)


def test_lqg_holds_the_robot() -> None:
    """`control.dlqr` and `control.dlqe` on the linearised robot give a controller that connects by its variables' names
    and damps the 28 states of the flexible plant from joint angles alone."""
    h = 2.5e-4
    scene = load_scene("barnard2012-6kg")
    position = scene.trajectory.start
    whole = linearize(scene, position, outputs=["joint1.position", "joint2.position"])
    labels = {"inputs": whole.input_labels[:2], "outputs": whole.output_labels}
    torques = control.ss(whole.A, whole.B[:, :2], whole.C, whole.D[:, :2], **labels)
    plant = from_control(torques, method="zoh", sample_time=h)
    weights = np.zeros((plant.order, plant.order))
    weights[:2, :2] = 1e6 * np.eye(2)
    K, _, _ = control.dlqr(plant.A, plant.B, weights, np.eye(2))
    L, _, _ = control.dlqe(plant.A, plant.B, plant.C, np.eye(2), 1e-10 * np.eye(2))
    point = operating_point(scene, position)
    equilibrium = Equilibrium(point.inputs[:2], point.coordinates[:2])
    reference = static_feedforward(plant, ["joint1.position", "joint2.position"], equilibrium)
    block = state_feedback(plant, K, L, equilibrium=equilibrium, reference=reference)
    assert [variable.name for variable in block.outputs] == ["joint1.torque", "joint2.torque"]
    assert {variable.name for variable in block.inputs} == {
        f"joint{i}{kind}.position" for i in (1, 2) for kind in ("", ".reference")
    }
    angles = regulate(plant, block, equilibrium, np.array([1e-3, -2e-3]), 2000)
    np.testing.assert_allclose(angles[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(angles[-1], [1e-3, -2e-3], atol=1e-7)


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


def regulate(plant: LinearSystem, block: SymbolicBlock, point: Equilibrium, step: Array, count: int) -> Array:
    """Deviations of the measured angles (N, 2) after the references have jumped by ``step``, the plant linear."""
    robot = BlockSlave(state_space(plant), "robot")
    slave = BlockSlave(block, "controller")
    angles, torques = np.zeros((count, 2)), np.empty(2)
    reading, driving = np.array([2, 3]), np.array([0, 1])
    slave.set(reading, np.asarray(point.outputs) + step)
    robot.initialize(0.0, 1.0, None)
    slave.initialize(0.0, 1.0, None)
    for k in range(count):
        robot.output(0.0)
        robot.get(reading, angles[k])
        slave.set(driving, angles[k] + point.outputs)
        slave.sample(0.0)
        slave.get(np.array([4, 5]), torques)
        robot.set(driving, torques - point.inputs)
        robot.update(0.0)
    return angles
