"""What motors have to do in a run, against what they can: margins, losses and electrical power.

A gear of ratio i and efficiency η transmits the load torque τ as τ / (i η) while power flows into the robot, and as
τ η / i while it flows back; the rotor of inertia J adds J i q̈ (H. Gross, J. Hamann, G. Wiegärtner, *Electrical Feed
Drives in Automation*, 2001, chapter 3; K. A. Pasch, W. P. Seering, On the drive systems for high-performance machines,
J. Mech. Transm. Autom. Des. 106 (1984), 102-108). Between communication points torque, speed and acceleration are the
polynomials of `flexfmu.cosim.metrics.segments`, divided where the power changes its sign; so the torque of the motor is
a polynomial on each piece, of which peaks and integrals are exact.

Polynomials on pieces of time, in Bernstein form: products, cuts at zeros, means and peaks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from flexfmu.cosim.engine.showing import shown_unit
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.segments import bernstein_basis, cut, largest_magnitude
from flexfmu.cosim.metrics.signals import TORQUES, segments
from flexfmu.model.kinematics import load_mass_matrix
from flexfmu.model.scene.motor import Motor

SAMPLES = np.linspace(0.0, 1.0, 17)
"""Normalised times of each piece at which the instant of a peak is looked for."""

POINTS = 3000
"""Approximate number of points of a curve."""


MOTOR_VALUES = (
    ("inertia_ratio", "inertia ratio", ""),
    ("rms_current", "RMS current", "A"),
    ("peak_current", "peak current", "A"),
    ("copper_loss", "copper loss, mean", "W"),
    ("mean_electrical_power", "electrical power, mean", "W"),
    ("peak_electrical_power", "electrical power, peak", "W"),
)
"""Attribute of `MotorLoad`, also in ``summary.json`` → name and unit."""


@dataclass(frozen=True)
class Pieces:
    """Torque and speed of a shaft as polynomials on pieces of time.

    Attributes:
        start, duration: (n,) [s].
        torque, speed: (6, n) Bernstein control points.
    """

    start: RealArray
    duration: RealArray
    torque: RealArray
    speed: RealArray

    @cached_property
    def power(self) -> RealArray:
        """(11, n) control points of the mechanical power."""
        return multiplied(self.torque, self.speed)

    @cached_property
    def square(self) -> RealArray:
        """(11, n) control points of the torque's square."""
        return multiplied(self.torque, self.torque)

    def mean(self, control: RealArray) -> float:
        """Return the mean over time of polynomials: that of their control points."""
        return float(control.mean(axis=0) @ self.duration / self.duration.sum())

    def peak(self, control: RealArray) -> tuple[float, float]:
        """Return the largest magnitude of polynomials, and when it is reached [s]."""
        values = np.abs(_sampled(control))
        sample, piece = np.unravel_index(int(np.argmax(values)), values.shape)
        time = self.start[piece] + SAMPLES[sample] * self.duration[piece]
        return largest_magnitude(control), float(time)

    def highest(self, control: RealArray) -> float:
        """Return the largest value of polynomials."""
        # values above the least are magnitudes
        size = float(np.abs(control).max())
        return largest_magnitude(control + size) - size

    def curves(self) -> dict[str, RealArray]:
        """Return times [s], with speed, torque and power then, about `POINTS` in the order of time."""
        theta = np.linspace(0.0, 1.0, int(np.clip(POINTS // self.start.size, 2, SAMPLES.size)))
        time = (self.start[:, np.newaxis] + np.outer(self.duration, theta)).ravel()
        controls = {"speed": self.speed, "torque": self.torque, "power": self.power}
        return {"time": time} | {name: _sampled(each, theta).T.ravel() for name, each in controls.items()}


def divided(start: RealArray, duration: RealArray, control: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return start, duration and control points (degree + 1, n, c) of pieces in which the first two channels keep their signs."""
    first = control[..., :2]
    # most pieces stay whole
    mixed = np.flatnonzero(((first.min(axis=0) < 0.0) & (first.max(axis=0) > 0.0)).any(axis=-1))
    if not mixed.size:
        return start, duration, control
    plain = np.ones(start.size, dtype=bool)
    plain[mixed] = False
    starts, durations, controls = [start[plain]], [duration[plain]], [control[:, plain]]
    # the others are cut at their zeros, from the left
    for index in mixed.tolist():
        zeros = sorted({0.0, 1.0, *(zero for channel in (0, 1) for zero in _zeros(control[:, index, channel]))})
        rest = control[:, index]
        for low, high in pairwise(zeros):
            piece, rest = cut(rest, (high - low) / (1.0 - low))
            controls.append(piece[:, np.newaxis])
            starts.append(start[index : index + 1] + low * duration[index])
            durations.append((high - low) * duration[index : index + 1])
    order = np.argsort(np.concatenate(starts), kind="stable")
    return np.concatenate(starts)[order], np.concatenate(durations)[order], np.concatenate(controls, axis=1)[:, order]


def _zeros(control: RealArray) -> Iterator[float]:
    """Yield the zeros of a polynomial between 0 and 1, from its Bernstein control points (degree + 1,)."""
    if not (control.min() < 0.0 < control.max()):
        return
    degree = len(control) - 1
    # powers of theta, from differences of the control points
    powers = [math.comb(degree, k) * float(np.diff(control, n=k)[0]) for k in range(degree + 1)]
    size = max(map(abs, powers))
    while powers and abs(powers[-1]) <= 1e-14 * size:
        powers.pop()
    for root in np.polynomial.polynomial.polyroots(powers).tolist():
        if abs(complex(root).imag) < 1e-9 and 1e-9 < complex(root).real < 1.0 - 1e-9:
            yield complex(root).real


def multiplied(first: RealArray, second: RealArray) -> RealArray:
    """Return the control points (2 d + 1, n) of the product of polynomials of degree d with control points (d + 1, n)."""
    degree = len(first) - 1
    product = np.zeros((2 * degree + 1, first.shape[1]))
    for i in range(degree + 1):
        for k in range(degree + 1):
            weight = math.comb(degree, i) * math.comb(degree, k) / math.comb(2 * degree, i + k)
            product[i + k] += weight * first[i] * second[k]
    return product


def _sampled(control: RealArray, theta: RealArray = SAMPLES) -> RealArray:
    """Return the values (k, n) at normalised times of polynomials with control points (degree + 1, n)."""
    return np.asarray(bernstein_basis(theta, len(control) - 1) @ control)


@dataclass(frozen=True)
class MotorLimit:
    """A limit of a motor, and how near the run comes to it.

    Attributes:
        name: `peak torque`, `RMS torque` or `speed`; with a torque-speed curve `torque at speed`, with a thermal time constant `heat`.
        unit: of value and limit.
        value: largest magnitude in the run, at the motor's shaft; of the heat the largest temperature, when the run is repeated for ever,
            relative to that under the continuous torque.
        limit: what the motor can do.
        time: when the value is reached [s]; None for a mean.
        position: the rigid end effector then [m].
    """

    name: str
    unit: str
    value: float
    limit: float
    time: float | None = None
    position: tuple[float, float] | None = None

    @property
    def use(self) -> float:
        """Value / limit; above 1 the limit is exceeded."""
        return self.value / self.limit


@dataclass(frozen=True)
class MotorLoad:
    """The motor of a joint in a run. Torques, speeds and powers are those of its shaft.

    Attributes:
        joint: 1 or 2.
        motor: the motor.
        margins: peak torque, RMS torque and speed, and what the motor's data sheet knows besides.
        inertia_ratio: largest inertia of the load, reflected to the shaft, over that of the rotor; None without a rotor inertia.
        rms_current, peak_current: [A]; None without a torque constant.
        copper_loss: mean loss i² R of the winding [W]; None without a resistance.
        mean_electrical_power: mean of mechanical power and copper loss, power back into the supply counts negative [W];
            None without a resistance.
        peak_electrical_power: its largest value [W].
        time, speed, torque, power: curves (N,) [s, rad/s, N.m, W].
    """

    joint: int
    motor: Motor
    margins: tuple[MotorLimit, ...]
    inertia_ratio: float | None
    rms_current: float | None
    peak_current: float | None
    copper_loss: float | None
    mean_electrical_power: float | None
    peak_electrical_power: float | None
    time: RealArray
    speed: RealArray
    torque: RealArray
    power: RealArray

    @property
    def critical(self) -> MotorLimit:
        """The margin whose limit is nearest or exceeded most."""
        return max(self.margins, key=lambda margin: margin.use)

    @property
    def label(self) -> str:
        """Joint and, where it has one, name of the motor."""
        return f"motor {self.joint}" + (f" ({self.motor.name})" if self.motor.name else "")

    @property
    def exceeded(self) -> Iterator[str]:
        """A sentence for each limit that is exceeded: by how much, when and where."""
        for margin in self.margins:
            if not margin.value <= margin.limit:
                place = ""
                if margin.time is not None and margin.position is not None:
                    x, y = margin.position
                    place = f" at {margin.time:.4g} s, end effector at ({x:.4g}, {y:.4g}) m"
                unit = shown_unit(margin.unit)
                yield (
                    f"{self.label}: {margin.name} of {margin.value:.4g} {unit}{place} exceeds the limit of "
                    f"{margin.limit:g} {unit} by {100.0 * (margin.use - 1.0):.3g} %"
                )


def motor_loads(run: Run, motors: Motor | Sequence[Motor] | None = None) -> tuple[MotorLoad, ...]:
    """Return what the motors of both joints have to do in a run, over the duty cycle; no simulation is needed.

    The torque of a run contains the inertia `effects.motor_inertia` of its scene, which is taken out; that of the rotor is
    put in. So the result is the same whether a scene has that effect or not, as long as the motors follow their motion.

    Args:
        run: with torques, speeds and accelerations of the joints.
        motors: one motor for both joints or one for each; None for those of the scene.

    Returns:
        One for each joint; none for a scene without motors.

    Raises:
        ResultsError: a signal or its derivatives were not recorded.
    """
    if motors is None:
        section = run.scene.motor
        motors = () if section is None else (section.of_joint(0), section.of_joint(1))
    pair = (motors, motors) if isinstance(motors, Motor) else tuple(motors)
    if not pair or run.recording.time.size < 2:
        return ()
    inertia = largest_load_inertia(run)
    return tuple(_load(run, joint, motor, inertia[joint]) for joint, motor in zip((0, 1), pair, strict=True))


def largest_load_inertia(run: Run) -> tuple[float, float]:
    """Return the largest inertia of the load [kg.m2] at each joint, the other motor standing still, among the plan's poses."""
    matrices = load_mass_matrix(run.robot, run.plan.poses)
    return float(matrices[:, 0, 0].max()), float(matrices[:, 1, 1].max())


def inertia_ratios(run: Run) -> tuple[float | None, float | None]:
    """Return the largest inertia ratio of both joints; None without a rotor inertia."""
    section, load = run.scene.motor, largest_load_inertia(run)
    if section is None:
        return None, None
    first, second = (_ratio(section.of_joint(joint), load[joint]) for joint in (0, 1))
    return first, second


def _ratio(motor: Motor, inertia: float) -> float | None:
    rotor = motor.rotor_inertia * motor.gear_ratio**2
    return inertia / rotor if rotor else None


def _load(run: Run, joint: int, motor: Motor, inertia: float) -> MotorLoad:
    """Return what the motor of joint 0 or 1 has to do."""
    # torque, speed and acceleration of the joint; the torque without what the robot's model has of the motor's inertia
    number = joint + 1
    place = f"joint{number}" if f"joint{number}.velocity" in run.recording.columns else f"joint{number}.reference"
    kept = segments(run.recording, [TORQUES[joint], f"{place}.velocity", f"{place}.acceleration"]).consistent
    control, ratio = kept.control.copy(), motor.gear_ratio
    control[..., 0] -= run.robot.effects.motor_inertia * control[..., 2]
    start, duration, control = divided(kept.start, kept.duration, control)
    # at the shaft; the gear's efficiency by the direction of the power, which is the same throughout a piece
    middle = np.tensordot(bernstein_basis(np.array([0.5]), len(control) - 1)[0], control, axes=1)
    power = middle[:, 0] * middle[:, 1]
    factor = np.where(power > 0.0, 1.0 / motor.gear_efficiency, np.where(power < 0.0, motor.gear_efficiency, 1.0))
    at_shaft = control[..., 0] * factor / ratio + motor.rotor_inertia * ratio * control[..., 2]
    pieces = Pieces(start, duration, at_shaft, ratio * control[..., 1])
    (torque, torque_time), (speed, speed_time) = pieces.peak(pieces.torque), pieces.peak(pieces.speed)
    rms = math.sqrt(max(pieces.mean(pieces.square), 0.0))
    margins = [
        MotorLimit("peak torque", "N.m", torque, motor.peak_torque, torque_time, _position(run, torque_time)),
        MotorLimit("RMS torque", "N.m", rms, motor.continuous_torque),
        MotorLimit("speed", "rad/s", speed, motor.maximum_speed, speed_time, _position(run, speed_time)),
    ]
    if motor.torque_speed_curve:
        values = np.abs(_sampled(pieces.torque))
        largest = motor.largest_torque(_sampled(pieces.speed).ravel())[0].reshape(values.shape)
        sample, piece = np.unravel_index(int(np.argmax(values / largest)), values.shape)
        time = float(start[piece] + SAMPLES[sample] * duration[piece])
        worst = float(values[sample, piece]), float(largest[sample, piece])
        margins.append(MotorLimit("torque at speed", "N.m", *worst, time, _position(run, time)))
    if motor.thermal_time_constant is not None:
        heat = _largest_temperature(pieces, motor.thermal_time_constant) / motor.continuous_torque**2
        margins.append(MotorLimit("heat", "1", heat, 1.0))
    # currents, losses i² R and power of the supply
    constant, resistance = motor.torque_constant, motor.winding_resistance
    loss = mean = highest = None
    if constant is not None and resistance is not None:
        electrical = pieces.power + resistance / constant**2 * pieces.square
        loss, mean = resistance * (rms / constant) ** 2, pieces.mean(electrical)
        highest = pieces.highest(electrical)
    return MotorLoad(
        joint=number,
        motor=motor,
        margins=tuple(margins),
        inertia_ratio=_ratio(motor, inertia),
        rms_current=None if constant is None else rms / constant,
        peak_current=None if constant is None else torque / constant,
        copper_loss=loss,
        mean_electrical_power=mean,
        peak_electrical_power=highest,
        **pieces.curves(),
    )


def _largest_temperature(pieces: Pieces, time_constant: float) -> float:
    """Largest value of a first-order lag of the torque's square, when the pieces are repeated for ever [N² m²]."""
    # a piece is short: its mean stands for its course
    squares, keep = pieces.square.mean(axis=0), np.exp(-pieces.duration / time_constant)
    decay, from_rest, now = float(np.prod(keep)), list[float](), 0.0
    for square, each in zip(squares.tolist(), keep.tolist(), strict=True):
        now = each * now + (1.0 - each) * square
        from_rest.append(now)
    start = now / (1.0 - decay)
    return float((np.array(from_rest) + start * np.cumprod(keep)).max(initial=start))


def _position(run: Run, time: float) -> tuple[float, float]:
    x, y = run.plan.task.evaluate(time, 0)[0, 0].tolist()
    return x, y
