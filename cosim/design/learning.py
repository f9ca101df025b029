"""Controllers that learn from cycle to cycle, judged and completed before the run from the linear loop along the path.

At a pose, the response from learned torques to measured angles is that of the scene's linear loop, cut at the controller that learns:
what is fed in reaches the loop as its torques did, what comes back is what it measured. From the response follow the contraction (see
`flexfmu.cosim.control.controllers.iterative_learning`), the Q-filter's cut-off and the norm-optimal law.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import atan, ceil, isfinite, log, pi
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.iterative_learning import (
    LONGEST_RESPONSE,
    PROBE,
    LearningLaw,
    law_of,
    samples_in_a_cycle,
)
from flexfmu.cosim.design.margins.linear_blocks import LinearBlock
from flexfmu.cosim.design.margins.linear_loop import Continuous, LinearLoop
from flexfmu.cosim.design.margins.scene_loop import WiredLoop
from flexfmu.cosim.engine.errors import CosimError, InputError, LearningWarning
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.model.one_thread import one_blas_thread
from flexfmu.model.scene.errors import EquilibriumError, SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.jets import RealArray
from flexfmu.trajectories.trajectory import positions_along

PLACES = 9
"""Number of places on the path of the norm-optimal law."""

COARSE, HALVINGS = 5, 3
"""Number of places at which the contraction is calculated first, and how often their distance is halved about the worst."""

LATE = 2
"""Samples by which what comes back from the cut loop is later than the response."""

DECAYED = 1e-4
"""Share of its largest value below which a response has ended."""

CLOSE = 1e-4
"""Contraction above 1 that counts as rounding: errors of frequencies that nothing is learned of."""

LOWEST = 8.0
"""Least number of periods of a Q-filter's cut-off in a cycle."""

SHARE = 0.8
"""Cut-off of a chosen Q-filter, relative to the highest with which no error grows: half of the distance to 1 is left, about."""


@dataclass(frozen=True)
class Contraction:
    """By how much errors change from cycle to cycle, at worst.

    Attributes:
        factor: largest factor of an error's amplitude; below 1 all errors shrink.
        frequency: of that error [Hz].
        place: where on the path, 0 to 1.
    """

    factor: float
    frequency: float
    place: float

    @property
    def converges(self) -> bool:
        """Whether no error grows."""
        return self.factor <= 1.0 + CLOSE


class LearningLoop:
    """The loop of a scene about standstill with probes in place of its controllers that learn.

    Args:
        scene: the scene, with chosen effects.
        identify: whether Python functions and FMUs are called to find their linear blocks.

    Raises:
        InputError: a slave can't be linearised, or the scene has no loop.
        TrajectoryError: the motion isn't feasible.
    """

    def __init__(self, scene: Scene, identify: bool = True) -> None:
        loop = loop_of(scene, about_rest=True, probes=True)
        self.scene, self._identify, self._path = scene, identify, loop.motion.once.along_path
        self._wired = WiredLoop(scene, loop)
        slaves = [self._wired.system.slaves[i] for i in self._wired.sampled]
        # index and inputs of each probe
        self._probes = {
            k: [v.name for v in each.variables if v.causality == "input"]
            for k, each in enumerate(slaves)
            if isinstance(each, BlockSlave) and each.block.name == PROBE
        }
        period = None if loop.motion.repetition is None else loop.motion.repetition.period
        self.payload = self._wired.payload
        self.cycles = [samples_in_a_cycle(period, each.sample_time) for each in scene.learners]

    @cached_property
    def _laws(self) -> list[tuple[LearningLaw, tuple[float, float]]]:
        """The law of each controller that learns, and its gains; errors as of `law_of`."""
        return [law_of(section, cycle) for section, cycle in zip(self.scene.learners, self.cycles, strict=True)]

    def response(self, place: float, learner: int = 0, payload: float | None = None) -> RealArray:
        """Angles (M, 2, 2) [rad] that a controller measures in the samples after a torque of 1 N.m of one sample.

        In a loop whose other parts have longer sample times it is the mean over the instants of the torque.

        Args:
            place: where on the path, 0 to 1.
            learner: which of the controllers that learn.
            payload: mass instead of the robot's own [kg].

        Raises:
            InputError: the loop is unstable there, or has no linear loop.
            ValueError, EquilibriumError: see `WiredLoop.at`.
        """
        x, y = positions_along(self._path, place)[0].tolist()
        loop, names = self._wired.at((x, y), self._identify, payload=payload)
        cut = _cut_at_the_probe(loop, self._probes, learner).lifted.part([len(names), len(names) + 1])
        if (radius := float(abs(np.linalg.eigvals(cut.a)).max(initial=0.0))) >= 1.0:
            raise InputError(
                f"the loop that learns is unstable at {place:g} of the path (eigenvalue {radius:.4g}); see `flexfmu margins`"
            )
        # period after period as long as anything is left, the slowest state as the last
        count = cut.size // 2
        most = min(self.cycles[learner], LONGEST_RESPONSE) / count
        state, periods = cut.b, [cut.d]
        for _ in range(ceil(min(most, 3.0 + log(DECAYED) / log(max(radius, DECAYED))))):
            periods.append(cut.c @ state)
            state = cut.a @ state
        # (instant of the angle, joint, instant of the torque, joint); torques later in the period act later
        found = np.array(periods).reshape(-1, 2, count, 2, count).transpose(0, 2, 1, 4, 3).reshape(-1, 2, count, 2)
        mean = np.mean([np.pad(found[i:, :, i], ((0, i), (0, 0), (0, 0))) for i in range(count)], axis=0)[LATE:]
        sizes = abs(mean).max(axis=(1, 2))
        return np.asarray(mean[: 1 + int(np.flatnonzero(sizes >= DECAYED * sizes.max()).max())])

    def responses(self, learner: int, payload: float | None = None) -> RealArray:
        """The response at `PLACES` places, (S, M, 2, 2); arguments and errors as for `response`."""
        found = [self.response(place, learner, payload) for place in np.linspace(0.0, 1.0, PLACES).tolist()]
        size = max(map(len, found))
        return np.array([np.pad(each, ((0, size - len(each)), (0, 0), (0, 0))) for each in found])

    def gains(self, place: float, payload: float | None = None) -> tuple[RealArray, RealArray]:
        """Factors (F,) by which errors change in a cycle about a place, 0 to 1, and frequencies (F,) [Hz].

        Where several controllers learn, what they learn adds up, and the weight of their torques is the largest one.
        """
        kept, learned, frequency = np.zeros(1), np.zeros(1, complex), np.zeros(1)
        for i, (section, (law, gain)) in enumerate(zip(self.scene.learners, self._laws, strict=True)):
            response = self.response(place, i, payload)
            torque, error, frequency = law.effects(response, place, np.array(gain), section.sample_time)
            kept, learned = np.fmax(kept, abs(torque)), learned + error
        return np.asarray(
            np.linalg.norm(kept[:, np.newaxis, np.newaxis] * np.eye(2) - learned, 2, axis=(1, 2))
        ), frequency

    def contraction(self) -> Contraction:
        """The largest factor over all frequencies, and over the path by halving the distance of places about the worst."""

        def worst(place: float) -> Contraction:
            factors, frequencies = self.gains(place)
            k = int(factors.argmax())
            return Contraction(float(factors[k]), float(frequencies[k]), place)

        found, apart = [worst(each) for each in np.linspace(0.0, 1.0, COARSE).tolist()], 1.0 / (COARSE - 1)
        for _ in range(HALVINGS):
            apart /= 2.0
            here = max(found, key=lambda each: each.factor).place
            found += [worst(each) for each in (here - apart, here + apart) if 0.0 <= each <= 1.0]
        return max(found, key=lambda each: each.factor)


def chosen_cut_off(scene: Scene, learner: int) -> float | None:
    """Cut-off [Hz] of the Q-filter of a controller with which errors of all frequencies shrink; None if they do without one.

    They shrink with the robot's payload, and with one that is smaller or larger by the section's `payload_error`.

    Raises:
        InputError: no filter helps, or the loop can't be linearised.
    """
    section, highest = scene.learners[learner], np.inf
    loop = LearningLoop(scene)
    for payload in sorted(
        {(1.0 + each) * loop.payload for each in (0.0, section.payload_error, -section.payload_error)}
    ):
        for place in np.linspace(0.0, 1.0, COARSE).tolist():
            factors, frequencies = loop.gains(place, payload)
            grows = factors > 1.0 + CLOSE
            # 1 + (f / cut-off)^4 must be at least the factor, with frequencies as the filter's bilinear transform has them
            angles = np.tan(np.minimum(pi * frequencies[grows] * section.sample_time, 0.499 * pi))
            highest = min(highest, float((angles / (factors[grows] - 1.0) ** 0.25).min(initial=np.inf)))
    if not isfinite(highest):
        return None
    found = SHARE * atan(highest) / (pi * section.sample_time)
    if found * section.sample_time * loop.cycles[learner] < LOWEST:
        raise InputError(
            f"no Q-filter makes learning converge: errors change by factors up to {loop.contraction().factor:.4g} in each cycle, slow "
            f'errors too; lower the `gain`, change the `lead`, or use `law = "norm-optimal"`'
        )
    return float(f"{found:.3g}")


def _cut_at_the_probe(loop: LinearLoop, probes: Mapping[int, Sequence[str]], learner: int) -> LinearLoop:
    """The loop with two channels more, at a probe, `LATE` samples late; the other probes are silent.

    What is fed into a channel is a signal, which the probe outputs at its next sample; what comes back is what a meter beside it took
    a sample before, when all outputs of that instant were there.
    """
    x, which = loop.continuous, list(probes)[learner]
    old, signals, count = loop.blocks[which], len(x.c), len(loop.inputs[which][0]) - len(x.c)
    # two more signals, and two more outputs at the end
    inputs = [np.pad(np.insert(each, [signals] * 2, 0.0, axis=1), ((0, 0), (0, 2))) for each in loop.inputs]
    rows = [list(probes[which]).index(f"joint{joint}.position") for joint in (1, 2)]
    inputs, metered = [*inputs, inputs[which][rows]], np.zeros((2, signals + 4 + count))
    metered[:, signals : signals + 2] = np.eye(2)
    inputs[which] = metered
    blocks = [*loop.blocks]
    for k in probes:
        b, c, d = np.zeros((0, blocks[k].b.shape[1])), np.zeros((len(blocks[k].c), 0)), 0.0 * blocks[k].d
        blocks[k] = replace(blocks[k], a=np.zeros((0, 0)), b=b, c=c, d=d)
    blocks[which] = replace(blocks[which], b=np.zeros((0, 2)), d=np.eye(2))
    meter = LinearBlock(np.zeros((2, 2)), np.eye(2), np.eye(2), np.zeros((2, 2)), old.sample_time, old.offset)
    held = np.pad(x.held[0], ((0, 0), (0, 2))), np.pad(x.held[1], ((0, 2), (0, 2)))
    fed = np.pad(x.channels[0], ((0, 0), (0, 2))), block_diag(x.channels[1], np.eye(2))
    return LinearLoop(
        Continuous(x.a, np.pad(x.c, ((0, 2), (0, 0))), held, fed),
        (*blocks, meter),
        (*loop.calls, len(blocks)),
        tuple(inputs),
        (*loop.channels, count, count + 1),
    )


@one_blas_thread()
def settled(scene: Scene) -> Scene:
    """The scene with its Q-filters and norm-optimal laws chosen where it leaves them open; a warning if learning doesn't converge.

    The model of a norm-optimal law is the scene's own robot, with the payload that the law assumes, without a payload error.

    Raises:
        InputError: something is open, and the loop can't be linearised, is unstable, or no filter helps.
        TrajectoryError: the motion isn't feasible.
    """
    changes: dict[str, Any] = {}
    for i, section in enumerate(scene.learners):
        key = f"controller.{scene.controller.index(section)}"
        if section.law == "norm-optimal" and section.response is None:
            mass = scene.payload.mass if section.payload is None else section.payload
            response = LearningLoop(scene).responses(i, mass)
            # six digits of the largest value
            changes[f"{key}.response"] = np.round(response, int(6 - np.floor(np.log10(abs(response).max())))).tolist()
    scene = scene.replace(changes) if changes else scene
    for i, section in enumerate(scene.learners):
        if section.cut_off == "auto":
            key = f"controller.{scene.controller.index(section)}.q_filter"
            scene = scene.replace({key: chosen_cut_off(scene, i) or "none"})
    contraction = contraction_of(scene)
    if contraction is not None and not contraction.converges:
        cycles = log(10.0) / log(contraction.factor)
        warnings.warn(
            f"learning doesn't converge: errors at {contraction.frequency:.4g} Hz grow {contraction.factor:.4g}-fold in each cycle "
            f"about {100.0 * contraction.place:.3g} % of the path, tenfold in {cycles:.3g} cycles (the scene has "
            f'{scene.learners[0].cycles}): set `q_filter = "auto"` or `law = "norm-optimal"`, or lower the `gain`',
            LearningWarning,
            stacklevel=2,
        )
    return scene


@lru_cache(maxsize=16)
def contraction_of(scene: Scene) -> Contraction | None:
    """The contraction of a scene's learning; None for none, and for a loop that is unstable or can't be linearised."""
    if not scene.learners:
        return None
    try:
        return LearningLoop(scene, identify=False).contraction()
    except (CosimError, SceneError, EquilibriumError, ValueError):
        return None
