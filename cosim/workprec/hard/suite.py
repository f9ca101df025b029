"""All cases, and what running them gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

from flexfmu.cosim.errors import CosimError, InputError
from flexfmu.cosim.workprec.hard import gain, motions, parameters, repetition, singularity, steps, sticking, stiffness
from flexfmu.cosim.workprec.hard.case import Finding, HardCase
from flexfmu.model.errors import EquilibriumError
from flexfmu.trajectories.errors import TrajectoryError

FAMILIES = (singularity, stiffness, parameters, motions, steps, sticking, gain, repetition)


@dataclass(frozen=True)
class Result:
    """A case with what happened.

    Attributes:
        case: what was run.
        finding: what was found.
    """

    case: HardCase
    finding: Finding


def hard_cases(only: Sequence[str] = ()) -> tuple[HardCase, ...]:
    """The cases in the order of the table.

    Args:
        only: parts of the names of those that are wanted; all when empty.

    Raises:
        InputError: no case has such a name.
    """
    cases = tuple(chain.from_iterable(family.cases() for family in FAMILIES))
    for part in only:
        if not any(_has(case, part) for case in cases):
            raise InputError(
                f"no hard case has {part!r} in its name; there are: {'; '.join(case.name for case in cases)}"
            )
    return tuple(case for case in cases if not only or any(_has(case, part) for part in only))


def run_cases(cases: Iterable[HardCase], announce: Callable[[str], object]) -> list[Result]:
    """Run them one after the other; a case that can't be run has failed.

    Args:
        cases: which.
        announce: told what is being run.

    Raises:
        BuildError: an FMU can't be built.
    """
    results = []
    for case in cases:
        announce(case.name)
        results.append(Result(case, _finding(case)))
    return results


def _finding(case: HardCase) -> Finding:
    try:
        return case.run()
    except (CosimError, EquilibriumError, TrajectoryError) as failure:
        return Finding(f"{type(failure).__name__}: {failure}", ())


def _has(case: HardCase, part: str) -> bool:
    return part.casefold() in case.name.casefold()
