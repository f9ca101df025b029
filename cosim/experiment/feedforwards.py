"""Feedforwards of several controllers: their sum, at the instants of the controller that takes it, and what counts twice in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from flexfmu.cosim.engine.errors import WiringError
from flexfmu.cosim.engine.slave import HasOffset, Sampled, Slave
from flexfmu.cosim.experiment.user_slaves import SlaveNames
from flexfmu.cosim.experiment.wiring import OPTIONAL
from flexfmu.model.scene.schema import Scene

WHOLE = ("feedforward", "computed-torque")
"""Kinds of controllers whose torques are those of the whole rigid robot."""


def with_sum(controllers: Sequence[Slave], connect: Mapping[str, str], names: SlaveNames) -> tuple[Slave, ...]:
    """The controllers, and the sum of the feedforwards that several of them output.

    Args:
        controllers: the controllers.
        connect: ``slave.input`` → source; inputs that have a source here don't take the sum.
        names: assigns unique names.

    Raises:
        WiringError: the controllers that take the sum aren't sampled, or not at the same instants.
    """
    sources: dict[str, list[str]] = {}
    for each in controllers:
        for variable in each.variables:
            if variable.causality == "output" and variable.name.endswith(OPTIONAL):
                sources.setdefault(variable.name, []).append(each.name)
    several = {name: owners for name, owners in sources.items() if len(owners) > 1}
    takers = [
        each
        for each in controllers
        for variable in each.variables
        if variable.causality == "input" and variable.name in several and f"{each.name}.{variable.name}" not in connect
    ]
    if not takers:
        return tuple(controllers)
    # one clock, at whose instants the sum is up to date
    clocks = {
        (each.sample_time, each.offset if isinstance(each, HasOffset) else 0.0) if isinstance(each, Sampled) else None
        for each in takers
    }
    clock = clocks.pop()
    if clocks or clock is None:
        signal, owners = next(iter(several.items()))
        raise WiringError(
            f"{' and '.join(owners)} all output {signal}, but {', '.join(dict.fromkeys(each.name for each in takers))}, "
            "which take the sum, aren't sampled at the same instants: give them one sample_time and offset [s], or connect "
            f'one of them, connect = {{ "{signal}" = "{owners[0]}.{signal}" }} for example'
        )
    from flexfmu.cosim.control.blocks.slave import BlockSlave
    from flexfmu.cosim.control.sums import feedforward_sum

    block = feedforward_sum(several, sample_time=clock[0], offset=clock[1], name=names.unused("feedforward_sum"))
    return (*controllers, BlockSlave(block))


def counted_twice(scene: Scene) -> list[str]:
    """Sentences about gravity and friction that several controllers of a scene compensate."""
    kinds = [each.kind for each in scene.controller]
    whole = [each for each in WHOLE if each in kinds]
    parts = {"all torques of the motion": whole}
    if any(scene.effects.gravity):
        parts["gravity"] = [*whole[:1], *(each for each in kinds if each == "gravity-feedforward")]
    if scene.effects.joint_friction.is_there:
        parts["friction"] = [*whole[:1], *(each for each in kinds if each == "friction-compensation")]
    return [
        f"{what} counts twice: `{found[0]}` has it, and so does `{found[1]}`; leave one of them out"
        for what, found in parts.items()
        if len(found) > 1
    ]
