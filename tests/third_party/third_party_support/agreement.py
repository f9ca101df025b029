"""One and the same run in our master, in fmpy and in other people's masters, and how far they are apart.

The planned motion of a scene moves its robot for a moment. Our master passes derivatives on, so that its result hardly depends
on the communication step. The others hold values over the step, fmpy with CVODE too, so that they tend to it with order 1; those
that do the same have the same numbers. Some record what the robot puts out before it gets its new inputs, some after.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import fmpy
import numpy as np
from numpy.typing import NDArray
from ssp_support.importers import signals_in
from ssp_support.packages import package

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.engine.master.couplings import Algorithm, GaussSeidel, Jacobi
from flexfmu.cosim.engine.master.simulator import simulate
from flexfmu.cosim.engine.master.system import connect
from flexfmu.cosim.exchange.slave_export import export_slaves
from flexfmu.cosim.exchange.ssp.structure import Component, Connector, SspConnection, Structure, ssd_xml
from flexfmu.cosim.experiment.planning import plan
from flexfmu.fmu_build.toolchain import FmiVersion
from flexfmu.model.scene.schema import Scene
from third_party_support import maestro

SIGNALS = ("end_effector.position.x", "end_effector.position.y", "joint1.torque")

STOP = 0.1
"""End of the run [s]: the robot has accelerated for a quarter of the motion."""

EXCHANGE_TOLERANCE = 1e-9
"""Relative, of CVODE, so that what is left is the tolerance of the FMU's own integrator, 1e-6."""

ORDER = 1
"""Of the difference that held inputs make, in the communication step."""

KINDS = ("position", "velocity", "acceleration")
MODULES = {"libcosim": "libcosimpy", "ecos": "ecospy", "OMSimulator": "OMSimulator"}

Table = NDArray[np.float64]


@dataclass(frozen=True)
class SharedRun:
    """The run that all tools make.

    Attributes:
        scene: what moves.
        system: FMUs of motion and robot, and their connections, and the outputs to record, by full names.
        folder: for the files of tools.
    """

    scene: Scene
    system: Mapping[str, Any]
    folder: Path


def shared_run(scene: Scene, folder: Path, signals: Sequence[str] = SIGNALS, fmi: FmiVersion = "2") -> SharedRun:
    """Export a scene's slaves, and say which outputs of the robot are compared."""
    exported = export_slaves(scene, folder / "fmus", fmi=fmi)
    fmus = {slave.name: str(slave.path) for slave in exported.slaves}
    connections = [list(pair) for pair in exported.connections]
    return SharedRun(
        scene, {"fmus": fmus, "connections": connections, "signals": [f"plant.{name}" for name in signals]}, folder
    )


def our_master(shared: SharedRun, step: float, algorithm: Algorithm, input_order: int | None) -> Table:
    """Our master; ``algorithm`` and ``input_order`` as in `flexfmu.cosim`."""
    slaves = [FmuSlave(path, name, input_order=input_order) for name, path in shared.system["fmus"].items()]
    wired = connect(slaves, [tuple(pair) for pair in shared.system["connections"]])
    recording = simulate(wired, stop=STOP, step=step, algorithm=algorithm).recording
    return np.column_stack([recording[name].values[1:] for name in shared.system["signals"]])


def python_master(name: str, shared: SharedRun, step: float, stop: float = STOP) -> Table:
    """A master with Python bindings, in a process of its own, which gets the system as an SSP file."""
    path = shared.folder / "system.ssp"
    structure = Structure(
        "system",
        tuple(
            Component(slave, f"resources/{slave}.fmu", connectors(fmu)) for slave, fmu in shared.system["fmus"].items()
        ),
        tuple(SspConnection(*(ends(name) for name in pair)) for pair in shared.system["connections"]),
        step=step,
        tolerance=1e-6,
    )
    fmus = {f"resources/{slave}.fmu": Path(fmu) for slave, fmu in shared.system["fmus"].items()}
    package(path, {"SystemStructure.ssd": ssd_xml(structure, "test"), **fmus})
    instants = [n * step for n in range(1, round(stop / step) + 1)]
    return signals_in(MODULES[name], path, step, instants, [ends(each) for each in shared.system["signals"]])


def ends(name: str) -> tuple[str, str]:
    """Slave and variable of a full name."""
    slave, _, variable = name.partition(".")
    return slave, variable


def connectors(fmu: str) -> tuple[Connector, ...]:
    """All inputs and outputs of an FMU."""
    variables = fmpy.read_model_description(fmu).modelVariables
    return tuple(
        Connector(each.name, each.causality, each.type) for each in variables if each.causality in ("input", "output")
    )


def java_master(shared: SharedRun, step: float, stop: float = STOP) -> Table:
    """Maestro, which leaves out the last point."""
    return maestro.simulate(shared.system, step, stop, shared.folder)[1:, 1:]


def fmpy_run(shared: SharedRun, step: float, kind: str, **options: Any) -> Table:
    """fmpy feeds the robot from a table; ``kind`` is CoSimulation or ModelExchange.

    It sets inputs at the beginning of a step; so it does for CVODE, which goes on beyond the step's end with them, unless the
    table has an event there. Its option ``set_input_derivatives`` takes a single input alone (version 0.3.32: "Can only assign
    sequence of same size").
    """
    table = input_table(shared.scene, step)
    signals = [name.removeprefix("plant.") for name in shared.system["signals"]]
    result = fmpy.simulate_fmu(
        shared.system["fmus"]["plant"],
        fmi_type=kind,
        stop_time=STOP,
        output_interval=step,
        input=table if kind == "CoSimulation" else held(table),
        output=signals,
        record_events=False,
        **options,
    )
    return np.column_stack([result[name][1:] for name in signals])


def input_table(scene: Scene, spacing: float) -> Any:
    """The planned motion as fmpy takes inputs."""
    time = np.arange(round(STOP / spacing) + 1) * spacing
    motion = plan(scene).joints.evaluate(time, len(KINDS) - 1)
    names = [f"joint{joint}.reference.{kind}" for kind in KINDS for joint in (1, 2)]
    table = np.zeros(time.size, dtype=[(name, np.float64) for name in ("time", *names)])
    table["time"] = time
    for column, name in enumerate(names):
        table[name] = motion[column // 2, :, column % 2]
    return table


def held(table: Any) -> Any:
    """The table with every time twice, before and after the jump to new values."""
    twice = np.repeat(table, 2)[1:]
    for name in table.dtype.names[1:]:
        twice[name][1::2] = table[name][:-1]
    return twice


@dataclass(frozen=True)
class Tool:
    """A tool that makes the run.

    Attributes:
        name: of the tool.
        records: whether it records the robot's outputs ``before`` or ``after`` it gets its new inputs.
        simulate: shared run, communication step and ``stop`` [s] → signals (points, signals) at the points after the first.
        like: name of the tool that follows the same rule, and so has the same numbers; empty for the first one.
        within: largest difference to that one.
    """

    name: str
    records: Literal["before", "after"]
    simulate: Callable[..., Table]
    like: str = ""
    within: float = 0.0


ROUNDING = 1e-9
"""Difference of the same sums in another order, after a hundred steps."""

INTEGRATION = 1e-5
"""Difference of integrators with tolerances of 1e-6 and less, after a hundred steps."""

exact = partial(our_master, algorithm=GaussSeidel(), input_order=None)
"""Our master with all derivatives: what the others tend to."""

_CVODE = {"kind": "ModelExchange", "solver": "CVode", "relative_tolerance": EXCHANGE_TOLERANCE}

TOOLS = (
    Tool("flexfmu", "after", partial(our_master, algorithm=Jacobi(), input_order=0)),
    Tool("ecos", "after", partial(python_master, "ecos"), "flexfmu", ROUNDING),
    Tool("OMSimulator", "after", partial(python_master, "OMSimulator"), "flexfmu", ROUNDING),
    Tool("fmpy ME, CVODE", "after", partial(fmpy_run, **_CVODE), "flexfmu", INTEGRATION),
    Tool("libcosim", "before", partial(python_master, "libcosim")),
    Tool("fmpy CS", "before", partial(fmpy_run, kind="CoSimulation"), "libcosim", ROUNDING),
    Tool("Maestro", "before", java_master, "libcosim", ROUNDING),
)
"""All that hold inputs, ours told to do so too."""


def tool(name: str) -> Tool:
    """The tool of that name."""
    return next(each for each in TOOLS if each.name == name)


def apart(first: Table, second: Table) -> float:
    """Largest difference at the points that both have, each signal relative to its largest value in ``second``."""
    points = min(len(first), len(second))
    return float((np.abs(first[:points] - second[:points]).max(axis=0) / np.abs(second).max(axis=0)).max())
