"""Some metrics of a run by name, as measures of variants; peaks of outputs are found without recordings."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metrics import check_names, metrics_of
from flexfmu.cosim.metrics.signals import ACCELERATION, FIRST_BENDING, POSITION, TIP_DEFLECTIONS, TORQUES, VELOCITY

PEAKS: Mapping[str, str] = {
    **{f"peak_torque_{joint}": name for joint, name in enumerate(TORQUES, start=1)},
    **{f"peak_tip_deflection_{leg}": name for leg, name in enumerate(TIP_DEFLECTIONS, start=1)},
}
"""Metrics that are the largest magnitude of one output over the motion → name of the output."""


SIGNALS = (*TORQUES, *TIP_DEFLECTIONS, *POSITION, *VELOCITY, *ACCELERATION, FIRST_BENDING, f"der({FIRST_BENDING},2)")
"""The recorded signals that any metric of a motion-driven robot needs."""


@dataclass(frozen=True)
class ChosenMetrics:
    """The values of some metrics of a run, by name; None for no value.

    Attributes:
        names: names of the metrics.
    """

    names: tuple[str, ...]

    def __call__(self, run: Run) -> dict[str, float | None]:
        """Measure a run."""
        found = metrics_of(run, self.names)
        return {name: found[name] for name in self.names}

    @property
    def signals(self) -> Sequence[str]:
        """The outputs that the metrics need, with two derivatives."""
        return SIGNALS


@dataclass(frozen=True)
class PeakMetrics(ChosenMetrics):
    """The values of metrics that are peaks of outputs, see `PEAKS`."""

    @property
    def outputs(self) -> Sequence[str]:
        """Names of the outputs."""
        return tuple(PEAKS[name] for name in self.names)

    def of_peaks(self, peaks: Mapping[str, float]) -> dict[str, float | None]:
        """The metrics from the peaks, name of an output → largest magnitude over the motion."""
        return {name: peaks[PEAKS[name]] for name in self.names}


def measuring(names: Collection[str]) -> ChosenMetrics:
    """Return the measure of these metrics, as a sweep takes it: ``run_variants(scene, variants, measuring(names))``.

    `flexfmu.cosim.many.variants.run_variants` then simulates variants side by side; peaks of torques and of tip
    deflections alone are the fastest.

    Raises:
        InputError: there is no metric of such a name.
    """
    check_names(names)
    return (PeakMetrics if all(name in PEAKS for name in names) else ChosenMetrics)(tuple(names))
