"""Iterative learning: a feedforward torque that improves from cycle to cycle of a repeated motion, by a law of weights.

With w_j(k) and e_j(k) the learned torque and the error of sample k in cycle j, all laws are ::

    w_j+1(k) = sum_i W(i) w_j(k + i) + sum_i E(i) e_j(k + i),      w_0 = 0,      e = reference - measurement

so that on a sampled loop with the response P from learned torques to angles the error of a frequency changes from cycle to cycle by
T = W - P E, the contraction: it shrinks where the largest singular value of T is below 1.

- P-type: W = 1 - forgetting, E a gain at i = shift (S. Arimoto, S. Kawamura, F. Miyazaki, Bettering operation of robots by
  learning, J. Robotic Systems 1 (1984) 123; forgetting: S. Arimoto, Int. J. Control 52 (1990)).
- Norm-optimal: E = (P* P + r)^-1 P*, with which w_j+1 minimises |e_j+1|^2 + r |w_j+1 - w_j|^2 (N. Amann, D. H. Owens, E. Rogers, Iterative
  learning control for discrete-time systems with exponential rate of convergence, IEE Proc. D 143 (1996) 217). P changes along the path
  more slowly than it decays, so E is that of places on the path, interpolated between them.
- A Q-filter multiplies W and E by a low-pass Q without phase (D. A. Bristow, M. Tharayil, A. G. Alleyne, A survey of iterative learning
  control, IEEE Control Systems Magazine 26 (2006) 96): it learns nothing where the model isn't known, and leaves the error there.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log2, pi

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import JOINTS, joint_block
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.scene.assembly import motor_angles
from flexfmu.model.scene.controllers import LearningSection
from flexfmu.model.symbolic import SymbolicBlock
from flexfmu.trajectories.trajectory import SAME_TIME, positions_along

MAXIMUM_TABLE = 1_000_000
"""Largest number of samples in a cycle; more are probably a mistake in the cycle's unit."""

PLACES = 1001
"""Number of places that are told apart on the path."""

PROBE = "learning probe"
"""Name of the block that stands for a controller that learns in a loop about standstill."""

ComplexArray = NDArray[np.complex128]

TAIL, FILTER_TAIL = 1e-3, 1e-4
"""Weights of the norm-optimal law and of a Q-filter below this share of the largest one are left out."""

LONGEST_RESPONSE = 1000
"""Largest number of samples of a loop's response that counts."""


@dataclass(frozen=True, eq=False)
class LearningLaw:
    """The weights of the law at the top of this module.

    Attributes:
        torque: W(i) for i = -m .. m, (2 m + 1,).
        error: E(i) for i = ahead - V + 1 .. ahead at S places on the path, equally spaced from its start to its end, (S, V, n, n), for
            learning gains of 1 that multiply its rows.
        ahead: largest i.
        stops: whether errors beyond a cycle's end count as zero; otherwise those of the next cycle follow.
    """

    torque: RealArray
    error: RealArray
    ahead: int
    stops: bool = False

    @property
    def behind(self) -> int:
        """m."""
        return len(self.torque) // 2

    def effects(
        self, response: RealArray, place: float, gain: RealArray, sample_time: float
    ) -> tuple[ComplexArray, ComplexArray, RealArray]:
        """W (F,) and P E (F, n, n) at a place, and frequencies (F,) [Hz], from 0 to half the sampling frequency.

        Args:
            response: P, angles (M, n, n) of the samples after a unit torque of one sample.
            place: where on the path, 0 to 1.
            gain: learning gains (n,).
            sample_time: [s].
        """
        size = _transform_size(LONGEST_RESPONSE, self.error.shape[1], len(self.torque))
        at = np.clip(1.0 - abs(place * (len(self.error) - 1) - np.arange(len(self.error))), 0.0, 1.0)
        error = gain[:, np.newaxis] * np.tensordot(at, self.error, 1)
        # weights are correlated with the future: conjugates, with the phase of their first index
        frequency = np.fft.rfftfreq(size, sample_time)
        turn = np.exp(2j * pi * sample_time * frequency)
        w = np.fft.rfft(self.torque, size).conj() / turn**self.behind
        e = np.fft.rfft(error, size, axis=0).conj() * (turn ** (self.ahead - len(error) + 1))[:, np.newaxis, np.newaxis]
        return w, np.asarray(np.fft.rfft(response, size, axis=0) @ e), np.asarray(frequency)


def proportional_law(shift: int, forgetting: float, q: RealArray, joints: int) -> LearningLaw:
    """The P-type law with a Q-filter's weights q (2 m + 1,), which are (1,) for none."""
    error = q[:, np.newaxis, np.newaxis] * np.eye(joints)
    return LearningLaw((1.0 - forgetting) * q, error[np.newaxis], shift + len(q) // 2, stops=len(q) == 1)


def norm_optimal_law(
    response: RealArray, regularisation: float, forgetting: float, q: RealArray, longest: int
) -> LearningLaw:
    """The norm-optimal law for a response P at S places, (S, M, n, n).

    Args:
        response: angles of the samples after a unit torque of one sample.
        regularisation: r, relative to the largest squared gain of P.
        forgetting: share that is forgotten in each cycle.
        q: weights of the Q-filter, (2 m + 1,).
        longest: largest number of samples that the law looks ahead, and back.
    """
    size = _transform_size(8 * response.shape[1], len(q))
    p = np.fft.rfft(response, size, axis=1)
    r = regularisation * np.linalg.norm(p, 2, axis=(2, 3)).max() ** 2
    adjoint = p.conj().swapaxes(2, 3)
    inverse = np.linalg.solve(adjoint @ p + r * np.eye(p.shape[-1]), adjoint)
    low_pass = np.fft.rfft(q, size) * np.exp(2j * pi * np.arange(size // 2 + 1) / size * (len(q) // 2))
    filtered = inverse * low_pass[:, np.newaxis, np.newaxis]
    # E(i) is the value at -i of the impulse response, kept as far as it matters
    kernel = np.roll(np.fft.irfft(filtered, size, axis=1)[:, ::-1], 1 + size // 2, axis=1)
    sizes = abs(kernel).max(axis=(0, 2, 3))
    far = abs(np.flatnonzero(sizes > TAIL * sizes.max()) - size // 2).max()
    reach = int(max(1, min(far, longest)))
    return LearningLaw((1.0 - forgetting) * q, kernel[:, size // 2 - reach : size // 2 + reach + 1], reach)


def _transform_size(*lengths: int) -> int:
    """Number of samples of a Fourier transform, a power of 2 with eight frequencies within the width of a resonance."""
    return int(max(4096, 2 ** int(np.ceil(log2(8 * max(lengths))))))


def zero_phase(cut_off: float | None, sample_time: float, longest: int) -> RealArray:
    """Weights (2 m + 1,) of a Butterworth low-pass of second order, forward and backward: 1 / (1 + (f / cut-off)^4) without phase.

    Args:
        cut_off: where half of the amplitude is left [Hz]; None for no filter.
        sample_time: [s].
        longest: largest m.

    Raises:
        InputError: the cut-off isn't below half the sampling frequency, or is too low for a cycle.
    """
    if cut_off is None:
        return np.ones(1)
    if not 0.0 < cut_off * sample_time < 0.5:
        raise InputError(
            f"the Q-filter's cut-off must be below half the sampling frequency of {1.0 / sample_time:g} Hz, got {cut_off:g} Hz"
        )
    size = 2 ** int(np.ceil(log2(max(4096.0, 16.0 / (cut_off * sample_time)))))
    # bilinear transform with the cut-off in its place
    with np.errstate(over="ignore"):
        ratio = np.tan(pi * np.arange(size // 2) / size) / np.tan(pi * cut_off * sample_time)
        gains = 1.0 / (1.0 + np.append(ratio, np.inf) ** 4)
    kernel = np.fft.irfft(gains)
    m = int(np.flatnonzero(abs(kernel[: size // 2]) > FILTER_TAIL * kernel[0]).max())
    if m > longest:
        raise InputError(
            f"the Q-filter's cut-off of {cut_off:g} Hz needs {m} samples before and after each, and a cycle leaves {longest}: raise it"
        )
    taps = np.concatenate([kernel[m:0:-1], kernel[: m + 1]])
    return np.asarray(taps / taps.sum())


def _block(
    s: LearningSection, kind: str, what: str, law: LearningLaw, cycle: int, places: RealArray | None
) -> SymbolicBlock:
    """Build the block of a law; places (N,) may be None with a law for one place. A sample's torque is learned ``ahead`` samples later.

    States are the number of the sample within the cycle, and of each joint: torques of the next N samples, of which the last ``ahead``
    haven't learned yet; torques of the m samples before those, as they were; the last V - 1 errors.
    """
    n, ahead, m = len(JOINTS), max(law.ahead, law.behind), law.behind
    gain, unit = (1.0, "1") if places is not None else (1.0 if kind == PROBE else s.gain or (0.0, 0.0), "N.m/rad")
    # errors in the order of time: the last one is the present one
    error = np.pad(law.error, ((0, 0), (0, ahead - law.ahead), (0, 0), (0, 0)))
    count = error.shape[1]
    weights = casadi.sparsify(casadi.DM(error.transpose(0, 2, 3, 1).reshape(len(error) * n, n * count)))
    torque = casadi.DM(law.torque)

    ends = np.cumsum([1, n * cycle, n * m, n * (count - 1)])

    def equations(x: Vector, signals: list[Vector], gains: list[Vector]) -> tuple[Vector, Vector]:
        k, now = x[0], signals[0] - signals[1]
        if law.stops:
            now = casadi.if_else(k >= ahead, now, casadi.MX.zeros(n))
        queues, olds, lasts = (
            [x[first + i * size : first + (i + 1) * size, 0] for i in range(n)]
            for first, size in zip(ends, (cycle, m, count - 1), strict=False)
        )
        errors = [casadi.vertcat(last, now[i]) for i, last in enumerate(lasts)]
        learned = weights @ casadi.vertcat(*errors)
        if len(error) > 1 and places is not None:
            # between two places the laws of both count, the nearer one more
            place = casadi.interpolant("places", "linear", [np.arange(cycle + 1.0)], np.append(after, after[:1]))(k)
            near = casadi.fmax(0.0, 1.0 - casadi.fabs(place * (len(error) - 1) - casadi.DM(range(len(error)))))
            learned = casadi.reshape(learned, n, len(error)) @ near
        moved, kept = [], []
        for i, queue in enumerate(queues):
            # the sample that learns, with the torques before and after it
            around = casadi.vertcat(olds[i], queue[cycle - ahead :, 0], queue[0])
            new = casadi.dot(torque, around[: 2 * m + 1, 0]) + gains[0][i] * learned[i]
            rest = (queue[cycle - ahead + 1 :, 0], queue[0]) if ahead else ()
            moved.append(casadi.vertcat(queue[1 : cycle - ahead, 0], new, *rest))
            kept.append(around[1 : m + 1, 0])
        # the number starts from zero in every cycle
        following = casadi.if_else(k + 1.0 >= cycle, 0.0, k + 1.0)
        memory = [each[1:, 0] for each in errors] if count > 1 else []
        output = casadi.vertcat(*(queue[0] for queue in queues))
        return output, casadi.vertcat(following, *moved, *(kept if m else ()), *memory)

    after = np.zeros(0) if places is None else np.roll(places, ahead)
    return joint_block(
        kind,
        f"{what} over cycles",
        equations,
        ("reference.position", "position"),
        ("feedforward", "Learned torque of {}"),
        {"learning_gain": (gain, unit, "Learning gain")},
        states=[0.0] * int(ends[-1]),
        symbol=casadi.MX,
        **s.sampling,
    )


def samples_in_a_cycle(period: float | None, sample_time: float) -> int:
    """Return the number of samples in a cycle of a repeated motion.

    Args:
        period: of the cycle [s]; None for a motion that isn't repeated.
        sample_time: [s].

    Raises:
        InputError: the motion isn't repeated, or a cycle isn't a whole number of samples.
    """
    if period is None:
        raise InputError(
            "learning needs a motion that is repeated: flexfmu.cosim.experiment.cycles.repeated(plan, cycles)"
        )
    # the queue has one torque for each sample of a cycle
    samples = round(period / sample_time)
    if not 1 <= samples <= MAXIMUM_TABLE:
        raise InputError(f"learning: a cycle must have 1 to {MAXIMUM_TABLE} samples, got {samples}")
    if abs(samples * sample_time - period) > SAME_TIME * period:
        raise InputError(
            f"a cycle of {period} s isn't a whole number of samples of {sample_time} s; choose another dwell, or "
            "repeated(.., sample_time=..), which lengthens it"
        )
    return samples


def law_of(s: LearningSection, cycle: int) -> tuple[LearningLaw, tuple[float, float]]:
    """The law of a section that leaves nothing open, and its gains, for a cycle of so many samples.

    Raises:
        InputError: the lead isn't less than a cycle, or the cut-off doesn't suit the cycle.
    """
    is_proportional, cut_off = s.response is None, None if s.cut_off == "auto" else s.cut_off
    if is_proportional and s.lead >= cycle:
        raise InputError(f"learning: the lead must be 0 to {cycle - 1} samples, less than a cycle, got {s.lead}")
    longest = (cycle - 1 - s.lead) // 2 if is_proportional else max(1, (cycle - 1) // 2)
    taps = zero_phase(cut_off, s.sample_time, longest)
    if is_proportional:
        return proportional_law(s.lead, s.forgetting, taps, len(JOINTS)), s.gain or (1.0, 1.0)
    return norm_optimal_law(np.array(s.response), s.regularisation, s.forgetting, taps, longest), (1.0, 1.0)


@builds(LearningSection)
def learning(s: LearningSection, context: LoopContext) -> SymbolicBlock:
    """Build the block whose output w is the learned feedforward, by the law at the top of this module.

    On a sampled plant with first Markov parameter g = y(lead) of a unit pulse, the P-type law changes the error of a sample from cycle
    to cycle by the factor 1 - forgetting - gain g, whose magnitude must be below 1. Without a Q-filter the errors of the last ``lead``
    samples lie beyond the cycle, so those samples learn nothing. With the norm-optimal law and a right model the error falls by
    r / (|P|^2 + r); a model with the phase of P is enough.

    Every cycle must start from the same state of the plant: repeat a motion that returns to its start. Inputs:
    ``joint1.reference.position`` and ``joint1.position``; output ``joint1.feedforward``, to be added to a controller's torque, without
    direct feedthrough. The gain is tunable: ``joint1.learning_gain``.

    Raises:
        InputError: the motion isn't repeated, a cycle has no whole number of samples, too many or too few of them, or the law is open.
    """
    if context.is_about_rest:
        return _block(s, PROBE, "P-type iterative learning", proportional_law(0, 0.0, np.ones(1), len(JOINTS)), 1, None)
    cycle = samples_in_a_cycle(context.period, s.sample_time)
    if s.cut_off == "auto" or (s.law == "norm-optimal" and s.response is None):
        what = "the cut-off of the Q-filter" if s.cut_off == "auto" else "the `response` of its law"
        raise InputError(
            f"{context.name} leaves {what} open: run the scene with `flexfmu.run`, or choose first, with "
            f"`flexfmu.cosim.design.effects.choice.resolved(scene)`"
        )
    law, _ = law_of(s, cycle)
    if s.response is None:
        return _block(s, "learning", "P-type iterative learning", law, cycle, None)
    places = places_of(context, np.asarray(s.offset + s.sample_time * np.arange(cycle), dtype=float))
    return _block(s, "learning", "Norm-optimal iterative learning", law, cycle, places)


def places_of(context: LoopContext, instants: RealArray) -> RealArray:
    """Where on the path the shaped, repeated motion is at instants (N,) [s]: 0 at its start, 1 at its end (N,)."""
    share = np.linspace(0.0, 1.0, PLACES)
    path = np.array(
        [motor_angles(context.scene.mechanism, each) for each in positions_along(context.along_path, share)]
    )
    joints = context.shaped.evaluate(np.minimum(instants, context.shaped.duration), 0, "left")[0]
    # angles are those of the same configuration, up to whole turns
    nearest = [np.square(np.angle(np.exp(1j * (path - each)))).sum(axis=1).argmin() for each in joints]
    return share[nearest]
