"""The summary of a run as plain data, the content of ``summary.json`` and of the report.

What references for the flexible robot ask of the motors, for `summary.json` and the report.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.engine.master.outcome import Outcome
from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.scene_loop import counted_twice
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import ALL_METRICS
from flexfmu.cosim.metrics.metrics import Metrics
from flexfmu.cosim.metrics.motors import MOTOR_VALUES, motor_loads
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.cosim.metrics.small_deflections import exceeded
from flexfmu.cosim.metrics.stress import link_stresses
from flexfmu.cosim.reports.page import Table
from flexfmu.fmu_build.archive import files_in
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.model.scene.choice import NAMED_FLOOR
from flexfmu.model.scene.effects import CHOOSABLE, LOADS
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.trajectory import Trajectory

JERK_JUMP = 1e-3
"""Jump of the motion's jerk, relative to its largest jerk, above which it counts: smaller ones are rounding."""


def jerk_jump(motion: Trajectory) -> float:
    """Largest jump of the jerk [m/s³] within a motion of the end effector, 0 where there is none but rounding."""
    inner = np.array(motion.breakpoints)
    before, after = (motion.evaluate(inner, 3, side)[3] for side in ("left", "right"))
    largest = max(float(np.abs(before).max()), float(np.abs(after).max()))
    jump = float(np.hypot(*(after - before).T).max())
    return jump if jump > JERK_JUMP * largest else 0.0


def reference_facts(motion: MotionPlan) -> dict[str, float | str]:
    """What the references ask of the motors, and how smooth the motion is; a sentence if its jerk jumps."""
    design, rigid = motion.design, motion.rigid
    assert design is not None
    assert rigid is not None
    jump, largest = jerk_jump(rigid.task), design.largest_jerk
    found: dict[str, float | str] = {
        "knot_spacing": design.motors.duration / design.motors.intervals,
        "lead": 0.5 * (motion.duration - rigid.duration),
        "largest_joint_jerk": largest,
        "jerk_jump": jump,
    }
    if jump:
        found["warning"] = (
            f"the motion's jerk jumps by {jump:.3g} m/s³, so the jerk of the joints, {largest:.3g} rad/s³, grows with closer "
            "knots: smoother or wider blends, or knots further apart, keep it lower"
        )
    return found


COARSE = 1e-5
"""Relative interpolation error of a metric above which the communication step counts as too coarse."""

_DEFLECTIONS = {"bending": "Bending", "axial": "Stretching"}
"""Family of modes → what links do."""

PATH_KEYS = ("lift", "height", "width", "blend", "profile")
"""Keys of the scene's trajectory that describe its path and profile."""

_SHAPES = {"assumed-modes": "assumed mode", "craig-bampton": "static or fixed-interface shape"}
"""Basis → name of its shape functions."""


_LAST = ("gravity", "payload.inertia")
"""Loads that `describe_effects` lists last."""


def summarise(run: Run, measurements: Mapping[str, Metric]) -> dict[str, Any]:
    """Return the content of ``summary.json`` as plain data in SI units.

    Keys:
        scene: the scene with all defaults.
        effects: effect → sentence.
        metrics: name → number, or None for a metric without a value: the companion's, where there was one, else the run's own.
        errors: name → estimated error of that number, or None if unknown.
        own_metrics, own_errors: the same of the run itself, to which the recorded signals belong.
        health: outcome, integrator statistics, basis of the errors, interpolation errors, warnings, deflections beyond linear
            theory, instability of the control loop, numerical errors beyond the tolerance of an automatic choice of effects.
        slaves: name, description, sample time and offset of each slave.
        delays: delay of each connection.
        timing: wall times [s].
        versions: name → version.
        units: recorded signal → unit.
        motion: only for an own motion in place of the scene's: what gives it.
        shaping: only with shapers: added time [s] and deviation of the rigid end effector from its path [m].
        references: only with references for the flexible robot: distance of the knots [s], time before and after the end effector's
            motion [s], largest jerk of the joints [rad/s³], largest jump of the motion's jerk [m/s³], and a sentence on it.
        accuracy: only with ``[accuracy]``: the chosen settings, why, each figure's error by model and numerics, costs beside the
            scene's own settings, the dearest and those for ten times more, and all of it as sentences.
        effect_choice: only with ``select = "auto"``: tolerance, chosen set, estimated errors, errors beside the run of the richest set
            and of what (``scene`` as it runs, or its ``motion`` alone), and contributions.
        cycles: only for a repeated motion: number, period [s] and duration of a single motion [s].
        motors: only with ``[motor]``: margins, losses and power of each motor, and a sentence for each limit that is exceeded.
        stresses: only with ``mechanism.material.yield_strength``: peak stresses of each link, where and when, and its safety factor.
        changes: only with changes on the command line: ``KEY=VALUE`` of each.
        learning: only for a repeated motion driven by torques: period [s] and tracking errors of both joints in each cycle [rad],
            and with `flexfmu run` the contraction of what is learned: factor, frequency [Hz] and place on the path.
    """
    # the scene as plain data, without the keys of a path that the motion doesn't take
    scene, plan = run.scene.model_dump(mode="json", exclude_none=True), run.plan
    for each in scene["controller"]:
        each.pop("response", None)  # thousands of numbers that follow from the rest
    for key in PATH_KEYS if plan.source else ():
        scene["trajectory"].pop(key, None)
    rigid = plan.once.rigid or plan.once
    optional: dict[str, Any] = {
        "accuracy": None if run.accuracy is None else run.accuracy.as_data(),
        "effect_choice": choice_summary(run.scene),
        "motion": plan.source,
        "shaping": {}
        if rigid.task is rigid.along_path
        else {"added_time": rigid.duration - rigid.along_path.duration, "path_deviation": rigid.deviation},
        "references": {} if plan.design is None else reference_facts(plan),
        **_loads(run),
        **_cycles(run),
    }
    parts = asdict(run.timing)
    return {
        "scene": scene,
        "effects": describe_effects(run.scene),
        "metrics": {name: measurement.value for name, measurement in measurements.items()},
        "errors": {name: measurement.error for name, measurement in measurements.items()},
        "own_metrics": {name: each.value if each.own is None else each.own for name, each in measurements.items()},
        "own_errors": {name: each.own_error for name, each in measurements.items()},
        "health": _health(run, measurements),
        **{key: found for key, found in optional.items() if found},
        **system_summary(run),
        "timing": {**parts, "total": sum(parts.values())},
        "versions": dict(versions(run.fmu_path)),
        "units": run.recording.units,
    }


def system_summary(run: Run) -> dict[str, Any]:
    """Return the slaves of a run, and the delays of its connections."""
    names = ("connection", "seconds", "hold", "latency", "average")
    delays = [{name: getattr(each, name) for name in names} | {"description": str(each)} for each in run.delays]
    return {"slaves": [asdict(slave) for slave in run.slaves], "delays": delays}


def title_of(summary: Mapping[str, Any]) -> str:
    """Return the title of a summary: the scene's name, and what was changed on the command line."""
    return ", ".join([summary["scene"]["name"], *summary.get("changes", ())])


def instability(health: Mapping[str, Any]) -> str:
    """Why the loop of a summary is unstable, as its run shows or as it is about rest; empty where it isn't known to be."""
    if health.get("outcome") == Outcome.LOOP_UNSTABLE.name.lower().replace("_", " "):
        return str(health["message"])
    return health.get("unstable_loop") or ("" if health.get("stable", True) else health.get("stability")) or ""


def describe_effects(scene: Scene) -> dict[str, str]:
    """Return effect → sentence for all effects in the scene's model."""
    effects, found = scene.effects, {}
    # elastic links
    for link, (family, what) in product(("proximal", "distal"), _DEFLECTIONS.items()):
        key = f"{link}_{family}"
        modes = getattr(effects, key)
        if modes:
            found[key] = f"{what} of the {link} links: {modes} {_SHAPES[effects.basis]}{'s' if modes > 1 else ''} each"
        if key in effects.quasi_static:
            found[key] += ", deflecting statically"
    if effects.beam == "timoshenko":
        found["beam"] = "Shear and rotary inertia of the links (Timoshenko)"
    if effects.foreshortening:
        exact = effects.foreshortening == "exact"
        text = "Geometrically exact bending" if exact else "Foreshortening of links that bend (geometric stiffening)"
        found["foreshortening"] = text
    # damping and drives, then external loads
    for key in sorted(scene.loads, key=lambda key: _LAST.index(key) if key in _LAST else -1):
        found[key.replace(".", "_")] = LOADS[key].sentence(scene.loads[key])
    if scene.payload.mass:
        found["payload"] = f"Point mass of {scene.payload.mass:g} kg at the end effector"
    return found or {"rigid": "Rigid links without gravity and payload"}


def coarse_metrics(measurements: Mapping[str, Metric]) -> Iterator[str]:
    """Yield the names of the metrics for which the communication step is too coarse."""
    for name, measurement in measurements.items():
        value, error = measurement.value, measurement.interpolation_error
        if value is not None and error > max(COARSE * abs(value), ALL_METRICS[name].negligible):
            yield name


def _health(run: Run, measurements: Mapping[str, Metric]) -> dict[str, Any]:
    time = run.recording.time
    return {
        "outcome": run.outcome.name.lower().replace("_", " "),
        "message": run.message,
        "end_time": float(time[-1]) if len(time) else None,
        "stop_time": run.plan.stop_time,
        "communication_step": run.communication_step,
        "tolerance": run.tolerance,
        "input_order": run.input_order,
        "statistics": dict(run.health.statistics),
        "messages": list(run.health.messages),
        "errors_from": measurements.basis if isinstance(measurements, Metrics) else Metrics.basis,
        "interpolation_errors": {name: measurement.interpolation_error for name, measurement in measurements.items()},
        "warnings": [_warning(run, name, measurements[name]) for name in coarse_metrics(measurements)],
        "large_deflections": exceeded(run),
        "unstable_loop": run.health.unstable_loop if run.completed else None,
        "counted_twice": counted_twice(run.scene),
        "beyond_tolerance": list(_beyond_tolerance(run, measurements)),
    }


def _beyond_tolerance(run: Run, measurements: Mapping[str, Metric]) -> Iterator[str]:
    """Yield a sentence for each metric of an automatic choice whose numerical error is larger than what was asked for."""
    choice = run.scene.effects.choice
    if choice is None:
        return
    for name in filter(measurements.__contains__, choice.of):
        found, peak, info = measurements[name], measurements["peak_position_error"].value, ALL_METRICS[name]
        error, floor = found.own_error, NAMED_FLOOR * (peak or 0.0) if info.unit == "m" else 0.0
        if found.value is not None and error is not None and error > choice.tolerance * max(abs(found.value), floor):
            yield (
                f"{info.label}: the run's own numerical error of {error:.2g} {shown_unit(info.unit)} is more than the "
                f"{100.0 * choice.tolerance:g} % that the choice of effects was asked for; reduce `cosimulation.step`, now "
                f"{run.communication_step:g} s, or `cosimulation.tolerance`, now {run.tolerance:g}"
            )


def _warning(run: Run, name: str, measurement: Metric) -> dict[str, Any]:
    info, error, value = ALL_METRICS[name], measurement.interpolation_error, measurement.value
    relative = f" ({error / abs(value):.1g} of its value)" if value else ""
    sentence = (
        f"{info.label} may be off by about {error:.1g} {shown_unit(info.unit)}{relative}: the communication step of "
        f"{run.communication_step:g} s is too coarse for the highest frequency in this signal; reduce `cosimulation.step`"
    )
    return {"metric": name, "estimated_error": error, "message": sentence}


def _cycles(run: Run) -> dict[str, Any]:
    """Return number and period [s] of cycles, and RMS and largest tracking error of both joints [rad] in each.

    Empty for a motion without repetition; no errors for a robot whose joints follow exactly.
    """
    repetition = run.plan.repetition
    if repetition is None:
        return {}
    found = {"cycles": {"number": repetition.cycles, "period": repetition.period, "motion": repetition.once.duration}}
    errors = [asdict(each) for each in cycle_errors(run.plan, run.recording)]
    return {**found, "learning": {"period": repetition.period, "tracking_errors": errors}} if errors else found


def _loads(run: Run) -> dict[str, Any]:
    """Return what each motor of the scene has to do against what it can, and with a yield strength the peak stresses of the links.

    Of either nothing where not all signals, or not their derivatives, were recorded.
    """
    found = dict[str, Any]()
    with suppress(ResultsError):
        found["motors"] = [
            {
                "joint": load.joint,
                "name": load.motor.name,
                "margins": [{**asdict(margin), "use": margin.use} for margin in load.margins],
                "critical": load.critical.name,
                **{key: getattr(load, key) for key, _, _ in MOTOR_VALUES},
                "exceeded": list(load.exceeded),
            }
            for load in motor_loads(run)
        ]
    with suppress(ResultsError):
        links = link_stresses(run) if run.scene.mechanism.material.yield_strength is not None else ()
        found["stresses"] = [{**asdict(link), "safety": link.safety, "exceeded": list(link.exceeded)} for link in links]
    return found


def choice_summary(scene: Scene) -> dict[str, Any]:
    """Return the automatic choice of effects with the estimated contribution of each; empty without such a choice."""
    choice = scene.effects.choice
    if choice is None:
        return {}

    def named(values: Sequence[float | None]) -> dict[str, float | None]:
        return dict(zip(choice.of, values, strict=True))

    # the choice as a whole, then effect by effect
    return {
        "tolerance": choice.tolerance,
        "of": list(choice.of),
        "chosen": scene.effects.model_dump(mode="json", include=set(CHOOSABLE)),
        "estimated_error": named(choice.error),
        **({} if choice.verified is None else {"verified_error": named(choice.verified)}),
        "verified_in": choice.verified_in,
        "integrator_tolerance": scene.cosimulation.tolerance,
        "effects": [each.model_dump() | {"contribution": named(each.contribution)} for each in choice.effects],
    }


PACKAGES = ("flexfmu", "casadi", "fmpy", "numpy")

_COMPILER = re.compile(rb"(?:GCC: \([^)\0]*\)|clang version) [\w.+-]+")
"""Compiler signatures in binaries (section ``.comment`` of an ELF library)."""


def versions(fmu: Path | None = None) -> Mapping[str, str | None]:
    """Return name → version, None for an unknown one.

    Args:
        fmu: FMU whose compiler is reported as ``compiler``.
    """
    return {
        **{name: _package(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "compiler": None if fmu is None else compiler_of(fmu),
    }


def compiler_of(fmu: Path) -> str | None:
    """Return the compilers of the FMU's binaries by their signatures; None if there are none or the FMU can't be read."""
    try:
        signatures = {found for binary in files_in(fmu, "binaries").values() for found in _COMPILER.findall(binary)}
    except ArchiveError:
        return None
    return ", ".join(sorted(each.decode("ascii", "replace") for each in signatures)) or None


def _package(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def motor_table(motors: Sequence[Mapping[str, Any]]) -> Table:
    """Return value, limit and use of each margin of each motor of a summary, and what its winding and its rotor give."""
    rows = []
    for margins in zip(*(motor["margins"] for motor in motors), strict=True):
        texts = (
            f"{each['value']:.4g} of {each['limit']:g} {shown_unit(each['unit'])}, {100 * each['use']:.0f} %"
            for each in margins
        )
        rows.append([margins[0]["name"], *texts])
    for key, name, unit in MOTOR_VALUES:
        values = [motor[key] for motor in motors]
        if any(value is not None for value in values):
            texts = ("–" if value is None else f"{value:.4g} {shown_unit(unit)}".rstrip() for value in values)
            rows.append([name, *texts])
    heads = (f"Motor {each['joint']}" + (f", {each['name']}" if each["name"] else "") for each in motors)
    return Table("Motors", ["At the shaft", *heads], rows, is_open=True)


STRESS = "Largest stress, place, time, change by the last mode"


def stress_table(links: Sequence[Mapping[str, Any]], title: str = "Stress of the links") -> Table:
    """Return the peak stress of each link of a summary, where and when it is, and the safety factor."""
    rows = []
    for link in links:
        peak, change, safety = link["combined"], link["change"], link["safety"]
        text = "no modes, stress not known"
        if peak is not None:
            text = f"{1e-6 * peak['value']:.4g} MPa at {1e3 * peak['place']:.4g} mm, {peak['time']:.4g} s"
            text += "" if change is None else f", last mode {100.0 * change:.2g} %"
            text += "" if safety is None else f", safety {safety:.3g}"
        rows.append([link["link"], text])
    return Table(title, ["Link", STRESS], rows, texts=1, is_open=True)
