"""Iterative learning: a feedforward torque that improves from cycle to cycle of a repeated motion; its laws: `learning_laws`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Unpack

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.equations import Vector
from flexfmu.cosim.control.controllers.joints import JOINTS, JointOptions, JointQuantity, PerJoint, joint_block
from flexfmu.cosim.control.controllers.learning_laws import LearningLaw, norm_optimal_law, proportional_law, zero_phase
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

GAIN_UNITS: Mapping[JointQuantity, str] = {"position": "N.m/rad", "velocity": "N.m.s/rad", "acceleration": "N.m.s2/rad"}
"""Quantity whose error is learned from → unit of the learning gain."""


PROBE = "learning probe"
"""Name of the block that stands for a controller that learns in a loop about standstill."""


def iterative_learning(
    gain: PerJoint,
    cycle: int,
    *,
    shift: int = 1,
    forgetting: float = 0.0,
    q_filter: float | None = None,
    learn_from: JointQuantity = "position",
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block whose output w is the learned feedforward: for each joint, cycle j and sample k = 0 .. N - 1 ::

        w_j+1(k) = Q ((1 - forgetting) w_j(k) + gain * e_j(k + shift)),      w_0 = 0,      e = reference - measurement

    On a sampled plant with first Markov parameter g = y(shift) of a unit pulse, the error of a sample changes from cycle to cycle by the
    factor 1 - forgetting - gain g, whose magnitude must be below 1; with `LearningLaw.contraction` below 1 the error of the whole
    cycle shrinks. Without a Q-filter the errors of the last ``shift`` samples lie beyond the cycle, so those samples learn nothing.

    Every cycle must start from the same state of the plant: repeat a motion that returns to its start. Inputs:
    ``joint1.reference.position`` and ``joint1.position`` (or ``velocity``); output ``joint1.feedforward``, to be added
    to a controller's torque, without direct feedthrough. The gain is tunable: ``joint1.learning_gain``.

    Args:
        gain: learning gain [N.m/rad] (or [N.m.s/rad] for velocities).
        cycle: N, samples in a cycle.
        shift: samples from a torque to the error that it causes; 1 for a sampled plant without direct feedthrough.
        forgetting: share that is forgotten in each cycle, from 0 to below 1; a few percent add robustness and leave an
            error.
        q_filter: cut-off of the low-pass without phase, `zero_phase` [Hz]; None for none.
        learn_from: quantity whose error is learned from: ``position``, ``velocity`` or ``acceleration``.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: cycle, shift, forgetting, a gain, the cut-off or the sample time is out of range.
    """
    name, joints = _check_cycle(cycle, forgetting, options)
    if shift != int(shift) or not 0 <= shift < cycle:
        raise InputError(f"{name}: the shift must be 0 to {cycle - 1} samples, less than a cycle, got {shift}")
    taps = zero_phase(q_filter, options["sample_time"], (cycle - 1 - shift) // 2)
    law = proportional_law(shift, forgetting, taps, len(joints))
    unit = GAIN_UNITS[learn_from]
    return _block("P-type iterative learning", law, cycle, None, (gain, unit), learn_from, **options)


def norm_optimal_learning(
    response: RealArray,
    places: RealArray,
    *,
    regularisation: float = 1e-3,
    forgetting: float = 0.0,
    q_filter: float | None = None,
    gain: PerJoint = 1.0,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block that learns by the norm-optimal law of `learning_laws`; signals as for `iterative_learning`.

    It learns from angles. With a right model the error falls in each cycle by r / (|P|^2 + r); a model with the phase of P is enough.

    Args:
        response: P at S places on the path, equally spaced from its start to its end: angles [rad/(N.m)] of the samples after a torque
            of 1 N.m of one sample, (S, M, n, n).
        places: where on the path the robot is at each sample of a cycle, 0 to 1 (N,).
        sample_time: time between samples [s].
        offset: first sample instant [s].
        regularisation: r, relative to the largest squared gain of P.
        forgetting, q_filter: as for `iterative_learning`.
        gain: factor of what is learned from a cycle, ``joint1.learning_gain``.
        options: ``sample_time`` [s], ``offset`` [s], ``joints``, ``name``.

    Raises:
        InputError: an argument is out of range, or the response has another shape or isn't finite.
    """
    cycle, shape = len(places), response.shape
    name, joints = _check_cycle(cycle, forgetting, options)
    n = len(joints)
    fits = len(shape) == 4 and shape[1] > 0 and shape[2:] == (n, n)
    if not (fits and np.isfinite(response).all() and response.any()):
        raise InputError(
            f"{name}: the response must be finite angles of {n} joints after torques of {n} joints, (places, samples, {n}, {n}), got shape {shape}"
        )
    if not (isfinite(regularisation) and regularisation > 0.0):
        raise InputError(f"{name}: the regularisation must be above 0, got {regularisation}")
    longest = max(1, (cycle - 1) // 2)
    taps = zero_phase(q_filter, options["sample_time"], longest)
    law = norm_optimal_law(response, regularisation, forgetting, taps, longest)
    return _block("Norm-optimal iterative learning", law, cycle, places, (gain, "1"), "position", **options)


def _check_cycle(cycle: int, forgetting: float, options: JointOptions) -> tuple[str, Sequence[str]]:
    """Check number of samples and forgetting; return the block's name and its joints. Errors as above."""
    name = options.get("name", "learning")
    if cycle != int(cycle) or not 1 <= cycle <= MAXIMUM_TABLE:
        raise InputError(f"{name}: a cycle must have 1 to {MAXIMUM_TABLE} samples, got {cycle}")
    if not (isfinite(forgetting) and 0.0 <= forgetting < 1.0):
        raise InputError(f"{name}: the forgetting must be at least 0 and below 1, got {forgetting}")
    return name, options.get("joints", JOINTS)


def _block(
    what: str,
    law: LearningLaw,
    cycle: int,
    places: RealArray | None,
    gain: tuple[PerJoint, str],
    learn_from: JointQuantity,
    **options: Unpack[JointOptions],
) -> SymbolicBlock:
    """Build the block of a law; places (N,) may be None with a law for one place. A sample's torque is learned ``ahead`` samples later.

    States are the number of the sample within the cycle, and of each joint: torques of the next N samples, of which the last ``ahead``
    haven't learned yet; torques of the m samples before those, as they were; the last V - 1 errors.
    """
    n, ahead, m = len(options.get("joints", JOINTS)), max(law.ahead, law.behind), law.behind
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
        "learning",
        f"{what} over cycles",
        equations,
        (f"reference.{learn_from}", learn_from),
        ("feedforward", "Learned torque of {}"),
        {"learning_gain": (*gain, "Learning gain")},
        states=[0.0] * int(ends[-1]),
        symbol=casadi.MX,
        **options,
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
    if abs(samples * sample_time - period) > SAME_TIME * period:
        raise InputError(
            f"a cycle of {period} s isn't a whole number of samples of {sample_time} s; choose another dwell, or "
            "repeated(.., sample_time=..), which lengthens it"
        )
    return samples


def law_of(section: LearningSection, cycle: int) -> tuple[LearningLaw, tuple[float, float]]:
    """The law of a section that leaves nothing open, and its gains, for a cycle of so many samples; errors as above."""
    s, cut_off = section, None if section.cut_off == "auto" else section.cut_off
    if s.response is None:
        taps = zero_phase(cut_off, s.sample_time, (cycle - 1 - s.lead) // 2)
        return proportional_law(s.lead, s.forgetting, taps, len(JOINTS)), s.gain or (1.0, 1.0)
    longest = (cycle - 1) // 2
    taps = zero_phase(cut_off, s.sample_time, longest)
    return norm_optimal_law(np.array(s.response), s.regularisation, s.forgetting, taps, longest), (1.0, 1.0)


@builds(LearningSection)
def _from_section(s: LearningSection, context: LoopContext) -> SymbolicBlock:
    if context.is_about_rest:
        return iterative_learning(1.0, 1, shift=0, name=PROBE, **s.sampling)
    cycle = samples_in_a_cycle(context.period, s.sample_time)
    if s.cut_off == "auto" or (s.law == "norm-optimal" and s.response is None):
        what = "the cut-off of the Q-filter" if s.cut_off == "auto" else "the `response` of its law"
        raise InputError(
            f"{context.name} leaves {what} open: run the scene with `flexfmu.run`, or choose first, with "
            f"`flexfmu.cosim.design.effects.choice.resolved(scene)`"
        )
    if s.response is None:
        gain, lost = s.gain or (0.0, 0.0), s.forgetting
        return iterative_learning(gain, cycle, shift=s.lead, forgetting=lost, q_filter=s.cut_off, **s.sampling)
    return norm_optimal_learning(
        np.array(s.response),
        places_of(context, np.asarray(s.offset + s.sample_time * np.arange(cycle), dtype=float)),
        regularisation=s.regularisation,
        forgetting=s.forgetting,
        q_filter=s.cut_off,
        **s.sampling,
    )


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
