"""What designing references costs: the elastic response of seven payloads with its derivatives. Used by `speed.py`; not a script of
its own."""

from __future__ import annotations

from collections.abc import Iterator
from time import process_time

import numpy as np
from paper_scene import SCENE
from speed_figure import SpeedFigure

from flexfmu.cosim.experiment.planning import plan
from flexfmu.model.reference_design.elastic_response import ElasticResponse, RobotVariant
from flexfmu.model.reference_design.joint_spline import fitted

PAYLOADS, INTERVALS, REPEAT = 7, 40, 5


def design_figures() -> Iterator[SpeedFigure]:
    """The response to a spline of 40 intervals, two steps for each, with derivatives by its 74 coefficients and the duration."""
    motion = fitted(plan(SCENE).joints, INTERVALS)
    mass = SCENE.payload.mass
    robots = [RobotVariant(SCENE, {"payload.mass": mass * share}) for share in np.linspace(0.7, 1.3, PAYLOADS)]
    response = ElasticResponse(robots, motion.coefficients[0], 2 * INTERVALS)
    times = []
    for share in np.linspace(0.99, 1.01, REPEAT):
        start = process_time()
        response.of_motion(motion.with_duration(share * motion.duration))
        times.append(process_time() - start)
    yield SpeedFigure(
        "elastic response with derivatives",
        min(times) / PAYLOADS,
        0.1,
        "s",
        note="per payload, another duration before",
    )
