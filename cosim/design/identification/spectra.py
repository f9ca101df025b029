"""Experiments about an equilibrium: a measured frequency response, or measured modes, beside those of the linearised robot.

A response is compared by real and imaginary part, in units of its standard errors: for normal errors that is maximum likelihood (R. Pintelon,
J. Schoukens, *System Identification: A Frequency Domain Approach*, 2012, chapter 9). Where a file has none, they follow from the
coherence, or are proportional to the magnitude. Measured modes belong to those of the model whose frequencies are nearest, one to one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from flexfmu.cosim.design.identification.measurements import CURRENTS, STRAIN, Channel, Experiment, names_in, parts_of
from flexfmu.cosim.design.margins.linear_loop import open_loop
from flexfmu.cosim.design.response.response import PARTS, PER_SECOND, FrequencyResponse, Modes
from flexfmu.cosim.engine.errors import InputError, SignalFileError, suggestion
from flexfmu.cosim.engine.measured import Mapped, table_of
from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.contract import LinearPlant
from flexfmu.model.linear import plant_of, signal_label, varied_plant, without_coulomb_friction
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import OSCILLATING
from flexfmu.trajectories.trajectory import positions_along

LEAST_ERROR = 1e-9
"""Smallest standard error of a response, relative to its largest magnitude."""

COHERENCE = 1e-6, 1.0 - 1e-6
"""Between which a coherence tells errors."""

RATES = ("position", "velocity", "acceleration")
"""What moves a joint of a motion-driven robot, each the derivative of the one before."""

FINE = 16.0
"""Delays that are tried, in a period of the highest frequency."""

AXIS = "frequency [Hz]"

PER_ONE: Mapping[str, float] = {"1": 1.0, "%": 0.01}

MODE_COLUMNS = {"frequency": "Hz", "frequency_error": "Hz", "damping_ratio": "1", "damping_ratio_error": "1"}
"""Column of a table of modes → unit."""


ModeTable = Mapping[str, RealArray]
"""Measured modes, the lowest first: columns of `MODE_COLUMNS`, (N,) each: ``frequency``, and what else is known."""


def as_spectrum(log: object, mapping: Mapping[str, Mapped]) -> FrequencyResponse | ModeTable | None:
    """The frequency response or the modes that a log is; None for signals over time and for metrics.

    A file with frequencies and without a time is one of them: modes, if it has damping ratios or frequencies alone.

    Raises:
        InputError, SignalFileError: the file can't be used; the message says why.
    """
    if isinstance(log, FrequencyResponse):
        return log
    if isinstance(log, Modes):
        rows = log.rows()
        known = {key: np.array([row[key] for row in rows], float) for key in MODE_COLUMNS}
        return _modes("the modes", known, range(1, len(rows) + 1))
    if not isinstance(log, str | Path) or not (path := Path(log)).is_file():
        return None
    if path.suffix == ".mat":
        try:
            return FrequencyResponse.read(path)
        except SignalFileError:
            return None
    names = {each.lower() for each in names_in(path)} if path.suffix == ".csv" else set[str]()
    has_time = {"time", "t"} & names or any(each.signal == "time" for each in mapping.values())
    if has_time or not names & {*PARTS["frequency"]}:
        return None
    if "damping_ratio" not in names and not names <= {*MODE_COLUMNS}:
        return FrequencyResponse.read(path)
    table, columns = table_of(path), dict[str, RealArray]()
    for name, values in table.table.items():
        if (key := name.lower()) in MODE_COLUMNS:
            factors, unit = PER_SECOND if MODE_COLUMNS[key] == "Hz" else PER_ONE, table.units[name] or MODE_COLUMNS[key]
            if unit not in factors:
                raise InputError(f"{path}: {name} has the unit {unit!r}; it needs one of {', '.join(factors)}")
            columns[key] = values * factors[unit]
    return _modes(str(path), columns, table.places)


def _modes(source: str, columns: Mapping[str, RealArray], places: Sequence[int]) -> ModeTable:
    """The modes of a source in these columns, whose rows have places (N,).

    Raises:
        InputError: there is none, or a value isn't positive.
    """
    if not columns.get("frequency", np.zeros(0)).size:
        raise InputError(
            f"{source} has no modes: give each a row with its `frequency`, and `damping_ratio` if it is known"
        )
    for key, values in columns.items():
        if (wrong := ~((values > 0.0) & np.isfinite(values))).any():
            at, unit = int(np.argmax(wrong)), MODE_COLUMNS[key].strip("1")
            raise InputError(
                f"{source}, line {places[at]}: {key} must be above 0, got {f'{values[at]:g} {unit}'.strip()}: leave out the row or the column"
            )
    order = np.argsort(columns["frequency"])
    return {key: values[order] for key, values in columns.items()}


def spectrum_experiment(
    scene: Scene,
    measured: FrequencyResponse | ModeTable,
    mapping: Mapping[str, Mapped],
    pose: Sequence[float] | None,
    *,
    name: str,
) -> Experiment:
    """Return the experiment of a response or of modes with the robot's small motions; motion drive locks the motors.

    Dry friction is left out, as for margins.

    Args:
        scene: the scene, with what belongs to this log alone.
        measured: the response or the modes.
        mapping: input or output of a response → what it is.
        pose: x, y of the rigid end effector [m]; None for the end of the path.
        name: of the log, for messages.

    Raises:
        InputError: a signal isn't known, the robot can't reach the pose, or the model has no such frequencies.
    """
    robot = without_coulomb_friction(scene)
    place = positions_along(plan(scene).once.along_path, 1.0)[0].tolist() if pose is None else pose

    def plant(variant: Mapping[str, float]) -> LinearPlant:
        try:
            x, y = (float(each) for each in place)
            joints = np.array(motor_angles(scene_with_parameters(robot, variant).mechanism, (x, y)))
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: the robot can't stand at pose = {place}, x and y in m: {error}") from None
        return varied_plant(
            robot, joints, {key: each for key, each in variant.items() if key != "joint_friction.coulomb"}
        )

    first = plant({})
    known, is_rigid = _frequencies(first)[0], plant_of(robot).degrees_of_freedom == plant_of(robot).locked
    if not isinstance(measured, FrequencyResponse):
        frequency, channels = measured["frequency"], _mode_channels(measured)
        if len(frequency) > len(known):
            raise InputError(
                f"{name} has {len(frequency)} modes, {scene.name} has {len(known)} that oscillate: leave out the others"
            )
        evaluated = _mode_values(frequency)
    else:
        frequency = measured.frequency
        channels, evaluated = _response(scene, measured, mapping, first, name)
        limits = {"the highest mode of the model": np.inf if is_rigid or not known.size else known[-1]}
        limits |= {"half of the sample rate": 0.5 / measured.sample_time} if measured.sample_time else {}
        what = min(limits, key=lambda each: limits[each])
        if frequency[-1] > limits[what] * (1.0 + LEAST_ERROR):
            raise InputError(
                f"{name} goes to {frequency[-1]:g} Hz, {what} is at {limits[what]:g} Hz: leave out what is above"
            )

    def simulate(variants: Sequence[Mapping[str, float]]) -> list[Recording]:
        return [Recording(frequency, evaluated(plant(variant))) for variant in variants]

    return Experiment(
        name, channels, simulate, np.inf, True, scene, is_table=not isinstance(measured, FrequencyResponse)
    )


def delay_of_response(experiment: Experiment, run: Recording) -> float:
    """First delay of a measured response [s]: with it, phases agree best with those of a simulated one."""
    pairs = list[tuple[RealArray, RealArray]]()
    for real, imaginary in zip(experiment.channels[::2], experiment.channels[1::2], strict=True):
        simulated = [each.simulated(run, 0.0)[0] for each in (real, imaginary)]
        pairs.append((real.values + 1j * imaginary.values, simulated[0] + 1j * simulated[1]))
    turned = sum(np.exp(1j * (np.angle(one) - np.angle(other))) for one, other in pairs)
    frequency = experiment.channels[0].time
    most, step = 0.25 / float(np.median(np.diff(frequency))), 1.0 / (FINE * frequency[-1])
    delays = step * np.arange(-int(most / step), int(most / step) + 1)
    agreement = [float((turned * np.exp(2j * pi * frequency * each)).real.sum()) for each in delays]
    return float(delays[np.argmax(agreement)])


def _frequencies(plant: LinearPlant) -> tuple[RealArray, RealArray]:
    """Frequencies [Hz], ascending, and damping ratios of the modes that oscillate."""
    poles = np.linalg.eigvals(plant.a).astype(complex)
    poles = poles[poles.imag > OSCILLATING * np.abs(poles)]
    poles = poles[np.argsort(np.abs(poles))]
    return np.abs(poles) / (2.0 * pi), -poles.real / np.abs(poles)


def _channel(
    name: str,
    unit: str,
    of: str,
    frequency: RealArray,
    values: RealArray,
    errors: RealArray,
    part: complex,
    least: float = 0.0,
) -> Channel:
    """Values (N,) over frequencies, with their errors."""
    pieces = (slice(0, len(values)),)
    return Channel(name, unit, {of: 1.0}, frequency, values, pieces, 1.0, part, errors, least, AXIS)


def _mode_channels(measured: ModeTable) -> tuple[Channel, ...]:
    """Frequencies and damping ratios, with their standard errors or in terms of their sizes."""
    found, frequency = list[Channel](), measured["frequency"]
    for key in ("frequency", "damping_ratio"):
        if (values := measured.get(key)) is not None:
            errors = measured.get(f"{key}_error")
            least, scale = (0.0, values) if errors is None else (1.0, errors)
            found.append(_channel(key, MODE_COLUMNS[key], key, frequency, values, scale, 1.0, least))
    return tuple(found)


def _mode_values(measured: RealArray) -> Callable[[LinearPlant], dict[str, Column]]:
    """Frequencies [Hz] and damping ratios of the model's modes that belong to measured ones (N,)."""

    def evaluated(plant: LinearPlant) -> dict[str, Column]:
        frequencies, ratios = _frequencies(plant)
        _, own = linear_sum_assignment(np.abs(np.log(measured[:, np.newaxis] / frequencies)))
        return {"frequency": Column("Hz", frequencies[own]), "damping_ratio": Column("1", ratios[own])}

    return evaluated


def _response(
    scene: Scene, measured: FrequencyResponse, mapping: Mapping[str, Mapped], plant: LinearPlant, name: str
) -> tuple[tuple[Channel, ...], Callable[[LinearPlant], dict[str, Column]]]:
    """Channels of a response, and what a plant's is in their place."""
    frequency, step = measured.frequency, measured.sample_time
    moved = scene.cosimulation.drive == "motion"
    if moved and step is not None:
        raise InputError(
            f'{name} is of inputs held for {1e3 * step:g} ms, as torques are: {scene.name} needs `cosimulation.drive` = "torque"'
        )
    rows = [_signal(each, mapping, scene, plant.outputs, f"output of {name}") for each in measured.outputs]
    columns = [_signal(each, mapping, scene, plant.inputs, f"input of {name}") for each in measured.inputs]
    units = dict.fromkeys(CURRENTS, "A") | {
        each.name: each.unit for each in (*plant_of(scene).inputs, *plant_of(scene).outputs)
    }
    s = 2j * pi * frequency
    taken = np.zeros((len(frequency) if moved else 1, len(plant.inputs), len(columns)), complex)
    for k, (_, parts, _) in enumerate(columns):
        for part, factor in parts.items():
            # a reference moves position, velocity and acceleration at once
            joint, _, kind = part.rpartition(".")
            for order, rate in enumerate(RATES) if moved else ():
                taken[:, plant.inputs.index(f"{joint}.{rate}"), k] = s ** (order - RATES.index(kind)) / factor
            if not moved:
                taken[:, plant.inputs.index(part), k] = 1.0 / factor
    picked = np.array([[parts.get(each, 0.0) for each in plant.outputs] for _, parts, _ in rows])

    def evaluated(plant: LinearPlant) -> dict[str, Column]:
        loop = open_loop(plant.a, plant.b, plant.c, plant.d, step)
        values: Any = picked @ loop.transfer(np.asarray(s if step is None else np.exp(s * step), complex), taken)
        return {pair: Column(unit, values[:, o, i]) for (pair, unit), (o, i) in zip(pairs, places, strict=True)}

    places = [*product(range(len(rows)), range(len(columns)))]
    pairs, channels = list[tuple[str, str]](), list[Channel]()
    for o, i in places:
        pair = f"{rows[o][0]}/{columns[i][0]}"
        unit = f"{units.get(rows[o][0], '1')}/({units.get(columns[i][0], '1')})"
        factor = rows[o][2] / columns[i][2]
        values, size = factor * measured.response[:, o, i], np.abs(factor * measured.response[:, o, i])
        errors = size
        if measured.standard_error is not None:
            errors = abs(factor) * measured.standard_error[:, o, i]
        elif measured.coherence is not None:
            share = np.clip(measured.coherence[:, o], *COHERENCE)
            errors = size * np.sqrt((1.0 - share) / share)
        errors = np.maximum(errors, LEAST_ERROR * size.max() or 1.0)
        for text, turn in (("real", 1.0), ("imaginary", -1j)):
            channels.append(_channel(f"{pair} {text}", unit, pair, frequency, (turn * values).real, errors, turn))
        pairs.append((pair, unit))
    return tuple(channels), evaluated


def _signal(
    given: str, mapping: Mapping[str, Mapped], scene: Scene, available: Sequence[str], what: str
) -> tuple[str, dict[str, float], float]:
    """Name of a signal of a response, the plant's signals that it is the sum of, and the factor to SI units.

    Raises:
        InputError: the plant has no such signal.
    """
    meaning = mapping.get(given, Mapped(given))
    labels = {signal_label(each): each for each in available}
    labels |= {label.replace("_reference", ""): each for label, each in labels.items()}
    name = labels.get(signal_label(meaning.signal), meaning.signal)
    has_current = scene.motor is not None and scene.motor.torque_constant is not None and name in CURRENTS
    parts = parts_of(name, scene, {}) if STRAIN.fullmatch(name) or has_current else {name: 1.0}
    if parts.keys() - set(available):
        raise InputError(
            f"{what} is {name!r}, which {scene.name} with {scene.cosimulation.drive} drive lacks: map it, "
            f'--map "{given}={available[0]}" for example; {suggestion(name, available)}'
        )
    return name, parts, 1.0 if meaning.factor is None else meaning.factor
