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
from flexfmu.cosim.workprec.trial import Curve, Trial, fastest, sweep
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.fmu_build.scene_build import build_scene

Array = NDArray[np.float64]

CVODE_SETTINGS = ((1e-3, 1e-4), (1e-3, 1e-5), (2.5e-4, 1e-5), (2.5e-4, 1e-6), (1e-4, 1e-6), (1e-4, 1e-7), (5e-5, 1e-8))
"""Output intervals [s] and relative tolerances. Inputs are held over an interval, and on over the end of CVODE's own steps, so that
the one needs the other to be small."""

PAPER_LINE = "fixed step of 10 MHz"

PAPER_STEP = 1e-7
"""The paper's fixed step: 10 MHz."""

PAPER_SHARE = 50
"""A run at 10 MHz is simulated over this fraction of the whole time, and its time multiplied: it would take a minute."""


def model_exchange_trials(subject: Subject, ours: Curve, announce: Announce) -> Iterator[Trial]:
    """fmpy integrates the FMU with CVODE; the references are a table of values, as fmpy takes no derivatives.

    What is measured is fmpy's import: it sets inputs at the ends of output intervals alone, an error of first order that no tolerance
    lessens. What CVODE does with inputs at every evaluation shows `solver_trials.sundials_trials`.
    """
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
        "record_events": False,
        "start_values": {**start, INITIAL.name: INITIAL.items[subject.scene.cosimulation.initial][0]},
        "output": ["end_effector.position.x", "end_effector.position.y"],
    }

    def trial(setting: tuple[float, float]) -> Trial:
        interval, tolerance = setting
        label = f"{1e3 * interval:g} ms, {tolerance:.0e}"
        announce(f"fmpy, CVODE, {label}")
        chosen = {"output_interval": interval, "relative_tolerance": tolerance, "input": input_table(subject, interval)}
        return _fmpy_trial(subject, arguments | chosen, label)

    yield from sweep(CVODE_SETTINGS, trial, ours)


def input_table(subject: Subject, spacing: float) -> Any:
    """Joint references every ``spacing`` [s], as fmpy takes them."""
    time = spacing * np.arange(round(subject.stop / spacing) + 2)
    motion = subject.motion.joints.evaluate(time, 2)
    names = [f"joint{j}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for j in (1, 2)]
    table = np.zeros(time.size, dtype=[("time", np.float64)] + [(name, np.float64) for name in names])
    table["time"] = time
    for column, name in enumerate(names):
        table[name] = motion[column // 2, :, column % 2]
    return table


def paper_trial(subject: Subject, announce: Announce) -> Trial:
    """The classical Runge-Kutta method at 10 MHz over the beginning of the motion, its time scaled up."""
    announce(PAPER_LINE)
    changes = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": PAPER_STEP}
    share = SAMPLING * max(1, round(subject.stop / SAMPLING / PAPER_SHARE))
    try:
        prepared = PreparedScene(subject.scene.replace(changes), communication_step=SAMPLING, motion=subject.motion)
        prepared.stop_time = share
        run = completed(prepared.run())
    except CosimError as failure:
        return Trial("tools", PAPER_LINE, "", None, None, " ".join(str(failure).split()))
    note = f"simulated to {1e3 * share:.0f} ms, the time multiplied by {subject.stop / share:.0f}"
    time = fastest(prepared.run) * subject.stop / share
    return Trial("tools", PAPER_LINE, "0.1 µs", subject.error(subject.positions(run)), time, note)


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
    note = "inputs held over the output interval"
    return Trial("tools", "fmpy, CVODE", label, subject.error(positions), fastest(run), note)
