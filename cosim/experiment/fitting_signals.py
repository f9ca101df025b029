"""What would fit where a connection is wrong: signals of nearly the same name, and signals of the same unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.engine.slave import Slave

MISSPELT = 0.9
"""Similarity (`difflib`) from which the name of an unused output counts as a misspelt input of the robot."""

NEAREST = 8
"""Number of signals in a message where no unit tells which ones fit."""


def no_source(slaves: Mapping[str, Slave], sources: Mapping[str, str], target: str) -> str:
    """Return the message that an input has no source, with what would fit by name and by unit.

    Args:
        slaves: name → slave.
        sources: signal → ``slave.output``.
        target: ``slave.input``.
    """
    name, unit, units = target.partition(".")[2], _unit(slaves, target), _units(slaves, sources)
    near = get_close_matches(name, units, n=1)
    same = [signal for signal, each in units.items() if unit and each == unit]
    hint = f"; did you mean {near[0]!r}{_bracketed(units[near[0]])}?" if near else "."
    best = [*near, *same, *units, "joint1.position"][0]
    nearest = get_close_matches(name, units, n=NEAREST, cutoff=0.0)
    there = f"in {unit} there are: {', '.join(same)}" if same else f"the nearest signals are: {', '.join(nearest)}"
    return (
        f"{target}{_bracketed(unit)} has no source: no signal has that name{hint} Rename it, or connect it explicitly, "
        f'connect = {{ "{name}" = "{best}" }} for example; {there}'
    )


def check_units(
    slaves: Mapping[str, Slave], sources: Mapping[str, str], connections: Sequence[tuple[str, str]]
) -> None:
    """Check that connections join equal units.

    Args:
        slaves: name → slave.
        sources: signal → ``slave.output``.
        connections: pairs (``slave.output``, ``slave.input``).

    Raises:
        WiringError: they differ; the message has the signals that would fit.
    """
    for source, target in connections:
        out, into = _unit(slaves, source), _unit(slaves, target)
        if out and into and out != into:
            fits = [signal for signal, unit in _units(slaves, sources).items() if unit == into]
            hint = f"connect a signal in {into} ({', '.join(fits)}), or " if fits else ""
            raise WiringError(
                f"units differ: {source} is in {out}, {target} is in {into}; {hint}put a conversion between"
            )


def check_misspelt(controllers: Sequence[Slave], plant: Slave, connections: Sequence[tuple[str, str]]) -> None:
    """Check that no output goes nowhere whose name is nearly that of an input of the plant without a source.

    Raises:
        WiringError: one does.
    """
    used = {end for ends in connections for end in ends}
    names = [each.name for each in plant.variables if each.causality == "input"]
    unfed = [name for name in names if f"{plant.name}.{name}" not in used]
    for controller in controllers:
        outputs = [each.name for each in controller.variables if each.causality == "output"]
        for name in outputs:
            near = get_close_matches(name, unfed, n=1, cutoff=MISSPELT)
            if near and f"{controller.name}.{name}" not in used:
                raise WiringError(
                    f"{controller.name}.{name} is connected to nothing, and {plant.name}.{near[0]} has no source: call the output "
                    f'{near[0]}, or connect it, connect = {{ "{plant.name}.{near[0]}" = "{controller.name}.{name}" }}'
                )


def _units(slaves: Mapping[str, Slave], sources: Mapping[str, str]) -> dict[str, str]:
    """Signals and their units; empty for unknown ones."""
    return {signal: _unit(slaves, full) for signal, full in sources.items()}


def _unit(slaves: Mapping[str, Slave], full_name: str) -> str:
    """Unit of ``slave.variable``; empty if it is unknown."""
    slave, _, name = full_name.partition(".")
    return next((each.unit for each in slaves[slave].variables if each.name == name), "")


def _bracketed(unit: str) -> str:
    return f" [{unit}]" if unit else ""
