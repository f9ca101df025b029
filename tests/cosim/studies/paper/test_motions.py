"""The paper's tables of trajectories: lengths and accelerations, against the printed figures."""

from __future__ import annotations

import numpy as np
import pytest

from flexfmu.cosim.experiment.planning import plan
from flexfmu.cosim.studies.paper.comparison import ComparisonTable, QuantityComparison, compare, printed_table
from flexfmu.cosim.studies.paper.computed import (
    POINTS,
    maximum,
    motion_evaluators,
    path_length,
    smooth_pieces,
    trajectory_scene,
)
from flexfmu.cosim.studies.paper.spectra import WINDOW, acceleration_spectrum, band_average


def computed(key: str) -> ComparisonTable:
    return compare(printed_table(key), motion_evaluators())


@pytest.fixture(scope="module")
def task_accelerations() -> QuantityComparison:
    return computed("table-05").comparisons[0]


@pytest.fixture(scope="module")
def joint_accelerations() -> QuantityComparison:
    return computed("table-06").comparisons[0]


def test_blend_lengths() -> None:
    """Table 2: the Lamé and polar blends are as long as printed, to five digits."""
    lengths = computed("table-02").comparisons[0]
    for curve in ("Lamé", "Polar"):
        assert abs(lengths.cell(curve, "Length").relative_error) < 1e-5
    assert lengths.cell("Extended Lamé", "Length").agrees_to_the_digits
    assert abs(lengths.cell("Extended Clothoid", "Length").relative_error) < 5e-4


@pytest.mark.parametrize(
    ("curve", "printed"), [("Lamé", 0.3843), ("Clot.", 0.3840), ("Lamé Ext", 0.3687), ("Clot. Ext", 0.3751)]
)
def test_path_lengths(curve: str, printed: float) -> None:
    """Table 11: all four paths are as long as printed."""
    assert round(path_length(curve), 4) == printed


def test_task_accelerations(task_accelerations: QuantityComparison) -> None:
    """Table 5: Lamé and polar within 0.1 %, but for the one cell that is 1.1 % off."""
    for cell in task_accelerations.cells:
        if cell.column != "Clothoid":
            bound = 0.011 if (cell.row, cell.column) == ("1/8 Trapezoidal", "Polar") else 0.001
            assert abs(cell.relative_error) < bound, cell


def test_joint_accelerations(joint_accelerations: QuantityComparison) -> None:
    """Table 6: Lamé within 0.5 %; the other curves within 2.5 %."""
    for cell in joint_accelerations.cells:
        assert abs(cell.relative_error) < (0.005 if cell.column == "Lamé" else 0.025), cell


def test_a_maximum_is_not_missed_between_samples() -> None:
    """Twice as many samples change no peak by more than 1e-6: the tables' digits don't depend on the sampling."""
    joints = plan(trajectory_scene("7th order polynomial", "Clothoid")).joints
    coarse = maximum(joints, lambda derivatives: derivatives[2, :, 0])
    fine = max(d[2, :, 0].max() for _, d in smooth_pieces(joints, 2 * POINTS))
    assert coarse == pytest.approx(fine, rel=1e-6)


def test_spectrum_has_the_energy_of_the_motion() -> None:
    """Parseval: the integral of the density over frequency is the mean square over the window."""
    joints = plan(trajectory_scene("7th order polynomial", "Lamé")).joints
    frequency, density = acceleration_spectrum(joints, 0)
    energy = sum(np.trapezoid(d[2, :, 0] ** 2, time) for time, d in smooth_pieces(joints, 2001))
    assert np.sum(density) * (frequency[1] - frequency[0]) == pytest.approx(energy / WINDOW, rel=1e-6)


def test_band_average_keeps_a_constant_and_the_energy_within() -> None:
    """Averaging may smooth a spectrum but not shift or scale it."""
    frequency = np.arange(0.0, 100.0, 0.25)
    assert band_average(frequency, np.full(frequency.size, 3.0), 5.0) == pytest.approx(3.0)
    peak = np.zeros(frequency.size)
    peak[200] = 1.0
    averaged = band_average(frequency, peak, 5.0)
    assert averaged.sum() == pytest.approx(1.0)
    assert np.average(frequency, weights=averaged) == pytest.approx(50.0)


def test_shorter_cycles_put_more_energy_at_the_resonance() -> None:
    """The paper's conclusion from Fig. 10: halving the cycle time raises the spectrum at 58 Hz."""
    scene = trajectory_scene("7th order polynomial", "Lamé")
    at_resonance = []
    for duration in (1.0, 0.5, 0.25):
        frequency, density = acceleration_spectrum(plan(scene.replace({"trajectory.duration": duration})).joints, 0)
        at_resonance.append(band_average(frequency, density, 10.0)[np.searchsorted(frequency, 58.0)])
    assert at_resonance[0] < at_resonance[1] < at_resonance[2]


def test_both_joints_have_the_same_spectrum() -> None:
    """The path is its own mirror image, so joint 2 does backwards what joint 1 does: Fig. 8 shows one spectrum."""
    joints = plan(trajectory_scene("7th order polynomial", "Lamé")).joints
    (_, first), (_, second) = (acceleration_spectrum(joints, joint) for joint in (0, 1))
    assert second == pytest.approx(first, rel=1e-6, abs=1e-10 * first.max())
