"""The tracking error of a repeated motion, cycle by cycle, of recordings with errors that are known."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.engine.results import Column, Recording
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.metrics.signals import cycle_errors
from flexfmu.model.scene.file import load_scene

ERRORS = (1e-3, 2e-4)
"""Of the joints in the first cycle [rad]; each further cycle halves them."""


@pytest.fixture(scope="module")
def motion() -> MotionPlan:
    """Three cycles."""
    return repeated(plan(load_scene("barnard2012-6kg")), 3)


def recorded(motion: MotionPlan, until: float) -> Recording:
    """Joints that lag by a sine with whole waves in each half of a cycle, smaller from cycle to cycle."""
    assert motion.repetition is not None
    period = motion.repetition.period
    time = np.linspace(0.0, until, round(until / period * 4000) + 1)
    wave = np.sin(8.0 * np.pi * time / period) * 0.5 ** np.floor(time / period)
    columns = {}
    for joint, size in enumerate(ERRORS, start=1):
        columns[f"joint{joint}.reference.position"] = Column("rad", 1.0 + time)
        columns[f"joint{joint}.position"] = Column("rad", 1.0 + time - size * wave)
    return Recording(time, columns)


def test_each_cycle_has_its_own_error(motion: MotionPlan) -> None:
    """Root mean square and peak of a sine, halved from cycle to cycle; the last cycle ends with its standstill, which is as
    long as the others, or with the run."""
    found = cycle_errors(motion, recorded(motion, motion.stop_time))
    assert len(found) == 3
    for cycle, each in enumerate(found):
        np.testing.assert_allclose(each.rms, np.array(ERRORS) * 0.5**cycle / np.sqrt(2.0), rtol=2e-3)
        np.testing.assert_allclose(each.largest, np.array(ERRORS) * 0.5**cycle, rtol=1e-5)


def test_cycles_that_were_cut_short_do_not_count(motion: MotionPlan) -> None:
    """A run that failed in its third cycle tells the errors of two, one without joint angles none."""
    assert motion.repetition is not None
    recording = recorded(motion, 2.5 * motion.repetition.period)
    assert len(cycle_errors(motion, recording)) == 2
    assert cycle_errors(motion, recording.only(lambda name: name != "joint2.position")) == ()
    assert cycle_errors(motion.once, recording) == ()
