"""The summary of a run as plain data: what ``summary.json`` holds and what the report is made from."""

from __future__ import annotations

import platform
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flexfmu.cosim.experiment.divergence import divergence
from flexfmu.cosim.experiment.planning import deviation
from flexfmu.cosim.metrics.metric_table import ALL_METRICS, Measurement
from flexfmu.cosim.metrics.metrics import Metrics
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.cosim.metrics.small_deflections import exceeded
from flexfmu.model.scene.effects import CHOOSABLE, LOADS
from flexfmu.model.scene.schema import Scene

if TYPE_CHECKING:
    from flexfmu.cosim.engine.master.delays import SignalDelay
    from flexfmu.cosim.experiment.prepared_scene import Run
    from flexfmu.model.scene.schema import Scene


COARSE = 1e-5
"""Estimated interpolation error, relative to a metric's value, from which the communication step counts as too coarse."""

_FAMILIES: Mapping[str, str] = {
    "proximal_bending": "Bending of the proximal links",
    "proximal_axial": "Stretching of the proximal links",
    "distal_bending": "Bending of the distal links",
    "distal_axial": "Stretching of the distal links",
}

_SHAPES = {"assumed-modes": "assumed mode", "craig-bampton": "static or fixed-interface shape"}
"""Basis → what it calls a shape."""


_LAST = ("gravity", "payload.inertia")
"""Loads that `describe_effects` names after the others."""


def summarise(run: Run, measurements: Mapping[str, Measurement]) -> dict[str, Any]:
    """Everything that ``summary.json`` says about a run, as plain data in SI units.

    Keys: ``scene`` (the scene file with its defaults), ``effects`` (effect → sentence), ``metrics`` (name → number or
    None), ``errors`` (name → estimated error, or None where it isn't known), ``health`` (outcome, integrator statistics, what
    the errors are taken from, interpolation errors, warnings, deflections beyond linear theory),
    ``slaves`` (name, description, sample time), ``delays`` (for each connection how late it is), ``timing`` [s],
    ``versions``; with shapers also ``shaping`` (the time that they add [s], how far they lead the rigid end effector off its path [m]), with an automatic choice of effects
    ``effect_choice`` (tolerance, the set, estimated errors and contributions), and with a motion that is repeated
    ``learning`` (period [s] and for each cycle the tracking error of both joints [rad]).
    """
    return {
        "scene": run.scene.model_dump(mode="json", exclude_none=True),
        "effects": describe_effects(run.scene),
        **({"effect_choice": choice} if (choice := choice_summary(run.scene)) else {}),
        "metrics": {name: measurement.value for name, measurement in measurements.items()},
        "errors": {name: measurement.error for name, measurement in measurements.items()},
        "health": _health(run, measurements),
        **_shaping(run),
        **_learning(run),
        "slaves": [asdict(slave) for slave in run.slaves],
        "delays": [_delay(delay) for delay in run.delays],
        "timing": _timing(run),
        "versions": dict(versions(run.fmu_path)),
    }


def describe_effects(scene: Scene) -> dict[str, str]:
    """Effect → sentence, for the effects that the scene's model contains."""
    effects, found = scene.effects, {}
    # elastic links
    for key, what in _FAMILIES.items():
        modes = getattr(effects, key)
        if modes:
            found[key] = f"{what}: {modes} {_SHAPES[effects.basis]}{'s' if modes > 1 else ''} each"
        if key in effects.quasi_static:
            found[key] += ", deflecting statically"
    if effects.beam == "timoshenko":
        found["beam"] = "Shear and rotary inertia of the links (Timoshenko)"
    if effects.foreshortening:
        found["foreshortening"] = "Foreshortening of links that bend (geometric stiffening)"
    # damping and drives, then what acts from outside
    for key in sorted(scene.loads, key=lambda key: _LAST.index(key) if key in _LAST else -1):
        found[key.replace(".", "_")] = LOADS[key].sentence(scene.loads[key])
    if scene.payload.mass:
        found["payload"] = f"Point mass of {scene.payload.mass:g} kg at the end effector"
    return found or {"rigid": "Rigid links without gravity and payload"}


def coarse_metrics(measurements: Mapping[str, Measurement]) -> Iterator[str]:
    """Names of the metrics for which the communication step is too coarse."""
    for name, measurement in measurements.items():
        value, error = measurement.value, measurement.interpolation_error
        if value is not None and error > max(COARSE * abs(value), ALL_METRICS[name].negligible):
            yield name


def _health(run: Run, measurements: Mapping[str, Measurement]) -> dict[str, Any]:
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
        "unstable_loop": divergence(run) if run.completed else None,
    }


def _warning(run: Run, name: str, measurement: Measurement) -> dict[str, Any]:
    info, error, value = ALL_METRICS[name], measurement.interpolation_error, measurement.value
    relative = f" ({error / abs(value):.1g} of its value)" if value else ""
    sentence = (
        f"{info.label} may be off by about {error:.1g} {info.unit}{relative}: the communication step of "
        f"{run.communication_step:g} s is too coarse for the highest frequency in this signal; reduce `cosimulation.step`"
    )
    return {"metric": name, "estimated_error": error, "message": sentence}


def _shaping(run: Run) -> dict[str, Any]:
    """What shapers cost: the time that they add [s], and how far they lead the rigid end effector off its path [m]."""
    motion = run.plan.once
    if motion.task is motion.along_path:
        return {}

    added = motion.duration - motion.along_path.duration
    return {"shaping": {"added_time": added, "path_deviation": deviation(motion)}}


def _learning(run: Run) -> dict[str, Any]:
    """How a repeated motion is followed, cycle by cycle: root mean square and largest error of both joints [rad]."""
    if run.plan.repetition is None:
        return {}

    cycles = [asdict(each) for each in cycle_errors(run.plan, run.recording)]
    return {"learning": {"period": run.plan.repetition.period, "tracking_errors": cycles}}


def _delay(delay: SignalDelay) -> dict[str, Any]:
    """Delay of a signal [s]: at most between source and target, what is held, the source's own, and in all on average."""
    parts = {"hold": delay.hold, "latency": delay.latency, "average": delay.average}
    return {"connection": delay.connection, "seconds": delay.seconds, **parts, "description": str(delay)}


def _timing(run: Run) -> dict[str, float]:
    timing = run.timing
    parts = {"plan": timing.plan, "build": timing.build, "load": timing.load, "simulate": timing.simulate}
    return {**parts, "total": sum(parts.values())}


def chosen_set(scene: Scene) -> dict[str, Any]:
    """The keys of `effects` that are a matter of choice, with the scene's values."""
    return scene.effects.model_dump(mode="json", include=set(CHOOSABLE))


def choice_summary(scene: Scene) -> dict[str, Any]:
    """What was chosen, for what, and what each effect is estimated to be worth; nothing where the scene chose itself."""
    choice = scene.effects.choice
    if choice is None:
        return {}
    # the choice as a whole, then effect by effect
    return {
        "tolerance": choice.tolerance,
        "of": list(choice.of),
        "chosen": chosen_set(scene),
        "estimated_error": dict(zip(choice.of, choice.error, strict=True)),
        "integrator_tolerance": scene.cosimulation.tolerance,
        "effects": [
            {
                "effect": each.effect,
                "change": each.change,
                "chosen": each.chosen,
                "contribution": dict(zip(choice.of, each.contribution, strict=True)),
            }
            for each in choice.effects
        ],
    }


PACKAGES = ("flexfmu", "casadi", "fmpy", "numpy")

_COMPILER = re.compile(rb"GCC: \([^)\0]*\) [\w.+-]+|(?:\w+ )?clang version [\w.+-]+|Apple clang version [\w.+-]+")
"""How compilers sign what they make (section ``.comment`` of an ELF library)."""


def versions(fmu: Path | None = None) -> Mapping[str, str | None]:
    """Versions by name; None where one can't be found out.

    Args:
        fmu: the FMU whose compiler is named under ``compiler``.
    """
    return {
        **{name: _package(name) for name in PACKAGES},
        "python": platform.python_version(),
        "platform": platform.platform(),
        "compiler": None if fmu is None else compiler_of(fmu),
    }


def compiler_of(fmu: Path) -> str | None:
    """The compiler that made the FMU's library for this machine, by its own signature in the file; None if unsigned."""
    try:
        with zipfile.ZipFile(fmu) as archive:
            libraries = [name for name in archive.namelist() if name.startswith("binaries/") and not name.endswith("/")]
            signatures = [match for name in libraries for match in _COMPILER.findall(archive.read(name))]
    except (OSError, zipfile.BadZipFile):
        return None
    return ", ".join(sorted({signature.decode("ascii", "replace") for signature in signatures})) or None


def _package(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
