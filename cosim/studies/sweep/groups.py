"""Which cases of a sweep share an FMU, and which are simulated side by side: both follow from the list of cases alone."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from math import ceil
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from flexfmu.cosim.experiment.parameters import scene_values
from flexfmu.cosim.experiment.scene_build import depends_on
from flexfmu.cosim.many.lockstep import PeakMeasure
from flexfmu.cosim.many.variants import BAND, DURATION, FEW, Variant
from flexfmu.cosim.studies.sweep.cases import Cases, Grid, Sample, Span, changes_of
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.keys import full_key
from flexfmu.model.scene.schema import Scene

PLANNED_WITH = (
    "mechanism.base_half_distance",
    "mechanism.proximal.length",
    "mechanism.distal.length",
    "trajectory.start",
)
"""Parameters of the FMU that the planned motion depends on as well."""

LOOP = tuple(name for name, field in Scene.model_fields.items() if field.default == ())
"""Sections around the robot, which may depend on everything."""

SHARES, LEAST_SHARE = 32, 64
"""Shares of the cases that are simulated side by side, and the smallest number of cases in one."""

MOST_PEAKS, MOST_RECORDED = 1000, 250
"""Largest numbers of cases in a share, of which peaks alone are measured, or anything: half a second or a second of work."""


class Share(NamedTuple):
    """Cases that a process simulates at once.

    Attributes:
        group: number of their group.
        numbers: of the cases.
    """

    group: int
    numbers: Sequence[int]

    def parts(self) -> list[Share]:
        """Its cases one by one."""
        return [Share(self.group, (number,)) for number in self.numbers]


@dataclass(frozen=True)
class Group:
    """Cases that share an FMU.

    Attributes:
        numbers: of the cases.
        scene: the scene that the FMU is built from.
        parameters: key of the scene → FMU parameters that a case sets directly; None where each case is planned as a scene
            of its own, and the FMU gets all of its values.
    """

    numbers: Sequence[int]
    scene: Scene
    parameters: Mapping[str, tuple[str, ...]] | None

    def variant(self, changes: Mapping[str, Any], scene: Scene) -> Variant:
        """What a case changes in the group's scene (in the sweep's without ``parameters``); ``scene`` is that of the case."""
        if self.parameters is None:
            return Variant(changes, {})
        values: dict[str, float] = {}
        for key, names in self.parameters.items():
            new, old = _components(scene, key), _components(self.scene, key)
            values |= {name: a for name, a, b in zip(names, new, old, strict=True) if a != b}
        return Variant({key: value for key, value in changes.items() if not depends_on(key)}, values)


def _components(scene: Scene, key: str) -> tuple[float, ...]:
    """The number or the vector that a key is in a scene."""
    value = reduce(getattr, key.split("."), scene)
    return value if isinstance(value, tuple) else (value,)  # type: ignore[return-value]


def groups_of(scene: Scene, cases: Cases) -> list[Group]:
    """The groups of cases that share an FMU."""
    own = scene_values(scene).values()
    known, has = {each.key for each in own}, {each.key for each in own if each.value}
    data = scene.model_dump(exclude_none=True)
    keys = [full_key(data, key) for key in cases.keys]
    whole = [key.partition("[")[0] for key in keys]
    # keys that are parameters of the FMU, and keys that need another FMU
    settable = [i for i, key in enumerate(whole) if key in known and depends_on(key)]
    building = [i for i, key in enumerate(keys) if depends_on(key) and i not in settable]
    members: dict[str, list[int]] = {}
    if building:
        for number in range(len(cases)):
            values = cases[number]
            members.setdefault(repr([values[i] for i in building]), []).append(number)
    # an effect that some case has must be in the FMU of all, also where the scene lacks it
    lacking = [i for i in settable if whole[i] not in has]
    present = {cases.keys[i]: value for i in lacking if (value := _some_value(cases, i)) is not None}
    found = []
    for numbers in members.values() if building else [range(len(cases))]:
        changes = changes_of(cases, numbers[0])
        other = {cases.keys[i]: changes[cases.keys[i]] for i in building if cases.keys[i] in changes}
        found.append(_group(scene, cases, numbers, other, present, [whole[i] for i in settable]))
    return found


def _group(
    scene: Scene,
    cases: Cases,
    numbers: Sequence[int],
    own: Mapping[str, Any],
    present: Mapping[str, Any],
    settable: Collection[str],
) -> Group:
    """A group of cases that differ in ``settable`` keys and in those without influence on the FMU."""
    for changes in ({**own, **present}, own, changes_of(cases, numbers[0])):
        try:
            built = scene.replace(dict(changes))
        except SceneError:
            continue
        # a motion that depends on nothing that varies, of a robot alone
        alone = not any(getattr(built, name) for name in LOOP) and not any(key.startswith(LOOP) for key in cases.keys)
        is_direct = built.cosimulation.drive == "motion" and alone and not any(key in PLANNED_WITH for key in settable)
        if not is_direct:
            return Group(numbers, built, None)
        names: dict[str, tuple[str, ...]] = {}
        for name, each in scene_values(built).items():
            if each.key in settable:
                names[each.key] = (*names.get(each.key, ()), name)
        return Group(numbers, built, names)
    # each case tells what is wrong with it
    return Group(numbers, scene, None)


def _some_value(cases: Cases, place: int) -> Any:
    """A value of a key that switches its effect on, if there is one; None if there isn't."""
    values: Iterable[Any]
    if isinstance(cases, Grid):
        values = cases.levels[place]
    elif isinstance(cases, Sample):
        each = cases.values[place]
        values = (each.at(0.5), each.high) if isinstance(each, Span) else each
    else:
        values = (cases[number][place] for number in range(len(cases)))
    return next((value for value in values if np.any(value) and not isinstance(value, str)), None)


def shares_of(groups: Sequence[Group], cases: Cases, measure: Any, *, together: bool) -> Iterator[Share]:
    """Yield all cases in shares: many that are simulated side by side, all others alone.

    Args:
        groups: of the cases.
        cases: of the sweep.
        measure: what is measured of them.
        together: whether any may be simulated side by side.
    """
    peaks = isinstance(measure, PeakMeasure)
    largest = MOST_PEAKS if peaks else MOST_RECORDED
    for index, group in enumerate(groups):
        bands = _bands(group, cases, peaks) if together and group.parameters is not None else [group.numbers]
        for band in bands:
            if len(band) < FEW or not together or group.parameters is None:
                yield from (Share(index, (number,)) for number in band)
                continue
            size = min(largest, max(LEAST_SHARE, ceil(len(band) / SHARES)))
            parts = ceil(len(band) / size)
            for i in range(parts):
                yield Share(index, band[i * len(band) // parts : (i + 1) * len(band) // parts])


def _bands(group: Group, cases: Cases, peaks: bool) -> list[Sequence[int]]:
    """The cases of a group by motion; for peaks motions of one shape are together, in bands of similar durations."""
    places = [i for i, key in enumerate(cases.keys) if not depends_on(key)]
    if not places:
        return [group.numbers]
    lasting = next((i for i in places if peaks and cases.keys[i] == DURATION), None)
    shapes: dict[str, list[int]] = {}
    duration: dict[int, float] = {}
    for number in group.numbers:
        values = cases[number]
        shapes.setdefault(repr([values[i] for i in places if i != lasting]), []).append(number)
        if lasting is not None:
            value = group.scene.trajectory.duration if values[lasting] is None else values[lasting]
            duration[number] = float(value) if isinstance(value, Real) else 0.0
    if lasting is None:
        return [*shapes.values()]
    # bands of similar durations, the longest first
    bands: list[Sequence[int]] = []
    for numbers in shapes.values():
        numbers.sort(key=lambda number: -duration[number])
        first = 0
        for k in range(1, len(numbers) + 1):
            if k == len(numbers) or duration[numbers[first]] > BAND * duration[numbers[k]]:
                bands.append(numbers[first:k])
                first = k
    return bands
