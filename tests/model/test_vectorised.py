"""CasADi functions evaluated by numpy for many points: the same numbers as CasADi's own, operation by operation."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from flexfmu.model import vectorised
from flexfmu.model.vectorised import Vectorised


def test_all_operations_are_those_of_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = casadi.SX.sym("x", 2), casadi.SX.sym("y")
    a, b = x[0], x[1]
    results = [
        casadi.vertcat(a + b, a - b, a * b, a / b, -a, a**2, casadi.sqrt(b), 1 / b, 2 * a, y),
        casadi.vertcat(casadi.sin(a), casadi.cos(a), casadi.tan(a), casadi.exp(a), casadi.log(b), casadi.tanh(a)),
        casadi.vertcat(casadi.atan(a), casadi.asin(a / 9), casadi.acos(a / 9), casadi.atan2(a, b), b**y, b**2.5),
        casadi.vertcat(casadi.fabs(a), casadi.sign(a), casadi.fmin(a, b), casadi.fmax(a, b), casadi.sinh(a), 3.0),
        casadi.vertcat(casadi.if_else(casadi.logic_and(a < b, a != y), a, b), casadi.cosh(a), a <= b, a == b, a > 0),
    ]  # fmt: skip
    function = casadi.Function("f", [x, y], [casadi.densify(casadi.vertcat(*results)), a * b])
    random = np.random.default_rng(0)
    points = np.column_stack([random.uniform(-2.0, 2.0, 50), random.uniform(0.1, 3.0, 50)])
    others = random.uniform(-1.0, 1.0, (50, 1))
    # in parts of 16 points too
    for size in (1000, 16):
        monkeypatch.setattr(vectorised, "CHUNK", size)
        found = Vectorised(function)([points, others])
        expected = function.map(50)(points.T, others.T)
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, np.asarray(other).T, rtol=1e-15, atol=1e-15)


def test_other_operations_are_refused() -> None:
    x = casadi.SX.sym("x")
    with pytest.raises(NotImplementedError, match="f: CasADi's operation"):
        Vectorised(casadi.Function("f", [x], [casadi.erf(x)]))
