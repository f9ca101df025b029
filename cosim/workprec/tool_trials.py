"""Trials with our FMU in another tool, and with the paper's own setting of the solver."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.errors import CosimError
from flexfmu.cosim.experiment import PreparedScene
from flexfmu.cosim.fmu.file import open_fmu
from flexfmu.cosim.fmu.variables import parameter_names
from flexfmu.cosim.scene_parameters import parameters_for
from flexfmu.cosim.workprec.fmu_trials import Announce
from flexfmu.cosim.workprec.subject import SAMPLING, Subject, completed
from flexfmu.cosim.workprec.trial import Trial, fastest
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.fmu_build.scene_build import build_scene

Array = NDArray[np.float64]

CVODE_TOLERANCES = (1e-3, 1e-5, 1e-7)

TABLE_STEP = 1e-4
"""Distance of the points of the input table [s]; fmpy goes straight from one to the next."""

PAPER_STEP = 1e-7
"""The paper's fixed step: 10 MHz."""

PAPER_SHARE = 50
"""A run at 10 MHz is simulated over this fraction of the whole time, and its time multiplied: it would take a minute."""


def model_exchange_trials(subject: Subject, announce: Announce) -> Iterator[Trial]:
    """fmpy integrates the FMU with CVODE; the references are a table of values, as fmpy takes no derivatives."""
    path = build_scene(subject.scene).path
    description = open_fmu(path).description
    if description.modelExchange is None:
        yield Trial("tools", "fmpy, CVODE", "", None, None, "the FMU is not for model exchange")
        return
    folder = str(open_fmu(path).folder)
    start = parameters_for(subject.scene, parameter_names(description))
    arguments = {
        "filename": folder,
        "fmi_type": "ModelExchange",
        "solver": "CVode",
        "stop_time": float(subject.instants[-1]),
        "output_interval": SAMPLING,
        "record_events": False,
        "input": input_table(subject),
        "start_values": {**start, INITIAL.name: INITIAL.items[subject.scene.cosimulation.initial][0]},
        "output": ["end_effector.position.x", "end_effector.position.y"],
    }
    for tolerance in CVODE_TOLERANCES:
        announce(f"fmpy, CVODE, tolerance {tolerance:.0e}")
        yield _fmpy_trial(subject, {**arguments, "relative_tolerance": tolerance}, f"{tolerance:.0e}")


def input_table(subject: Subject) -> Any:
    """Joint references at `TABLE_STEP`, as fmpy takes them."""
    time = np.arange(0.0, subject.stop + TABLE_STEP, TABLE_STEP)
    motion = subject.motion.joints.evaluate(time, 2)
    names = [f"joint{j}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for j in (1, 2)]
    table = np.zeros(time.size, dtype=[("time", np.float64)] + [(name, np.float64) for name in names])
    table["time"] = time
    for column, name in enumerate(names):
        table[name] = motion[column // 2, :, column % 2]
    return table


def paper_trial(subject: Subject, announce: Announce) -> Trial:
    """The classical Runge-Kutta method at 10 MHz over the beginning of the motion, its time scaled up."""
    announce("fixed step, 10 MHz")
    changes = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": PAPER_STEP}
    share = SAMPLING * max(1, round(subject.stop / SAMPLING / PAPER_SHARE))
    try:
        prepared = PreparedScene(subject.scene.replace(changes), communication_step=SAMPLING, motion=subject.motion)
        prepared.stop_time = share
        run = completed(prepared.run())
    except CosimError as failure:
        return Trial("tools", "fixed step of 10 MHz", "", None, None, " ".join(str(failure).split()))
    note = f"simulated to {1e3 * share:.0f} ms, the time multiplied by {subject.stop / share:.0f}"
    time = fastest(prepared.run) * subject.stop / share
    return Trial("tools", "fixed step of 10 MHz", "0.1 µs", subject.error(subject.positions(run)), time, note)


def _fmpy_trial(subject: Subject, arguments: dict[str, Any], label: str) -> Trial:
    import fmpy

    def run() -> Any:
        return fmpy.simulate_fmu(**arguments)

    try:
        result = run()
    except Exception as failure:
        return Trial("tools", "fmpy, CVODE", label, None, None, " ".join(str(failure).split()))
    positions = np.stack(
        [np.interp(subject.instants, result["time"], result[f"end_effector.position.{axis}"]) for axis in "xy"], axis=1
    )
    note = f"inputs from a table every {1e3 * TABLE_STEP:g} ms"
    return Trial("tools", "fmpy, CVODE", label, subject.error(positions), fastest(run), note)
