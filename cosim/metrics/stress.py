"""Stress along the links from their modal coordinates.

A link of radius r and length L bends to w = sum phi_k(xi) q_k and stretches by u in the same way, so the stress of its outer
fibres is E r w'' / L² from bending and E u' / L from stretching (Euler-Bernoulli; with Timoshenko's beam w'' is the change of
the sections' rotation). The larger sum of both magnitudes is that of one of the two outer fibres.

Stresses converge more slowly with the number of modes than deflections, as they are derivatives of the shapes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.results import Recording
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.signals import segments
from flexfmu.model.beams import LINKS, Direction, LinkGroup, fibre_strains
from flexfmu.model.scene.schema import Scene

PLACES = np.linspace(0.0, 1.0, 101)
"""Normalised places along a link, its base first."""

INSTANTS = np.linspace(0.0, 1.0, 5)
"""Normalised times of each communication step."""

BLOCK = 5000
"""Instants that are evaluated at once, for little memory."""


@dataclass(frozen=True)
class StressPeak:
    """The largest magnitude of a stress.

    Attributes:
        value: [Pa].
        place: distance from the link's base [m].
        time: [s].
    """

    value: float
    place: float
    time: float


@dataclass(frozen=True)
class LinkStress:
    """The stresses of a link over a run; None for what isn't known because the link has no such modes.

    Attributes:
        link: `link11`, `link21`, `link12` or `link22`.
        bending, axial: of the outer fibres, by bending and by stretching.
        combined: of both together; of the one that is known where the other isn't.
        change: by how much the peak of the combined stress changes without the highest mode of each family, relative; a
            measure of the truncation of modes. None where a family has only one.
        yield_strength: of the material [Pa]; None if the scene doesn't say.
    """

    link: str
    bending: StressPeak | None
    axial: StressPeak | None
    combined: StressPeak | None
    change: float | None
    yield_strength: float | None

    @property
    def safety(self) -> float | None:
        """Yield strength over the peak of the combined stress; None where one of them isn't known."""
        if self.combined is None or self.yield_strength is None or self.combined.value == 0.0:
            return None
        return self.yield_strength / self.combined.value

    @property
    def exceeded(self) -> Iterator[str]:
        """A sentence if the yield strength is exceeded: by how much, when and where."""
        peak, limit = self.combined, self.yield_strength
        if peak is not None and limit is not None and not peak.value <= limit:
            yield (
                f"{self.link}: stress of {1e-6 * peak.value:.4g} MPa at {peak.time:.4g} s, {1e3 * peak.place:.4g} mm from its "
                f"base, exceeds the yield strength of {1e-6 * limit:g} MPa"
            )


def link_stresses(run: Run) -> tuple[LinkStress, ...]:
    """Return the stresses of all four links over motion and dwell.

    Peaks are looked for at 101 places of each link and 5 instants of each communication step.

    Args:
        run: with the modal coordinates and their derivatives.

    Raises:
        ResultsError: the derivatives of a modal coordinate were not recorded.
    """
    scene = run.robot
    return tuple(_stress(run.recording, scene, link, group) for link, group in LINKS)


def _stress(recording: Recording, scene: Scene, link: str, group: LinkGroup) -> LinkStress:
    """Return the stresses of a link, with all modes, and the change without the highest ones."""
    limit = scene.mechanism.material.yield_strength
    length = getattr(scene.mechanism, group).length
    families = [_family(recording, scene, link, group, direction) for direction in ("bending", "axial")]
    known = [family for family in families if family is not None]
    if not known or recording.time.size < 2:
        return LinkStress(link, None, None, None, None, limit)
    peaks = [None if family is None else _peak(recording, [family], length) for family in families]
    combined = _peak(recording, known, length) if len(known) == 2 else peaks[0] or peaks[1]
    fewer = [(names[:-1], gains[:-1]) for names, gains in known]
    change = None
    if all(names for names, _ in fewer) and combined is not None and combined.value:
        change = abs(_peak(recording, fewer, length).value / combined.value - 1.0)
    return LinkStress(link, peaks[0], peaks[1], combined, change, limit)


_Family = tuple[Sequence[str], RealArray]
"""Names of the modal coordinates, and their stresses (modes, places) [Pa/m]."""


def _family(recording: Recording, scene: Scene, link: str, group: LinkGroup, direction: Direction) -> _Family | None:
    """Return the modes of a link in one direction; None if it is rigid there, or they were not recorded."""
    names, strains = fibre_strains(scene, link, group, direction, PLACES)
    if not names or any(name not in recording.columns for name in names):
        return None
    return names, scene.mechanism.material.youngs_modulus * strains


def strain_gains(scene: Scene, link: str, place: float) -> dict[str, float]:
    """Modal coordinates → strain of a link's outer fibre for each [1/m].

    Args:
        scene: the scene.
        link: `link11`, `link21`, `link12` or `link22`.
        place: distance from its base, relative to its length, 0 to 1.

    Raises:
        InputError: the place is elsewhere, or the link is rigid.
    """
    if not 0.0 <= place <= 1.0:
        raise InputError(f"{link}.strain[{place:g}]: the place goes from 0, the link's base, to 1, its tip")
    found, at = dict[str, float](), np.array([place])
    for direction in ("bending", "axial"):
        names, gains = fibre_strains(scene, link, dict(LINKS)[link], direction, at)
        found |= zip(names, gains[:, 0].tolist(), strict=True)
    if not found:
        raise InputError(f"{link}.strain[{place:g}]: {link} is rigid in scene {scene.name}: give it modes in [effects]")
    return found


def _peak(recording: Recording, families: Sequence[_Family], length: float) -> StressPeak:
    """Return the largest sum of the magnitudes of the families' stresses."""
    signals = [segments(recording, names) for names, _ in families]
    gains = [gain for _, gain in families]
    # coordinates at all instants (N, modes), and upper bounds of the stress there
    values = [np.concatenate(each.evaluate(INSTANTS).swapaxes(0, 1)) for each in signals]
    bounds = sum((np.abs(q) @ np.abs(gain).max(axis=1) for q, gain in zip(values, gains, strict=True)), np.zeros(1))

    def stress(chosen: NDArray[np.intp]) -> RealArray:
        parts = [np.abs(q[chosen] @ gain) for q, gain in zip(values, gains, strict=True)]
        return np.asarray(np.sum(parts, axis=0))

    # only instants whose bound reaches the largest stress where the bound is largest
    reached = float(stress(np.array([np.argmax(bounds)])).max())
    candidates = np.flatnonzero(bounds >= reached)
    best = StressPeak(0.0, 0.0, float(recording.time[0]))
    for first in range(0, candidates.size, BLOCK):
        chosen = candidates[first : first + BLOCK]
        found = stress(chosen)
        row, place = np.unravel_index(int(np.argmax(found)), found.shape)
        if found[row, place] > best.value:
            step, instant = divmod(int(chosen[row]), INSTANTS.size)
            time = signals[0].start[step] + INSTANTS[instant] * signals[0].duration[step]
            best = StressPeak(float(found[row, place]), length * float(PLACES[place]), float(time))
    return best
