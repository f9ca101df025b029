"""Blocks identified from their answers have the responses of their equations; what isn't linear is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import context, delay, looped, pd, pid, quantisation

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.filters import filter_block, low_pass, notch
from flexfmu.cosim.design.margins.linear_blocks import LinearBlock, identified_block, linear_block
from flexfmu.cosim.design.margins.loop_warnings import stability_warning
from flexfmu.cosim.design.margins.scene_margins import scene_margins
from flexfmu.cosim.engine.errors import InputError
from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.symbolic import SymbolicBlock

TIME: Any = {"sample_time": 1e-3}
START: Any = {"signal": "position", "initial": (0.3, -0.2)}

BLOCKS: dict[str, Callable[[], SymbolicBlock]] = {
    "pd": lambda: pd((900.0, 800.0), 12.0, torque_limit=1e4, **TIME),
    "pid": lambda: pid(900.0, 4e4, 12.0, filter_time=3e-3, offset=2e-4, **TIME),
    "filters": lambda: filter_block(
        flexfmu.filters.high_pass(frequency=1.0, **TIME), context("filter"), [*notch(40.0), *low_pass(90.0, 3)]
    ),
    "delay": lambda: delay(17e-3, **START, **TIME),
}


def markov(block: LinearBlock, count: int = 300) -> Any:
    """Impulse response (count, k, m)."""
    x, found = block.b, [block.d]
    for _ in range(count - 1):
        found.append(block.c @ x)
        x = block.a @ x
    return np.array(found)


@pytest.mark.parametrize("name", BLOCKS)
def test_an_identified_block_has_the_response_of_its_equations(name: str) -> None:
    """Integrators and memories too, beyond the samples that it was identified from."""
    block = BLOCKS[name]()
    point = np.linspace(0.1, 0.4, len(block.inputs))
    exact, at_rest = linear_block(BlockSlave(block), point)
    found, _ = identified_block(BlockSlave(block), point)
    assert (found.sample_time, found.offset) == (exact.sample_time, exact.offset)
    wanted = markov(exact)
    np.testing.assert_allclose(markov(found), wanted, rtol=0.0, atol=1e-7 * abs(wanted).max())
    assert len(at_rest) == len(block.outputs)


OWN = """
import math
import numpy as np
import flexfmu


@flexfmu.controller(sample_time=1e-3, state=[0.0, 0.0])
def pi_d(t, reference, measurement, state):
    error = [float(r) - float(m) for r, m in zip(reference[:2], measurement[:2])]
    rate = reference[2:] - measurement[2:]
    torque = [4e3 * e + 40.0 * float(v) + float(x) for e, v, x in zip(error, rate, state)]
    return np.array(torque), np.array([math.fsum([x, 20.0 * e]) for e, x in zip(error, state)])


@flexfmu.controller(sample_time=1e-3, state=[0.0, 0.0])
def traced(t, reference, measurement, state):
    error, rate = reference[:2] - measurement[:2], reference[2:] - measurement[2:]
    return 4e3 * error + 40.0 * rate + state, state + 20.0 * error


@flexfmu.controller(sample_time=1e-3)
def rounding(t, reference, measurement):
    return np.array([float(math.floor(4e3 * float(r - m))) for r, m in zip(reference[:2], measurement[:2])])
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module with the functions."""
    (tmp_path / "own_margins.py").write_text(OWN)
    monkeypatch.syspath_prepend(str(tmp_path))


def python(name: str) -> dict[str, Any]:
    """The section of one of them."""
    return {"kind": "python", "source": f"own_margins:{name}"}


@pytest.mark.usefixtures("own")
def test_python_functions_and_fmus_have_the_margins_of_blocks(tmp_path: Path) -> None:
    """The same law as a block, as a function that CasADi can't trace, and as an FMU."""
    gains = {"proportional": 4e3, "integral": 2e4, "derivative": 40.0, "filter_time": 2e-3}
    fmu = build_fmu(pid(**gains, **TIME), tmp_path / "own.fmu")
    pairs = (
        (python("traced"), python("pi_d")),
        ({"kind": "pid", **gains, **TIME}, {"kind": "fmu", "path": str(fmu.path)}),
    )
    for pair in pairs:
        wanted, found = (scene_margins(looped(each, distal_axial=0), poses=1).worst for each in pair)
        for name in ("gain_margin", "delay_margin", "disk_margin", "sensitivity_peak"):
            assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=1e-6), name


@pytest.mark.usefixtures("own")
def test_what_is_not_linear_is_refused() -> None:
    """With the slave's name and by how much; a run doesn't call a function for its warning."""
    with pytest.raises(InputError, match=r"rounding can't be linearised: about its operating point it answers with"):
        scene_margins(looped(python("rounding")), poses=1)
    with pytest.raises(InputError, match=r"not to one of 1e-05: it rounds, or has a dead zone"):
        identified_block(BlockSlave(quantisation(1e-2, **TIME)), np.array([0.3, -0.2]))
    with pytest.raises(InputError, match="memories of more than 40 samples"):
        identified_block(BlockSlave(delay(60e-3, **START, **TIME)), np.array([0.3, -0.2]))
    run = flexfmu.run(looped(python("pi_d"), distal_axial=0))
    assert stability_warning(run) is None
