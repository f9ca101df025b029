"""Controllers from Python functions: blocks where CasADi can trace them, else slaves in Python, with the same numbers."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest
from blocks import pd
from hypothesis import given, seed, settings
from hypothesis import strategies as st

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.own_function import FunctionController, FunctionSlave, function_block
from flexfmu.cosim.engine.errors import InputError, SlaveError
from flexfmu.cosim.exchange.slave_export import export_slaves
from flexfmu.cosim.experiment.user_slaves import as_slave
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.model.scene.schema import Scene

H = 1e-3
SINGLE: dict[str, Any] = {"inputs": ["a.reference.x", "b.reference.y", "c", "d"], "outputs": ["y"]}


@flexfmu.controller(sample_time=H)
def springs(reference: Any, measurement: Any, *, stiffness: float = 5e3, damping: float = 50.0) -> Any:
    """Springs and dampers."""
    error = reference - measurement
    return stiffness * error[:2] + damping * error[2:]


@flexfmu.controller(sample_time=H)
def branching(reference: Any, measurement: Any, *, stiffness: float = 5e3, damping: float = 50.0) -> Any:
    """The same with a branch, which CasADi can't trace."""
    error = reference - measurement
    if error[0] > 1e9:
        return [0.0, 0.0]
    return stiffness * error[:2] + damping * error[2:]


def stepped(slave: Any, inputs: np.ndarray) -> np.ndarray:
    """Outputs (N, outputs) for inputs (N, inputs)."""
    kinds = [each.causality for each in slave.variables]
    read = np.array([i for i, kind in enumerate(kinds) if kind == "output"])
    fed, found = np.arange(inputs.shape[1]), np.empty((len(inputs), read.size))
    slave.initialize(0.0, 1.0, None)
    for k, values in enumerate(inputs):
        slave.set(fed, values)
        slave.sample(k * H)
        slave.get(read, found[k])
    return found


def law_of(function: Callable[..., Any], **options: Any) -> FunctionController:
    """The controller of a function with four inputs and one output."""
    return flexfmu.controller(**{"sample_time": H, **SINGLE, **options})(function)


def test_both_ways_are_the_built_in_pd(robot: Scene) -> None:
    """As a block and in Python: 1e-12 of the built-in PD in the loop of a robot."""
    expected = flexfmu.run(robot, controllers=[pd(5e3, 50.0, sample_time=H)]).recording
    for function, kind in ((springs, BlockSlave), (branching, FunctionSlave)):
        assert isinstance(as_slave(function), kind)
        run = flexfmu.run(robot, controllers=[function])
        assert run.completed, run.message
        for name in ("joint1.position", "joint2.torque"):
            values = expected[name].values
            np.testing.assert_allclose(run.recording[name].values, values, rtol=0.0, atol=1e-12 * abs(values).max())


@pytest.mark.parametrize("symbolic", [True, False])
def test_time_state_and_parameters(symbolic: bool) -> None:
    """y_k = a x_k + t_k b, x_k+1 = x_k + e_k, sampled from an offset on; the same in both ways."""

    @flexfmu.controller(sample_time=H, offset=0.02, state=[0.5], symbolic=symbolic, **SINGLE)
    def law(t: Any, reference: Any, measurement: Any, state: Any, *, a: float = 2.0, b: Any = (1.0, 3.0)) -> Any:
        return a * state[0] + t * (b[0] + b[1]), state[0] + reference[1] - measurement[0]

    slave, u = law.slave(), np.random.default_rng(1).normal(size=(20, 4))
    assert [each.name for each in slave.variables if each.causality == "parameter"] == ["a", "b[1]", "b[2]"]
    states = 0.5 + np.concatenate([[0.0], np.cumsum(u[:-1, 1] - u[:-1, 2])])
    expected = 2.0 * states + 4.0 * (0.02 + H * np.arange(20))
    np.testing.assert_allclose(stepped(slave, u)[:, 0], expected, rtol=1e-12)
    # rollback: a sample repeated from a saved state is the same
    saved = slave.save()
    slave.sample(0.1)
    after = slave.save()
    slave.restore(saved)
    slave.sample(0.1)
    np.testing.assert_array_equal(slave.save(), after)


TABLE = casadi.interpolant("table", "linear", [[-5.0, 0.0, 5.0]], [1.0, 0.0, 2.0])

IDIOMS: list[Callable[[Any, Any], Any]] = [
    lambda r, m: np.clip(r, -1.0, 1.0) + np.maximum(r, m) + np.sign(m) + abs(m),
    lambda r, m: np.where(r > m, r, 2.0 * m),
    lambda r, m: [np.sin(each) for each in r],
    lambda r, m: np.array([[1.0, 2.0], [3.0, 4.0]]) @ r,
    lambda r, m: np.array([r[0] * np.tanh(m[0]), np.exp(-(r[1] ** 2))]),
    lambda r, m: (np.dot(r, m), r.sum()),
    lambda r, m: casadi.if_else(r[0] > 0.0, m, r),
    lambda r, m: np.concatenate([r[:1], m[1:]]) * len(r),
    lambda r, m: casadi.vertcat(TABLE(r[0]), m[1]),
]


@pytest.mark.parametrize("index", range(len(IDIOMS)))
def test_usual_operations_are_traced(index: int) -> None:
    """What is usual in NumPy and CasADi becomes a block with the values of the function."""
    function = IDIOMS[index]

    @flexfmu.controller(sample_time=H, inputs=SINGLE["inputs"], outputs=["y1", "y2"])
    def law(reference: Any, measurement: Any) -> Any:
        return function(reference, measurement)

    slave, u = law.slave(), np.random.default_rng(2).normal(size=(5, 4))
    assert isinstance(slave, BlockSlave)
    expected = [np.array(function(row[:2], row[2:]), dtype=float).ravel() for row in u]
    np.testing.assert_allclose(stepped(slave, u), expected, rtol=1e-14, atol=1e-14)


def test_traced_function_leaves_as_an_fmu(robot: Scene, tmp_path: Path) -> None:
    """From a scene file with its arguments; a function in Python is refused with the reason and what would do."""
    section = {"kind": "python", "source": "test_own_function:springs", "folder": str(Path(__file__).parent)}
    scene = robot.replace({"controller": [section | {"arguments": {"stiffness": 4000, "damping": 40.0}}]})
    fmu = export_slaves(scene, tmp_path, names=["springs"]).slaves[0].path
    exported = run_scene(robot.replace({"controller": [{"kind": "fmu", "path": str(fmu)}]})).recording
    expected = flexfmu.run(robot, controllers=[pd(4e3, 40.0, sample_time=H)]).recording["joint1.position"].values
    np.testing.assert_allclose(exported["joint1.position"].values, expected, rtol=0.0, atol=1e-12)
    other = robot.replace({"controller": [section | {"source": "test_own_function:branching"}]})
    with pytest.raises(InputError, match=r"'branching' can't be exported.*can't trace.*casadi\.if_else in place of if"):
        export_slaves(other, tmp_path)


@pytest.mark.parametrize("symbolic", [None, False])
def test_arguments_may_be_changed_in_place(symbolic: bool | None) -> None:
    """A function that adds to its state in place is no other function."""

    def law(reference: Any, state: Any) -> Any:
        state += reference[0]
        return state[0], state

    slave = law_of(law, state=[1.0], symbolic=symbolic).slave()
    np.testing.assert_allclose(stepped(slave, np.full((4, 4), 2.0))[:, 0], [3.0, 5.0, 7.0, 9.0], rtol=1e-15)


def test_impure_functions_are_refused() -> None:
    """What is kept between calls or drawn would differ between repeated samples; said so, unless told not to try."""
    sums: list[float] = []

    def remembers(reference: Any) -> Any:
        sums.append(1.0)
        return float(len(sums))

    for function in (remembers, random.random):
        with pytest.raises(InputError, match="gives other values for the same arguments: what it keeps"):
            law_of(function).slave()
    sums.clear()
    tried = law_of(remembers, symbolic=False).slave()
    assert isinstance(tried, FunctionSlave)
    assert not sums


@pytest.mark.parametrize(("make", "message"), [
    (lambda: law_of(lambda reference, gain: 0.0), "argument 'gain' without a default: the arguments are t, reference"),
    (lambda: law_of(lambda reference: reference).slave(), "returns 2 values for its 1 outputs"),
    (lambda: law_of(lambda state: 0.0, state=[0.0]).slave(), "must return two things: outputs, next states"),
    (lambda: law_of(lambda reference: None).slave(), "returns None for its 1 outputs: every way through it"),
    (lambda: law_of(lambda reference: [None]).slave(), "returns None among its 1 outputs"),
    (lambda: law_of(lambda state: None, state=[0.0]).slave(), "outputs, next states; it returns None"),
    (lambda: law_of(lambda state: (0.0, None), state=[0.0]).slave(), "returns None for its 1 states"),
    (lambda: law_of(lambda reference: 1.0 / 0).slave(), r"fails: ZeroDivisionError: .*test_own_function\.py, line"),
    (lambda: law_of(lambda reference: 0.0, sample_time=-1.0), "the sample time must be positive, got -1.0 s"),
    (lambda: law_of(lambda reference: 0.0, inputs="a"), r"inputs must be a list of names, such as \["),
    (lambda: law_of(lambda reference: 0.0, outputs=["c"]).slave(), "two variables are named 'c'"),
    (lambda: law_of(lambda reference, k=1.0: k, units={"q": "N"}), "`units` names 'q', which is no variable"),
    (lambda: springs.changed({"stifness": 1.0}), "has no parameter 'stifness'; did you mean 'stiffness'"),
    (lambda: springs.changed({"stiffness": "high"}), "springs: stiffness must be a number, got 'high'"),
    (lambda: springs.changed({"sample_time": None}), "springs: sample_time must be a number, got None"),
    (lambda: law_of(branching.function, symbolic=True, inputs=None, outputs=None).slave(),
     "CasADi can't trace the function: RuntimeError: Cannot"),
])  # fmt: skip
def test_wrong_input_is_named(make: Callable[[], Any], message: str) -> None:
    """Every mistake is said with the controller, the argument and what would do."""
    with pytest.raises(InputError, match=message):
        make()


@seed(17)
@settings(max_examples=30)
@given(
    st.dictionaries(
        st.sampled_from(["stiffness", "damping", "offset", "x"]), st.one_of(st.floats(), st.text(max_size=3), st.none())
    )
)
def test_any_arguments_are_taken_or_refused(arguments: dict[str, Any]) -> None:
    """NaN and infinity don't travel on: either the block has these finite values, or an `InputError` says why not."""
    try:
        slave = springs.changed(arguments).slave()
    except InputError:
        return
    starts = {each.name: each.start for each in slave.variables if each.causality == "parameter"}
    assert all(np.isfinite(start) for start in starts.values() if start is not None)
    assert all(starts[name] == float(value) for name, value in arguments.items() if name in starts)


def test_failures_in_the_run_end_it(robot: Scene) -> None:
    """An exception and a NaN are the slave's failures, with its name and what happened."""

    @flexfmu.controller(sample_time=H, symbolic=False)
    def fails(t: float) -> Any:
        return [0.0, {}["gone"] if t > 0.01 else 0.0]

    @flexfmu.controller(sample_time=H, symbolic=False)
    def undefined(t: float) -> Any:
        return [0.0, np.nan if t > 0.01 else 0.0]

    with pytest.warns(flexfmu.RunWarning, match=r"fails .*at 0\.011 s.*KeyError: 'gone'"):
        assert not flexfmu.run(robot, controllers=[fails]).completed
    with pytest.warns(flexfmu.RunWarning, match="undefined"):
        run = flexfmu.run(robot, controllers=[undefined])
    assert run.message == "undefined failed at 0.011 s: joint2.torque isn't finite"
    with pytest.raises(SlaveError):
        stepped(fails.slave(), np.zeros((20, 8)))


def test_block_is_named_and_described() -> None:
    """The name of the function, the first line of its docstring, the robot's units."""
    block = function_block(springs)
    assert (block.name, block.description) == ("springs", "Springs and dampers.")
    assert {each.unit for each in block.outputs} == {"N.m"}
    assert block.states == ()  # no counter of samples without the time
    assert springs(np.ones(4), np.zeros(4)).tolist() == [5050.0, 5050.0]
