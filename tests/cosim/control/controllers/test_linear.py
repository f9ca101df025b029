"""Linear systems as blocks: they respond as python-control says, and continuous ones are never discretised by guess."""

from __future__ import annotations

from typing import Any

import control
import numpy as np
import pytest
from blocks import linear_system, responses
from blocks import state_space as state_space_section
from numpy.typing import NDArray

from flexfmu.cosim.control.controllers.from_control import LinearSystem, control_block, dotted, state_space
from flexfmu.cosim.control.controllers.joints import named_signals
from flexfmu.cosim.engine.errors import InputError
from flexfmu.model.linear import signal_label
from flexfmu.model.symbolic import SymbolicBlock

Array = NDArray[np.float64]

H = 1e-3
SAMPLES = 500
TIME = H * np.arange(SAMPLES)


def random_system(seed: int, states: int, inputs: int, outputs: int) -> control.StateSpace:
    """A stable discrete system with direct feedthrough, spectral radius 0.95."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    if states:
        A *= 0.95 / abs(np.linalg.eigvals(A)).max()
    B, C, D = (rng.normal(size=shape) for shape in ((states, inputs), (outputs, states), (outputs, inputs)))
    return control.ss(A, B, C, D, H)


def compare(block: SymbolicBlock, system: Any, seed: int = 9) -> None:
    """The block answers random signals as `control.forced_response` says, to 1e-12 of the largest value."""
    signals = np.random.default_rng(seed).normal(size=(system.ninputs, SAMPLES))
    wanted = control.forced_response(system, TIME, signals, squeeze=False).outputs
    found = responses(block, {each.name: signals[i] for i, each in enumerate(block.inputs)})
    np.testing.assert_allclose(np.array(list(found.values())), wanted, rtol=0, atol=1e-12 * abs(wanted).max())


@pytest.mark.parametrize(("states", "inputs", "outputs"), [(1, 1, 1), (4, 2, 3), (12, 3, 2), (30, 2, 2), (0, 2, 2)])
def test_discrete_state_space(states: int, inputs: int, outputs: int) -> None:
    """A discrete state space is taken as it is: MIMO, direct feedthrough, static gains and all."""
    system = random_system(states, states, inputs, outputs)
    compare(control_block(system), system)


@pytest.mark.parametrize("empty", [([], [], []), (np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)))])
def test_a_static_gain_needs_no_states(empty: tuple[Any, Any, Any]) -> None:
    """A = B = C = [] is a static gain, as a scene file or python-control writes one."""
    block = state_space_section(*empty, [[3.0, -2.0]], sample_time=H, inputs=["a", "b"], outputs=["y"])
    assert block.states == ()
    np.testing.assert_array_equal(responses(block, {"a": [1.0, 0.5], "b": [1.0, 2.0]})["y"], [1.0, -2.5])


@pytest.mark.parametrize("system", [
    control.tf([1.0], [1.0, -0.5], H),
    control.tf([2.0, -1.0, 0.3], [2.0, 0.4, -0.6], H),
    control.tf([3.0], [2.0], H),
    control.tf([0.0, 0.0, 1.0], [1.0, -1.6, 0.8], H),
])  # fmt: skip
def test_discrete_transfer_function(system: control.TransferFunction) -> None:
    """Strictly proper, proper, static, and not normalised."""
    compare(control_block(system), system)


def test_transfer_matrix() -> None:
    """A matrix of transfer functions needs no Slycot: it is the sum of its elements' responses."""
    numerators = [[[1.0, 0.3], [2.0]], [[1.0], [0.5, 0.1, 0.0]]]
    denominators = [[[1.0, -0.5], [1.0, 0.2, 0.1]], [[1.0, -0.9], [1.0, -0.3, 0.02]]]
    signals = np.random.default_rng(4).normal(size=(2, SAMPLES))
    found = responses(control_block(control.tf(numerators, denominators, H)), {"u[0]": signals[0], "u[1]": signals[1]})
    for i in range(2):
        wanted = sum(
            control.forced_response(control.tf(numerators[i][j], denominators[i][j], H), TIME, signals[j]).outputs
            for j in range(2)
        )
        np.testing.assert_allclose(found[f"y[{i}]"], wanted, rtol=0, atol=1e-12 * abs(wanted).max())


def test_feedthrough_is_where_D_is_not_zero() -> None:
    """A zero in D opens an algebraic loop that would otherwise be refused."""
    system = linear_system([[0.5]], [[1.0, 1.0]], [[1.0], [1.0]], [[0.0, 2.0], [0.0, 0.0]], H)
    assert state_space(system).feedthrough == {"y[0]": ("u[1]",), "y[1]": ()}


def test_start_states() -> None:
    """The free response from a start state is C A^k x_0."""
    system = random_system(3, 3, 1, 1)
    start = [1.0, -2.0, 0.5]
    found = responses(control_block(system, start=start), {"u[0]": np.zeros(20)})["y[0]"]
    wanted = [(system.C @ np.linalg.matrix_power(system.A, k) @ start)[0] for k in range(20)]
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


@pytest.mark.parametrize("name", [
    "joint1.torque", "joint2.position", "joint1.reference.position", "joint2.reference.acceleration", "force.x",
    "end_effector.position.x", "end_effector.acceleration.y", "link11.tip_deflection", "link22.elongation",
    "link11.bending[1]", "gain", "y[0]",
])  # fmt: skip
def test_labels_of_the_robot_get_their_dots_back(name: str) -> None:
    """A controller designed on the linearised plant connects to it by the names of its variables."""
    assert dotted(signal_label(name)) == name


def test_labels_and_units() -> None:
    """Labels become names with the robot's units, names may be given instead, and units belong to names."""
    system = control.ss([[0.5]], [[1.0]], [[1.0]], [[0.0]], H, inputs=["joint1_position"], outputs=["gain"])
    block = control_block(system, units={"gain": "N.m"})
    assert [(each.name, each.unit) for each in (*block.inputs, *block.outputs)] == [
        ("joint1.position", "rad"),
        ("gain", "N.m"),
    ]
    block = control_block(system, inputs=["e"], outputs=["f"], offset=2e-4, name="filter")
    assert (block.inputs[0].name, block.outputs[0].name, block.offset, block.name) == ("e", "f", 2e-4, "filter")


DISCRETE = control.tf([1.0], [1.0, -0.5], H)


@pytest.mark.parametrize(("system", "options", "message"), [
    (control.tf([1.0, 40.0], [1.0, 30.0]), {}, r"continuous: discretise it first, for example control.c2d\(system"),
    (control.tf([1.0], [1.0, 2.0], True), {}, r"no sample time \(dt is True\): set system.dt"),
    (control.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], None), {}, r"no sample time \(dt is None\)"),
    (control.tf([1.0, 2.0, 3.0], [1.0, 2.0], H), {}, r"element \[0, 0\] isn't proper: its numerator has degree 2"),
    (DISCRETE, {"inputs": ["a", "b"]}, r"inputs must be a sequence of 1 names, one for each of \['u\[0\]'\]"),
    (DISCRETE, {"inputs": "u"}, "inputs must be a sequence of 1 names"),
    (DISCRETE, {"start": [1.0, 2.0]}, "start must have 1 values, one for each state, got 2"),
    (DISCRETE, {"outputs": ["u[0]"]}, r"two variables are named 'u\[0\]'"),
    (DISCRETE, {"units": {"u[1]": "m"}}, r"names 'u\[1\]', which is no variable; did you mean 'u\[0\]'?"),
    (control.frd([1.0, 2.0], [1.0, 2.0]), {}, "need a control.StateSpace or control.TransferFunction, got Frequency"),
    ("plant.ss", {}, "need a control.StateSpace or control.TransferFunction, got str"),
])  # fmt: skip
def test_refused_systems(system: Any, options: dict[str, Any], message: str) -> None:
    """What would have to be guessed is asked for instead."""
    with pytest.raises(InputError, match=message):
        control_block(system, **options)


@pytest.mark.parametrize(("change", "message"), [
    ({"A": [[0.5, 1.0]]}, "A must be 1 x 1, got 1 x 2"),
    ({"B": [[1.0], [2.0]]}, "B must be 1 x 1, got 2 x 1"),
    ({"C": [[np.nan]]}, r"C\[0, 0\] must be finite, got nan"),
    ({"D": [[1j]]}, "D must hold real numbers, got complex128"),
    ({"A": [["a"]]}, "A must hold real numbers"),
    ({"sample_time": -1.0}, "the sample time must be positive"),
])  # fmt: skip
def test_refused_matrices(change: dict[str, Any], message: str) -> None:
    """Shapes and numbers are checked where they come in."""
    signals = {f"{kind}s": named_signals([kind], kind, {}) for kind in ("input", "output")}
    values = {"A": [[0.5]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "sample_time": H, **signals, **change}
    with pytest.raises(InputError, match=message):
        LinearSystem(**values)
