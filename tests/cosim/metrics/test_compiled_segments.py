"""The analysis of segments in C against densely sampled interpolants, under the sanitizers too."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.metrics import segments as compiled
from flexfmu.cosim.metrics.segments import Analysis, HermiteSegments
from flexfmu.fmu_build.toolchain import find_compiler, native_platform

SHAPES = [(3, 1), (5, 1), (3, 2), (5, 2), (2, 1)]
"""(orders, channels) of the signals."""

SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def drawn(orders: int, channels: int, seed: int, count: int = 60) -> HermiteSegments:
    """Vibrations with jumps, steps of all lengths and noise that diverges in some segments."""
    random = np.random.default_rng(seed)
    time = np.cumsum(np.concatenate([[0.0], random.choice([1e-2, 1e-2, 1e-2, 4e-3, 1e-4], count)]))
    k = np.arange(orders)[:, np.newaxis, np.newaxis]
    frequency, phase = random.uniform(5.0, 200.0, channels), random.uniform(0.0, 6.0, channels)
    nodes = frequency**k * np.sin(frequency * time[:, np.newaxis] + phase + k * np.pi / 2)
    nodes = nodes * (1.0 + 1e-13 * random.normal(size=nodes.shape))
    left, right = nodes[:, :-1].copy(), nodes[:, 1:].copy()
    # a signal that jumps by itself and one whose highest derivative alone jumps; a fast coordinate in some segments
    left[:, 20:] += 0.3 * random.normal(size=(orders, 1, channels))
    right[:, 20:] = np.where(np.arange(right.shape[1] - 20)[:, np.newaxis] % 7 == 3, right[:, 20:], left[:, 20:] * 0.9)
    left[-1, 40:] *= 1.5
    if orders > 2:
        left[-1, 30:33] += 1e7 ** (orders - 2)
    return HermiteSegments(time[:-1], time[1:], left, right)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_peak_means_and_crossings(shape: tuple[int, int], seed: int) -> None:
    """They are those of the densely sampled interpolant without the orders that diverge."""
    signal = drawn(*shape, seed)
    analysis, kept = Analysis(signal), signal.consistent
    assert analysis.diverging == np.count_nonzero(np.any(kept.left != signal.left, axis=(0, 2))) > 0 or shape[0] == 2
    theta = np.linspace(0.0, 1.0, 2001)
    sizes = np.linalg.norm(kept.evaluate(theta), axis=2)
    peak, exceeded = analysis.peak()
    assert sizes.max() <= peak <= sizes.max() * (1.0 + 1e-5)
    assert exceeded >= analysis.errors[sizes.max(axis=0).argmax()] * (1.0 - 1e-9)
    points, weights = np.polynomial.legendre.leggauss(2 * shape[0] + 1)
    for order in range(3):
        squares = np.sum(kept.evaluate(0.5 * (points + 1.0), order) ** 2, axis=2)
        mean = 0.5 * weights @ squares @ kept.duration / kept.duration.sum()
        assert analysis.mean_products(order)[0] == pytest.approx(mean, rel=1e-9)
    for share in (0.0, 0.2, 0.9, 0.999):
        row, segment = np.argwhere(share * peak <= sizes.T)[-1][::-1]
        last, spacing = kept.start[segment] + theta[row] * kept.duration[segment], kept.duration[segment] / 2000
        assert -1e-12 <= analysis.last_time_above(share * peak) - last <= spacing * (1.0 + 1e-9)
    assert analysis.last_time_above(1.001 * peak) is None


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape[1] == 1], ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_parts(shape: tuple[int, int], seed: int) -> None:
    """Extremes with their sign and integrals of both parts are those of the densely sampled interpolant; errors cover one part."""
    signal = drawn(*shape, seed)
    analysis, kept = Analysis(signal), signal.consistent
    parts, values = analysis.parts(), kept.evaluate((np.arange(4000) + 0.5) / 4000)[..., 0]
    assert parts[:2] == pytest.approx([values.max(), -values.min()], rel=1e-4)
    integrals = [np.maximum(sign * values, 0.0).mean(axis=0) @ kept.duration for sign in (1.0, -1.0)]
    assert parts[2:4] == pytest.approx(integrals, rel=1e-5)
    assert max(parts[:2]) == pytest.approx(analysis.peak()[0], rel=1e-10)
    assert min(parts[5:]) > 0.0
    assert max(parts[5:]) <= analysis.errors @ signal.duration <= sum(parts[5:]) * (1.0 + 1e-9)


def test_nan_does_not_hide() -> None:
    """A NaN in any derivative makes the peak NaN."""
    signal = drawn(3, 2, 1)
    for order in range(3):
        broken = signal.right.copy()
        broken[order, 7, 1] = np.nan
        assert np.isnan(Analysis(HermiteSegments(signal.start, signal.end, signal.left, broken)).peak()[0])
    signal = drawn(3, 1, 1)
    signal.right[0, 7, 0] = np.nan
    assert np.isnan(Analysis(signal).parts()[:4]).all()


def test_no_segments_have_no_peak() -> None:
    """A run that ends before the dwell."""
    nothing = Analysis(drawn(5, 2, 0).within(1e3, 2e3))
    assert nothing.peak() == (0.0, 0.0)
    assert nothing.last_time_above(0.0) is None
    assert Analysis(drawn(3, 1, 0).within(1e3, 2e3)).parts() == (0.0,) * 7


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C code with a main program, under the sanitizers."""
    folder, program = Path(compiled.__file__).with_name("c-metrics"), tmp_path_factory.mktemp("metrics") / "analyse"
    sources: Sequence[Path] = [*sorted(folder.glob("*.c")), Path(__file__).with_name("c") / "analyse.c"]
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-fno-math-errno"]
    compiler = find_compiler(native_platform()).command
    command = [*compiler, *flags, *SANITIZERS, f"-I{folder}", *map(str, sources), "-o", str(program), "-lm"]
    subprocess.run(command, check=True)
    return program


@pytest.mark.slow
@pytest.mark.parametrize("shape", [*SHAPES, (1, 2)], ids=str)
@pytest.mark.parametrize("count", [60, 1])
def test_under_the_sanitizers(shape: tuple[int, int], count: int, sanitized: Path) -> None:
    """No access beside an array, no undefined behaviour, and the library's results."""
    signal = drawn(*shape, seed=3)
    signal = signal.select(np.arange(60) < count)
    (m, channels), order = shape, min(2, shape[0] - 1)
    ours = Analysis(signal)
    level = 0.7 * ours.peak()[0]
    matrices, quadrature = compiled.control_matrices(m), compiled.quadrature_of(m, order)
    arrays = [np.array(level), signal.duration, signal.left, signal.right, *matrices, *quadrature]
    sizes = np.array([count, channels, m, 2 * m + 1, order], dtype=np.uint64)
    given = sizes.tobytes() + b"".join(np.ascontiguousarray(each).tobytes() for each in arrays)
    text = subprocess.run([str(sanitized)], input=given, check=True, capture_output=True).stdout.decode().split()
    found = [float.fromhex(each) if "x" in each else float(each) for each in text]
    # the program prints integrals, the crossing by segment and theta, and the parts of a single channel
    found, parts = found[:-7], found[-7:]
    np.testing.assert_allclose(parts, ours.parts() if channels == 1 else np.zeros(7), rtol=1e-12)
    segment, theta = int(found.pop(-2)), found.pop(-1)
    found.append(signal.start[segment] + theta * signal.duration[segment])
    integrals = np.multiply(ours.mean_products(order), signal.duration.sum())
    expected = [ours.diverging, *ours.peak(), *integrals, 1.0, ours.last_time_above(level)]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
