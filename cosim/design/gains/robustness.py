"""The same loop with other robots: controllers, shapers and plan assume the scene's."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TypeVar

from flexfmu.cosim.design.identification.result import Identification
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.metric import Metric
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.metrics.metric_table import metric
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.model.scene.imperfections import PayloadErrorSection
from flexfmu.model.scene.schema import Scene

Key = TypeVar("Key")

PayloadBand = float | tuple[float, float]
"""A fraction to both sides, 0.2 for 20 %, or the lightest and the heaviest payload [kg]."""


def parse_band(text: str) -> PayloadBand:
    """Return the band that an option stands for, ``0.2`` or ``4,8``, or the payload's interval in an ``identified.json``.

    Raises:
        InputError: it is neither a fraction nor two masses, or the file has no payload.
    """
    if text.endswith(".json"):
        return Identification.read(text).band("payload.mass")
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if not 1 <= len(numbers) <= 2:
        raise InputError(
            f"a payload band is a fraction, 0.2, two masses in kg, 4,8, or an identified.json; got {text!r}"
        )
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def band_masses(scene: Scene, band: PayloadBand) -> tuple[float, float]:
    """Return the robot's lightest and heaviest payload [kg]; a fraction is that of the robot's own, payload errors included.

    Raises:
        InputError: the fraction isn't above 0 and below 1, masses are negative or don't ascend, or the scene has no payload.
    """
    if isinstance(band, tuple):
        low, high = band
        if not 0.0 <= low < high < float("inf"):
            raise InputError(
                f"a payload band goes from the lightest to the heaviest payload in kg, got {low:g} to {high:g}"
            )
        return band
    if not 0.0 < band < 1.0:
        raise InputError(f"a payload band is a fraction above 0 and below 1, 0.2 for 20 % to both sides, got {band:g}")
    mass = scene.payload.mass
    for each in scene.imperfection:
        if isinstance(each, PayloadErrorSection):
            mass = scene.payload.mass * (1.0 + each.relative)
    if mass == 0.0:
        raise InputError(f"scene {scene.name} has no payload: give the band in kg, 0,2 for example")
    return (1.0 - band) * mass, (1.0 + band) * mass


def robustness(
    prepared: PreparedScene,
    robots: Mapping[Key, Mapping[str, float]],
    names: Collection[str],
    done: Callable[[float], None] = lambda fraction: None,
) -> tuple[dict[str, Metric], dict[Key, str]]:
    """Run a loop with several robots; return the largest value of each metric, and why runs failed.

    Args:
        prepared: the scene.
        robots: parameters of each robot's FMU; the loop keeps those of the scene.
        names: of the metrics.
        done: is called with the finished fraction.

    Raises:
        ResultsError: a metric needs signals that aren't recorded.
        EquilibriumError: the end pose has no static equilibrium.
    """
    found, failures = list[Mapping[str, float | None]](), dict[Key, str]()
    for number, (key, robot) in enumerate(robots.items()):
        run = prepared.run(robot, lambda fraction, number=number: done((number + fraction) / len(robots)))  # type: ignore[misc]
        if reason := failure_of(run):
            failures[key] = reason
        else:
            found.append(metrics_of(run, names))
    return {
        name: metric(name, None if failures else largest([each[name] for each in found])) for name in names
    }, failures


def failure_of(run: Run) -> str:
    """Return why a run is worth nothing: it failed, or its loop diverged; empty where it is worth something."""
    return (run.health.unstable_loop or "") if run.completed else run.message


def largest(values: Collection[float | None]) -> float | None:
    """Return the largest value; None if one is missing."""
    known = [each for each in values if each is not None]
    return max(known) if len(known) == len(values) else None
