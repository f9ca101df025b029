"""Polynomials that stand for a planned motion follow it closely enough for references at 1e-11."""

from __future__ import annotations

from itertools import pairwise

import casadi
import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.studies.workprec.solver_trials import joint_motion, motion_polynomials
from flexfmu.model.scene.file import load_scene


@pytest.mark.parametrize("profile", [{"kind": "poly7"}, {"kind": "bang-bang"}, {"kind": "trapezoidal", "ramp": 0.125}])
@pytest.mark.parametrize("blend", ["lame", "clothoid", "polar"])
def test_angles_rates_and_accelerations(profile: dict[str, object], blend: str) -> None:
    """Between breakpoints and up to both of their sides, for every kind of motion, dwell included."""
    scene = load_scene("barnard2012-6kg").replace({"trajectory.profile": profile, "trajectory.blend.kind": blend})
    motion = plan(scene)
    parts = motion_polynomials(motion.joints, motion.stop_time)
    assert parts[0].begin == 0.0
    assert parts[-1].end == motion.stop_time
    assert all(a.end == b.begin for a, b in pairwise(parts))
    for part in parts:
        time = np.linspace(part.begin, part.end, 23)[1:-1]
        exact = motion.joints.evaluate(time, 2)
        x = (2.0 * time - part.begin - part.end) / (part.end - part.begin)
        for derivative, tolerance in enumerate((1e-12, 1e-9, 1e-6)):
            found = np.polynomial.chebyshev.chebval(x, part.coefficients[derivative]).T
            scale = max(1.0, np.abs(exact[derivative]).max())
            np.testing.assert_allclose(found, exact[derivative], rtol=0.0, atol=tolerance * scale)


def test_the_solvers_read_the_same_numbers() -> None:
    """The order of the coefficients in the vector that solvers get is the one in which they read it."""
    motion = plan(load_scene("barnard2012-6kg"))
    part = motion_polynomials(motion.joints, motion.stop_time)[3]
    t, numbers = casadi.SX.sym("t"), casadi.SX.sym("piece", part.numbers.size)
    function = casadi.Function("u", [t, numbers], [joint_motion(t, numbers)])
    time = 0.3 * part.begin + 0.7 * part.end
    exact = motion.joints.evaluate(time, 2)[:, 0].ravel()
    np.testing.assert_allclose(function(time, part.numbers).full().ravel(), exact, rtol=1e-7, atol=1e-9)
