"""How much more accurate a companion is than its run, as far as orders of convergence are known.

A companion has a hundredth of the tolerance and at most half of the steps. Errors of integration shrink like the tolerance to
the power p/(p + 1) for a method of order p, those of input polynomials and interpolation like the step to the sixth power at
least, by 1/64: its error is a few hundredths of the change from the run to it. `ORDERLY` is six times that. Where a mode rings
undamped, where signals are rounded, or where slaves of unknown order are coupled, nothing shrinks by order, and a change may be
small by chance. The factors are those with which 99.5 % of all errors hold (`benchmarks/stated_errors.py`).
"""

from __future__ import annotations

from math import ceil

from flexfmu.cosim.engine.slave import Sampled
from flexfmu.cosim.experiment.planning import MotionPlan
from flexfmu.cosim.experiment.system import SceneSystem
from flexfmu.model.scene.effects import Effects
from flexfmu.model.scene.schema import Scene

NO_ORDER = 4.0
"""Error of a companion in terms of the change to it, where no order is known."""

ORDERLY, LOOSE, TIGHT = 0.1, 1.0, 1.0
"""The same by order; at loose tolerances, where it isn't reached yet; where steps and rounding limit a companion, or a fixed step is halved."""

LOOSEST, TIGHTEST = 1e-5, 1e-9
"""A run's tolerance above which it counts as loose, and a companion's below which it counts as tight."""

LEAST_ORDER = 5
"""Degree of the input polynomials from which on their error has an order of six or more."""

LEAST_RATIO, LEAST_TIME = 0.01, 1e-6
"""Modal damping ratio, and time constant of stiffness damping [s], below which modes of some kHz ring to the end of a motion."""


COMPANION_STEPS = 2000
"""Smallest number of communication steps of a companion over the motion; with fewer, both runs could miss the same
motion between communication points."""


def companion_step(parts: SceneSystem, motion: MotionPlan, step: float) -> float:
    """Return the communication step of a companion [s], which divides that of the run and is at most half of every sample time."""
    samples = (0.5 * each.sample_time for each in parts.slaves if isinstance(each, Sampled))
    longest = min(0.5 * step, motion.once.duration / COMPANION_STEPS, *samples)
    return step / ceil(step / longest * (1.0 - 1e-9))


def companion_share(scene: Scene, parts: SceneSystem, tolerance: float, companions_tolerance: float) -> float:
    """Return the largest error of a companion, in terms of the change of a metric from the run to it.

    Args:
        scene: the scene.
        parts: its slaves.
        tolerance, companions_tolerance: relative tolerances of both.
    """
    section = scene.cosimulation
    known = (
        not _is_hardly_damped(scene.effects)
        and section.step_control is None
        and section.algorithm == "gauss-seidel"
        and parts.references.announced_order >= LEAST_ORDER
        and all(getattr(each, "is_continuous", False) for each in parts.others)
        and companions_tolerance < 0.5 * tolerance
    )
    if not known:
        return NO_ORDER
    if companions_tolerance < TIGHTEST or section.integrator_step > 0.0:
        return TIGHT
    return LOOSE if tolerance > LOOSEST else ORDERLY


def _is_hardly_damped(effects: Effects) -> bool:
    """Whether fast modes are undamped, or hardly damped."""
    families = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")
    drives = effects.transmission is not None and effects.transmission.damping == 0.0
    if not any(getattr(effects, family) and family not in effects.quasi_static for family in families):
        return drives
    ratio, time = getattr(effects.damping, "ratio", 0.0), getattr(effects.damping, "time", 0.0)
    return drives or (ratio < LEAST_RATIO and time < LEAST_TIME)
