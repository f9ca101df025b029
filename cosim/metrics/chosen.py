"""Some metrics of a run by name, as measures of variants; peaks of outputs are found without recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import ALL_METRICS
from flexfmu.cosim.metrics.metrics import metrics_of
from flexfmu.cosim.metrics.signals import TIP_DEFLECTIONS, TORQUES

PEAKS: Mapping[str, str] = {
    **{f"peak_torque_{joint}": name for joint, name in enumerate(TORQUES, start=1)},
    **{f"peak_tip_deflection_{leg}": name for leg, name in enumerate(TIP_DEFLECTIONS, start=1)},
}
"""Metrics that are the largest magnitude of one output over the motion → name of the output."""


@dataclass(frozen=True)
class ChosenMetrics:
    """The values of some metrics of a run, by name; None for no value.

    Attributes:
        names: names of the metrics.
    """

    names: tuple[str, ...]

    def __call__(self, run: Run) -> dict[str, float | None]:
        """Measure a run."""
        found = metrics_of(run)
        return {name: found[name] for name in self.names}


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


def chosen_metrics(*names: str) -> ChosenMetrics:
    """The measure of some metrics, for `flexfmu.cosim.experiment.variants.run_variants`.

    Peaks of torques and of tip deflections alone are the fastest: variants are then simulated side by side.

    Raises:
        InputError: there is no such metric.
    """
    for name in names:
        if name not in ALL_METRICS:
            near = get_close_matches(name, ALL_METRICS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are: {', '.join(ALL_METRICS)}"
            raise InputError(f"there is no metric {name!r}; {hint}")
    return (PeakMetrics if all(name in PEAKS for name in names) else ChosenMetrics)(names)
