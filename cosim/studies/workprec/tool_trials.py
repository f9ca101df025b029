"""Trials with other tools: our FMU in fmpy, the paper's own setting of the solver, and another multibody code where it is installed
(``pip install flexfmu[peers]``)."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import fmpy
import numpy as np

from flexfmu.cosim.engine.fmu.file import open_fmu
from flexfmu.cosim.engine.fmu.variables import parameter_names
from flexfmu.cosim.experiment.parameters import parameters_for
from flexfmu.cosim.experiment.prepared_scene import PreparedScene
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.studies.workprec.trial import (
    SAMPLING,
    Announce,
    RunError,
    SceneUnderTest,
    WorkCurve,
    WorkPrecisionTrial,
    completed,
    sweep,
    trial_of,
)
from flexfmu.fmu_build.choices import INITIAL
from flexfmu.model.scene.effects import ModalDampingSection
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene

CVODE_SETTINGS = ((1e-3, 1e-4), (1e-3, 1e-5), (2.5e-4, 1e-5), (2.5e-4, 1e-6), (1e-4, 1e-6), (1e-4, 1e-7), (5e-5, 1e-8))
"""Output intervals [s] and relative tolerances. Inputs are constant over an interval, so that a smaller tolerance reduces the error
only with a shorter interval."""

PAPER_LINE = "fixed step of 10 MHz"

PAPER_STEP = 1e-7
"""The paper's fixed step: 10 MHz."""

PAPER_SHARE = 50
"""Ratio of the whole time to the part simulated at 10 MHz; a whole run would take a minute."""


def model_exchange_trials(subject: SceneUnderTest, ours: WorkCurve, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """fmpy integrates the FMU with CVODE; the references are a table of values, as fmpy takes no derivatives.

    The trial measures fmpy's import: it sets inputs at the ends of output intervals alone, an error of first order that no tolerance
    lessens. `solver_trials.sundials_trials` shows CVODES with inputs at every evaluation.
    """
    path = build_scene(subject.scene).path
    description = open_fmu(path).description
    if description.modelExchange is None:
        yield WorkPrecisionTrial("tools", "fmpy, CVODE", "", None, None, "the FMU is not for model exchange")
        return
    # what all settings share
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

    def trial(setting: tuple[float, float]) -> WorkPrecisionTrial:
        interval, tolerance = setting
        label = f"{1e3 * interval:g} ms, {tolerance:.0e}"
        announce(f"fmpy, CVODE, {label}")
        chosen = {"output_interval": interval, "relative_tolerance": tolerance, "input": input_table(subject, interval)}

        def run() -> Any:
            return fmpy.simulate_fmu(**arguments, **chosen)

        def measure() -> tuple[float, float, str]:
            result = run()
            columns = (result[f"end_effector.position.{axis}"] for axis in "xy")
            positions = np.stack([np.interp(subject.instants, result["time"], each) for each in columns], axis=1)
            return subject.error(positions), fastest(run), "inputs held over the output interval"

        return trial_of("tools", "fmpy, CVODE", label, measure, Exception)

    yield from sweep(CVODE_SETTINGS, trial, ours)


def input_table(subject: SceneUnderTest, spacing: float) -> Any:
    """Joint references every ``spacing`` [s], as fmpy takes them."""
    # up to one interval beyond the end
    time = spacing * np.arange(round(subject.stop / spacing) + 2)
    motion = subject.motion.joints.evaluate(time, 2)
    names = [f"joint{j}.reference.{kind}" for kind in ("position", "velocity", "acceleration") for j in (1, 2)]
    table = np.zeros(time.size, dtype=[("time", np.float64)] + [(name, np.float64) for name in names])
    table["time"] = time
    for column, name in enumerate(names):
        table[name] = motion[column // 2, :, column % 2]
    return table


def paper_trial(subject: SceneUnderTest, announce: Announce) -> WorkPrecisionTrial:
    """The classical Runge-Kutta method at 10 MHz over the beginning of the motion, its time scaled up."""
    announce(PAPER_LINE)
    changes = {"cosimulation.integrator": "rk4", "cosimulation.integrator_step": PAPER_STEP}
    # the beginning alone, a whole number of sample instants
    share = SAMPLING * max(1, round(subject.stop / SAMPLING / PAPER_SHARE))

    def measure() -> tuple[float, float, str]:
        prepared = PreparedScene(subject.scene.replace(changes), communication_step=SAMPLING, motion=subject.motion)
        prepared.stop_time = share
        error = subject.error(subject.positions(completed(prepared.run())))
        note = f"simulated to {1e3 * share:.0f} ms, the time multiplied by {subject.stop / share:.0f}"
        return error, fastest(prepared.run) * subject.stop / share, note

    return trial_of("tools", PAPER_LINE, "0.1 µs", measure)


DAMPING_TIME = 2e-4
"""Ratio of viscous to elastic forces [s]: 4 % damping of the first mode with 6 kg, 8 % with 0.1 kg."""

EXUDYN_LINE = "Exudyn, ANCF beams"

EXUDYN_STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4)
"""Fixed steps of the generalised-alpha method [s], from which a sweep takes as many as it needs; those of its reference are shorter."""

ELEMENTS = 2
"""Beam elements a link: for the paper's scenes as accurate as the smallest of these steps."""

CONVERGED_ELEMENTS, CONVERGED_STEP = 4, 2.5e-5
"""Exudyn's own reference."""


def exudyn_trials(subject: SceneUnderTest, ours: WorkCurve, announce: Announce) -> Iterator[WorkPrecisionTrial]:
    """The same mechanism by ANCF beam elements; errors are counted from Exudyn's own converged run, since all its links bend
    and stretch whatever the scene chooses, and it has no modal damping."""
    if find_spec("exudyn") is None:
        yield WorkPrecisionTrial(
            "tools", EXUDYN_LINE, "", None, None, "exudyn is not installed: pip install flexfmu[peers]"
        )
        return
    from flexfmu.cosim.studies.workprec.exudyn_peer import ExudynMotion, simulate_exudyn

    # Exudyn's own converged run is what errors are counted from
    scene = comparable(subject.scene)

    def run(step: float, elements: int) -> ExudynMotion:
        announce(f"{EXUDYN_LINE}, step {1e3 * step:g} ms")
        return simulate_exudyn(scene, subject.motion, subject.instants, step, elements)

    try:
        converged = run(CONVERGED_STEP, CONVERGED_ELEMENTS)
    except (SceneError, RunError) as failure:
        yield WorkPrecisionTrial("tools", EXUDYN_LINE, "", None, None, " ".join(str(failure).split()))
        return
    rigid = subject.motion.task.evaluate(subject.instants, 0)[0]
    deviation = float(np.linalg.norm(converged.position - rigid, axis=1).max())

    def trial(step: float) -> WorkPrecisionTrial:
        def measure() -> tuple[float, float, str]:
            motion = run(step, ELEMENTS)
            error = float(np.linalg.norm(motion.position - converged.position, axis=1).max()) / deviation
            return error, motion.time, f"{ELEMENTS} elements a link, from its own converged run"

        return trial_of("tools", EXUDYN_LINE, f"{1e3 * step:g} ms", measure)

    yield from sweep(EXUDYN_STEPS, trial, ours)


def comparable(scene: Scene) -> Scene:
    """Return the scene with stiffness-proportional damping instead of modal damping, which Exudyn lacks."""
    if not isinstance(scene.effects.damping, ModalDampingSection):
        return scene
    return scene.replace({"effects.damping": {"kind": "stiffness", "time": DAMPING_TIME}})
