"""The analysis of segments in C against that with numpy, under the sanitizers too, and what happens without a compiler."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from flexfmu.cosim.metrics import analysis as compiled
from flexfmu.cosim.metrics.analysis import CompiledAnalysis, NumpyAnalysis, analyse
from flexfmu.cosim.metrics.segments import HermiteSegments
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


@pytest.fixture(autouse=True)
def _there_is_a_compiler() -> None:
    assert compiled.library() is not None


@pytest.mark.parametrize("shape", SHAPES, ids=str)
@pytest.mark.parametrize("seed", range(8))
def test_c_finds_what_numpy_finds(shape: tuple[int, int], seed: int) -> None:
    """Orders left out, peak and its error, means of products, and last crossings of levels, to rounding."""
    signal = drawn(*shape, seed)
    ours, theirs = analyse(signal), NumpyAnalysis(signal)
    assert isinstance(ours, CompiledAnalysis)
    np.testing.assert_array_equal(ours.kept, signal._kept_orders())
    peak = ours.peak()
    np.testing.assert_allclose([*peak, *ours.errors], [*theirs.peak(), *theirs.errors], rtol=1e-9, atol=1e-14 * peak[0])
    for order in range(3):
        products = ours.mean_products(order)
        value, error = np.sqrt(products[0]), np.sqrt(products[2])
        differences = np.subtract(products, theirs.mean_products(order)) / [value**2, value * error, error**2]
        assert np.abs(differences).max() < 1e-9
    for share in (0.0, 0.2, 0.9, 0.999):
        expected = theirs.last_time_above(share * peak[0])
        assert expected is not None
        assert ours.last_time_above(share * peak[0]) == pytest.approx(expected, rel=1e-12)
    assert ours.last_time_above(1.001 * peak[0]) is theirs.last_time_above(1.001 * peak[0]) is None


@pytest.mark.parametrize("shape", [shape for shape in SHAPES if shape[1] == 1], ids=str)
@pytest.mark.parametrize("seed", range(8))
def test_parts_in_c_are_those_of_numpy(shape: tuple[int, int], seed: int) -> None:
    """Extremes with their sign, integrals of both parts, and their errors; the parts sum up to the mean."""
    signal = drawn(*shape, seed)
    ours, theirs = analyse(signal).parts(), NumpyAnalysis(signal).parts()
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    assert max(ours[:2]) == pytest.approx(analyse(signal).peak()[0], rel=1e-10)
    points, weights = signal.quadrature
    integral = weights @ signal.consistent.evaluate(points)[..., 0] @ signal.duration
    assert ours[2] - ours[3] == pytest.approx(integral, rel=1e-9, abs=1e-9 * ours[2])


def test_signals_diverge_where_they_should() -> None:
    """The drawn signals reach the truncated orders, unknown nodes and continuous nodes; otherwise the comparison is empty."""
    signal = drawn(5, 2, 0)
    assert signal.consistent is not signal
    known = ~np.isnan(signal._highest_derivatives[:, :, 0])
    assert known.any()
    assert (~known).all(axis=0).any()


def test_nan_does_not_hide() -> None:
    """A NaN in any derivative makes the peak NaN."""
    signal = drawn(3, 2, 1)
    for order in range(3):
        broken = signal.right.copy()
        broken[order, 7, 1] = np.nan
        assert np.isnan(analyse(HermiteSegments(signal.start, signal.end, signal.left, broken)).peak()[0])
    signal = drawn(3, 1, 1)
    signal.right[0, 7, 0] = np.nan
    for analysis in (analyse(signal), NumpyAnalysis(signal)):
        assert np.isnan(analysis.parts()[:4]).all()


def test_no_segments_have_no_peak() -> None:
    """A run that ends before the dwell."""
    nothing = drawn(5, 2, 0).within(1e3, 2e3)
    for analysis in (analyse(nothing), NumpyAnalysis(nothing)):
        assert analysis.peak() == (0.0, 0.0)
        assert analysis.last_time_above(0.0) is None
    for analysis in (analyse(drawn(3, 1, 0).within(1e3, 2e3)), NumpyAnalysis(drawn(3, 1, 0).within(1e3, 2e3))):
        assert analysis.parts() == (0.0,) * 7


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Metrics are then calculated with numpy."""
    monkeypatch.setenv("CC", "there-is-no-such-compiler")
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path))
    assert compiled.library.__wrapped__() is None


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The C code with a main program, under the sanitizers."""
    folder, program = Path(compiled.__file__).with_name("c-metrics"), tmp_path_factory.mktemp("metrics") / "analyse"
    sources: Sequence[Path] = [*sorted(folder.glob("*.c")), Path(__file__).with_name("c") / "analyse.c"]
    flags = (
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        "-ffp-contract=off",
        "-fno-math-errno",
        *SANITIZERS,
    )
    compiler = find_compiler(native_platform()).command
    command = [*compiler, *flags, f"-I{folder}", *map(str, sources), "-o", str(program), "-lm"]
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
    ours = CompiledAnalysis(signal.start, signal.duration, signal.left, signal.right)
    level = 0.7 * ours.peak()[0]
    matrices, quadrature = compiled._matrices(m), compiled._quadrature(m, order)
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
