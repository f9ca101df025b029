"""Connections between trajectory, controllers, imperfections and robot: by equal names, or explicit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches

from flexfmu.cosim.engine.errors import WiringError, suggestion
from flexfmu.cosim.engine.slave import Causality, Slave

OPTIONAL = ".feedforward"
"""Suffix of inputs that may stay unconnected; they keep their start values, as does the payload that gains follow."""


INPUT, SHAPED = ".input", "shaped."
"""Suffix of an imperfection's inputs, and prefix of a shaper's outputs, around the name of the signal."""


MISSPELT = 0.9
"""Similarity (`difflib`) from which the name of an unused output counts as a misspelt input of the robot."""

NEAREST = 8
"""Number of signals in a message where no unit tells which ones fit."""


@dataclass(frozen=True)
class InlineBlock:
    """A slave in series with signals: its outputs replace them.

    Attributes:
        slave: the slave.
        takes: name of the signal for each of its inputs, for example ``joint1.position``.
        replaces: name of the signal that each of its outputs replaces.
    """

    slave: Slave
    takes: tuple[str, ...]
    replaces: tuple[str, ...]


def inline_block(slave: Slave) -> InlineBlock:
    """The inline block of a slave whose variables are named after signals, such as a shaper or an imperfection.

    The inputs ``joint1.position.input`` and ``joint1.position`` take the signal ``joint1.position``; the outputs
    ``joint1.position`` and ``shaped.joint1.position`` replace it.

    Raises:
        WiringError: the slave has no outputs.
    """
    outputs = names_of(slave, "output")
    if not outputs:
        raise WiringError(f"{slave.name} has no outputs, so no signal can pass it")
    takes = tuple(name.removesuffix(INPUT) for name in names_of(slave, "input"))
    return InlineBlock(slave, takes, tuple(name.removeprefix(SHAPED) for name in outputs))


@dataclass(frozen=True)
class Wiring:
    """Connections between slaves.

    Attributes:
        connections: pairs (``slave.output``, ``slave.input``).
        feeding: name of an input of the robot → ``slave.output`` connected to it.
    """

    connections: tuple[tuple[str, str], ...]
    feeding: Mapping[str, str]


def wire(
    references: Slave,
    plant: Slave,
    controllers: Sequence[Slave] = (),
    inline_blocks: Sequence[InlineBlock] = (),
    explicit: Mapping[str, str] | None = None,
    disturbances: Sequence[Slave] = (),
) -> Wiring:
    """Connect variables with equal names.

    Inline blocks act on references (shapers, for example) and on the plant's outputs (encoders) before the controllers,
    and on the controllers' outputs (amplifiers) before the plant. A controller's input takes the signal of its name,
    preferably from another controller. If no name is equal, underscores match dots, which python-control doesn't allow.

    Args:
        references: slave with outputs such as ``joint1.reference.position``.
        plant: the robot.
        controllers: slaves whose inputs all need a source, except those that end in ``.feedforward``.
        inline_blocks: slaves in series with signals, in this order.
        explicit: ``slave.input`` → its source, ``slave.output`` or the name of a signal.
        disturbances: slaves that act on the robot; an input called ``slave.output`` is a term of a sum of theirs.

    Raises:
        WiringError: an input has no source, an inline block acts on an unknown signal, two controllers (or a controller and
            the plant) output the same signal, no output of a controller is connected to the plant, there is no controller
            and an inline block's outputs are unused, or an explicit connection has an unknown name.
    """
    slaves = (references, plant, *controllers, *(inline.slave for inline in inline_blocks), *disturbances)
    bus = _Bus({slave.name: slave for slave in slaves}, dict(explicit or {}))
    # references and measurements, with their inline blocks
    waiting = list(inline_blocks)
    for source in (references, plant):
        bus.publish(source)
        waiting = bus.pass_through(waiting)
    for controller in controllers:
        if both := sorted(set(names_of(controller, "output")) & set(names_of(plant, "output"))):
            torques = [name for name in both if name.endswith(".torque")]
            raise WiringError(
                f"{controller.name} outputs {(torques or both)[0]}, but so does the robot"
                + (
                    ', which is driven by its motion; for a robot that takes torques set `cosimulation.drive` = "torque"'
                    if torques
                    else ": a signal has one source, so give the controller's output another name"
                )
            )
    # controllers, then the inline blocks between them and the plant
    bus.connect_controllers(controllers)
    bus.add_disturbances(disturbances, plant)
    bus.publish_to(plant)
    outputs = [f"{each.name}.{name}" for each in controllers for name in names_of(each, "output")]
    if stuck := bus.pass_through(waiting):
        name, missing = stuck[0].slave.name, bus.missing(stuck[0]) or ""
        if missing in names_of(plant, "input") and outputs:
            raise WiringError(
                f"{name} acts on {missing}, but the controllers output {', '.join(outputs)}: call the output {missing}, "
                f'or connect it, connect = {{ "{plant.name}.{missing}" = "{outputs[0]}" }} for example'
            )
        if missing.endswith(".torque"):
            raise WiringError(f"{name} acts on {missing}, which nothing outputs: the robot needs a controller")
        raise WiringError(f"{name} acts on {missing}, which doesn't exist; {suggestion(missing, bus.sources)}")
    wiring = bus.finished(plant)
    # controllers must reach the robot, and without one inline blocks must reach something
    inputs = names_of(plant, "input")
    if controllers and not wiring.feeding:
        raise WiringError(
            f"nothing that the controllers output ({', '.join(outputs) or 'no outputs'}) reaches the robot, which takes "
            f"{', '.join(inputs)}; give outputs these names, or connect them explicitly, "
            f'connect = {{ "{plant.name}.{inputs[0]}" = "{outputs[0] if outputs else "mine.torque"}" }} for example'
        )
    used, fed = ({ends[side] for ends in wiring.connections} for side in (0, 1))
    for inline in () if controllers else inline_blocks:
        name = inline.slave.name
        if used.isdisjoint(f"{name}.{output}" for output in names_of(inline.slave, "output")):
            raise WiringError(
                f"{name} acts on {', '.join(inline.replaces)}, which nothing takes: add a controller, or leave {name} out"
            )
    # an output that goes nowhere may be a misspelt input of the robot
    unfed = [name for name in inputs if f"{plant.name}.{name}" not in fed]
    for output in (each for each in outputs if each not in used):
        for near in get_close_matches(output.partition(".")[2], unfed, n=1, cutoff=MISSPELT):
            raise WiringError(
                f"{output} is connected to nothing, and {plant.name}.{near} has no source: call the output {near}, "
                f'or connect it, connect = {{ "{plant.name}.{near}" = "{output}" }}'
            )
    return wiring


@dataclass
class _Bus:
    """The signals (name → ``slave.output``) and connections so far; ``explicit`` loses those that have been made."""

    slaves: Mapping[str, Slave]
    explicit: dict[str, str]
    sources: dict[str, str] = field(default_factory=dict)
    connections: list[tuple[str, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        for target in self.explicit:
            self._check(target, "input")

    def publish(self, slave: Slave) -> None:
        """Make a slave's outputs available."""
        self.sources |= {name: f"{slave.name}.{name}" for name in names_of(slave, "output")}

    def pass_through(self, inline_blocks: Iterable[InlineBlock]) -> list[InlineBlock]:
        """Insert the inline blocks whose signals exist; return the others."""
        waiting = []
        for inline in inline_blocks:
            if self.missing(inline) is not None:
                waiting.append(inline)
                continue
            name, outputs = inline.slave.name, names_of(inline.slave, "output")
            for signal, target in zip(inline.takes, names_of(inline.slave, "input"), strict=True):
                chosen = self.explicit.pop(f"{name}.{target}", signal)
                self.connections.append((self.source(chosen), f"{name}.{target}"))
            self.sources |= {
                signal: f"{name}.{output}" for signal, output in zip(inline.replaces, outputs, strict=True)
            }
        return waiting

    def missing(self, inline: InlineBlock) -> str | None:
        """The first signal that an inline block needs or replaces and that has no source; None if there is none."""
        name = inline.slave.name
        taken = zip(inline.takes, names_of(inline.slave, "input"), strict=True)
        needed = [signal for signal, target in taken if f"{name}.{target}" not in self.explicit]
        return next((signal for signal in (*needed, *inline.replaces) if signal not in self.sources), None)

    def connect_controllers(self, controllers: Sequence[Slave]) -> None:
        """Connect the controllers' inputs, then make their outputs available."""
        # each signal is the output of one controller, or of the one that adds up those of the others
        owners: dict[str, str] = {}
        taken = {
            name
            for each in controllers
            for name in names_of(each, "input")
            if f"{each.name}.{name}" not in self.explicit
        }
        for controller in controllers:
            for name in names_of(controller, "output"):
                is_free = name.endswith(OPTIONAL) and name not in taken
                if name in owners and f"{owners[name]}.{name}" not in taken and not is_free:
                    raise WiringError(
                        f"{owners[name]} and {controller.name} both output {name}; let one of them output "
                        f"{name.rpartition('.')[0]}{OPTIONAL}, which the other adds to its own, or leave one out"
                    )
                owners[name] = controller.name
        for controller in controllers:
            for name in names_of(controller, "input"):
                self._feed(controller, name, owners)
        # make the outputs available
        self.sources |= {name: f"{owner}.{name}" for name, owner in owners.items()}

    def add_disturbances(self, disturbances: Sequence[Slave], plant: Slave) -> None:
        """Connect the terms of the sums of disturbances, and make all outputs available.

        Raises:
            WiringError: the robot has no such input, or a controller outputs the same signal.
        """
        for each in disturbances:
            for name in names_of(each, "input"):
                target = f"{each.name}.{name}"
                self.connections.append((self.source(self.explicit.pop(target, name)), target))
            for name in names_of(each, "output"):
                if name not in names_of(plant, "input"):
                    raise WiringError(
                        f"{each.name} outputs {name}, but the robot takes {', '.join(names_of(plant, 'input'))}: a [[disturbance]] "
                        "of the scene gives the robot its inputs for torques and masses"
                    )
                owner = self.sources.get(name, each.name).partition(".")[0]
                if owner not in {disturbance.name for disturbance in disturbances}:
                    raise WiringError(f"{owner} and {each.name} both output {name}: leave one out")
            self.publish(each)

    def _feed(self, controller: Slave, name: str, owners: Mapping[str, str]) -> None:
        """Connect a controller's input.

        Raises:
            WiringError: it has no source.
        """
        target = f"{controller.name}.{name}"
        if target in self.explicit:
            # connected explicitly, to a controller's output or to a signal
            chosen = self.explicit.pop(target)
            source = f"{owners[chosen]}.{chosen}" if chosen in owners else self.source(chosen)
        elif owners.get(name, controller.name) != controller.name:
            # another controller's output of the same name
            source = f"{owners[name]}.{name}"
        elif (found := self.find(name)) is not None:
            source = found
        elif name.endswith(OPTIONAL) and name.partition(".")[0] in self.slaves:
            # the term of a sum
            source = self.source(name)
        elif name.endswith(OPTIONAL) or name == "payload.mass":
            return
        else:
            raise WiringError(self._no_source(target))
        self.connections.append((source, target))

    def find(self, name: str) -> str | None:
        """``slave.output`` of a signal, else of one whose name differs in dots and underscores only; None if there is none."""
        if name in self.sources:
            return self.sources[name]
        return next((full for signal, full in self.sources.items() if _plain(signal) == _plain(name)), None)

    def source(self, name: str) -> str:
        """``slave.output`` of a source named by the user as ``slave.output`` or as a signal.

        Raises:
            WiringError: there is none.
        """
        if name.partition(".")[0] in self.slaves:
            self._check(name, "output")
            return name
        found = self.find(name)
        if found is None:
            raise WiringError(f"there is no signal {name!r} to connect to; {suggestion(name, self.sources)}")
        return found

    def publish_to(self, plant: Slave) -> None:
        """Find the sources of the plant's inputs: explicit connections, else signals of equal names."""
        for name in names_of(plant, "input"):
            chosen = self.explicit.pop(f"{plant.name}.{name}", None)
            found = self.find(name) if chosen is None else self.source(chosen)
            if found is not None:
                self.sources[name] = found

    def finished(self, plant: Slave) -> Wiring:
        """Make the remaining explicit connections and those to the plant; return the wiring."""
        for target, source in self.explicit.items():
            self.connections.append((self.source(source), target))
        feeding = {name: self.sources[name] for name in names_of(plant, "input") if name in self.sources}
        own = {name: source for name, source in feeding.items() if source.partition(".")[0] != plant.name}
        self.connections += [(source, f"{plant.name}.{name}") for name, source in own.items()]
        # connections join equal units
        for source, target in self.connections:
            out, into = self._unit(source), self._unit(target)
            if out and into and out != into:
                fits = [signal for signal, full in self.sources.items() if self._unit(full) == into]
                hint = f"connect a signal in {into} ({', '.join(fits)}), or " if fits else ""
                raise WiringError(
                    f"units differ: {source} is in {out}, {target} is in {into}; {hint}put a conversion between"
                )
        return Wiring(tuple(self.connections), own)

    def _check(self, full_name: str, causality: Causality) -> None:
        """Raise `WiringError` if there is no ``slave.variable`` of this causality."""
        slave, _, name = full_name.partition(".")
        if slave not in self.slaves:
            raise WiringError(f"{full_name!r}: there is no slave {slave!r}; slaves: {', '.join(self.slaves)}")
        names = names_of(self.slaves[slave], causality)
        if name not in names:
            near = get_close_matches(name, names, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"it has: {', '.join(names) or 'none'}"
            raise WiringError(f"{slave} has no {causality} {name!r}; {hint}")

    def _unit(self, full_name: str) -> str:
        """Unit of ``slave.variable``; empty if it is unknown."""
        slave, _, name = full_name.partition(".")
        return next((each.unit for each in self.slaves[slave].variables if each.name == name), "")

    def _no_source(self, target: str) -> str:
        """Message: an input, ``slave.input``, has no source; with what would fit by name and by unit."""
        name, unit = target.partition(".")[2], self._unit(target)
        units = {signal: self._unit(full) for signal, full in self.sources.items()}
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


def names_of(slave: Slave, causality: Causality) -> tuple[str, ...]:
    """Names of a slave's inputs or outputs."""
    return tuple(variable.name for variable in slave.variables if variable.causality == causality)


def _plain(name: str) -> str:
    return name.replace(".", "_")


def _bracketed(unit: str) -> str:
    return f" [{unit}]" if unit else ""
