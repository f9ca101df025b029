"""Exhaustive search through all sets of effects, for comparison with the automatic choice in `effect_choice.py`. Not a script of its own."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from flexfmu.cosim.design.effects.estimator import RICHEST, Estimator, with_set
from flexfmu.model.scene.schema import Scene

FAMILIES = ("proximal_bending", "proximal_axial", "distal_bending", "distal_axial")


@dataclass(frozen=True)
class Smallest:
    """The smallest set whose observed error is within a tolerance, and how many sets were run to find it."""

    scene: Scene
    observed: float
    runs: int


def smallest(
    scenes: Iterable[Scene], estimator: Estimator, error: Callable[[Scene], float], tolerance: float, margin: float
) -> Smallest | None:
    """Run sets, those with fewest effects first, until one is within the tolerance; None if none is.

    Args:
        scenes: the sets.
        estimator: sets whose estimated error is beyond ``margin`` times what is allowed aren't run.
        error: runs a set and observes its error.
        tolerance: largest observed error.
        margin: infinite to run every set.
    """
    runs = 0
    for _, same_size in itertools.groupby(sorted(scenes, key=set_size), key=set_size):
        ranked = sorted(((_estimate(estimator, each), each) for each in same_size), key=lambda pair: pair[0])
        for candidate in (each for estimate, each in ranked if estimate <= margin):
            observed, runs = error(candidate), runs + 1
            if observed < tolerance:
                return Smallest(candidate, observed, runs)
    return None


def _estimate(estimator: Estimator, scene: Scene) -> float:
    return max(estimator.errors(scene.effects).values())


def all_sets(scene: Scene) -> Iterator[Scene]:
    """Every set within the richest one; families of one mode also deflecting statically, where their tips move."""
    for counts in itertools.product(*(range(RICHEST[family] + 1) for family in FAMILIES)):
        modes = dict(zip(FAMILIES, counts, strict=True))
        single = [family for family, count in modes.items() if count == 1 and family != "distal_bending"]
        statics = itertools.chain.from_iterable(itertools.combinations(single, n) for n in range(len(single) + 1))
        bends = bool(modes["proximal_bending"] or modes["distal_bending"])
        for static, beam, short in itertools.product(statics, ("euler-bernoulli", "timoshenko"), (False, True)):
            if any(counts) >= (beam == "timoshenko") and bends >= short:
                yield with_set(scene, {**modes, "quasi_static": list(static), "beam": beam, "foreshortening": short})


def set_size(scene: Scene) -> int:
    """Number of effects: modes of every family, shear and rotary inertia, foreshortening."""
    effects = scene.effects
    return (
        sum(getattr(effects, family) for family in FAMILIES) + (effects.beam == "timoshenko") + effects.foreshortening
    )
