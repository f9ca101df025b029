"""The linear loop of a scene: its controllers, imperfections and filters, wired as for a run, about an equilibrium on its path."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.imperfections.lag import Lag
from flexfmu.cosim.design.margins.linear_blocks import LinearBlock, identified_block, linear_block
from flexfmu.cosim.design.margins.linear_loop import Continuous, LinearLoop
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import is_foreign
from flexfmu.cosim.engine.master.system import Connection, System, connect
from flexfmu.cosim.engine.slave import Sampled, Slave, SlaveVariable
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.parameters import scene_with_parameters
from flexfmu.cosim.experiment.scene_loop import Loop
from flexfmu.cosim.experiment.system import PLANT, REFERENCES
from flexfmu.cosim.experiment.wiring import wire
from flexfmu.fmu_build.cache import content_hash, package_fingerprint, read_cached, store
from flexfmu.model.contract import LinearPlant
from flexfmu.model.linear import linear_plant, without_coulomb_friction
from flexfmu.model.plants import torque_driven_plant
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicModel
from flexfmu.trajectories.jets import RealArray

MODEL_BASED = ("computed-torque", "disturbance-observer")
"""Kinds of controllers with a model of the robot's motion."""


class WiredSystem:
    """Connected slaves around a plant; `about` linearises them.

    Args:
        system: the slaves and their connections.
        plant: index of the plant, which is linear already.
        models: names of the controllers with a model of the plant's motion begin with one of these.

    Attributes:
        system: the system.
        plant: index of the plant.
        measured: names of the plant's outputs that something takes.
        sampled: indices of the sampled slaves.

    Raises:
        InputError: a slave in the loop can't be linearised.
    """

    def __init__(self, system: System, plant: int, models: tuple[str, ...] = ()) -> None:
        self.system, self.plant, self._models = system, plant, models
        self.sampled = [i for i, slave in enumerate(system.slaves) if isinstance(slave, Sampled)]
        self._lags = [(i, slave) for i, slave in enumerate(system.slaves) if isinstance(slave, Lag)]
        for i in self._looped - {plant, *self.sampled, *(i for i, _ in self._lags)}:
            raise InputError(f"{system.slaves[i].name} can't be linearised: it is neither sampled nor a lag")
        self._feeding: dict[tuple[int, str], Connection] = {
            (each.target, system.slaves[each.target].variables[each.input].name): each for each in system.connections
        }
        # signals: outputs of the plant that something takes, then of lags; outputs of sampled slaves
        taken = {each.output for each in system.connections if each.source == plant}
        self.measured = [system.slaves[plant].variables[i].name for i in sorted(taken)]
        lagged = [(i, name) for i, lag in self._lags for name in _names(lag, "output")]
        self._signals = {source: k for k, source in enumerate([*((plant, name) for name in self.measured), *lagged])}
        held = [(i, name) for i in self.sampled for name in _names(system.slaves[i], "output")]
        self._outputs = {source: k for k, source in enumerate(held)}

    def about(
        self,
        plant: LinearPlant,
        *,
        identify: bool = True,
        resting: Mapping[tuple[int, str], float] = MappingProxyType({}),
        moving: Mapping[str, float] = MappingProxyType({}),
    ) -> tuple[LinearLoop, tuple[str, ...]]:
        """The linear loop, and the names of its channels: the plant's inputs that sampled slaves feed.

        Args:
            plant: the linear plant with the outputs `measured`.
            identify: whether Python functions and FMUs are called to find their linear blocks.
            resting: values of further signals at the plant's point, by slave and name.
            moving: signals that the motion changes, and their values, for which controllers have the gains that they have there.

        Raises:
            InputError: a slave can't be linearised, or the loop isn't closed.
        """
        channels = self._channels(plant)
        if not channels or self._looped == {self.plant}:
            name = self.system.slaves[self.plant].name
            raise InputError(f"no sampled controller feeds {name} and is fed by it: there is no loop with margins")
        blocks = self._blocks(plant, identify, resting, moving)
        order = [i for i in self.system.exchange_steps if i in self.sampled]
        calls = tuple(self.sampled.index(i) for i in order)
        continuous = self._continuous(plant, list(channels.values()))
        loop = LinearLoop(continuous, tuple(blocks), calls, self._inputs(), tuple(channels.values()))
        return loop, tuple(channels)

    def _blocks(
        self, plant: LinearPlant, identify: bool, resting: Mapping[tuple[int, str], float], moving: Mapping[str, float]
    ) -> list[LinearBlock]:
        """The sampled slaves, linearised at the values that their inputs have at rest."""
        own = zip(((self.plant, name) for name in plant.outputs), plant.rest[1].tolist(), strict=True)
        values = {**resting, **dict(own)}
        found: dict[int, LinearBlock] = {}
        seen: dict[int, RealArray] = {}
        # twice, as torques may come from slaves further on
        for i in (*self.system.exchange_steps, *self.system.exchange_steps):
            slave = self.system.slaves[i]
            names = _names(slave, "input")
            at_rest = np.array([self._value(values, i, name) for name in names])
            if i in self.sampled:
                if i not in found or not np.array_equal(at_rest, seen[i]):
                    found[i], outputs = _linearised(slave, at_rest, identify)
                    values |= dict(zip(((i, name) for name in _names(slave, "output")), outputs.tolist(), strict=True))
                seen[i] = at_rest
            elif isinstance(slave, Lag):
                values |= dict(zip(((i, name) for name in _names(slave, "output")), at_rest.tolist(), strict=True))
        if moving:
            found |= {i: self._in_motion(i, found[i], seen[i], moving, identify) for i in self.sampled}
        return [found[i].within(*self._in_the_loop(i)) for i in self.sampled]

    def _in_motion(
        self, i: int, block: LinearBlock, at_rest: RealArray, moving: Mapping[str, float], identify: bool
    ) -> LinearBlock:
        """A block with the gains that it has in motion.

        Models of the robot keep their terms at rest, since their derivatives by velocities belong to terms that the robot has in
        motion. So do blocks of which an output no longer answers: a limit that is reached, as references and measurements alone
        don't make a state of the motion.
        """
        slave = self.system.slaves[i]
        inputs = at_rest.copy()
        for k, name in enumerate(_names(slave, "input")):
            feeding = self._feeding.get((i, name))
            source = name if feeding is None else self._source(feeding)[1]
            inputs[k] = moving.get(name, moving.get(source, at_rest[k]))
        if np.array_equal(inputs, at_rest) or slave.name.startswith(self._models):
            return block
        try:
            found, _ = _linearised(slave, inputs, identify)
        except InputError:
            return block
        answers = [np.hstack([each.c, each.d]).any(axis=1) for each in (block, found)]
        return block if (answers[0] & ~answers[1]).any() else found

    def _in_the_loop(self, i: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which inputs of a slave come from the loop, and which outputs lead on in it: references and monitors aren't in it."""
        slave, connections = self.system.slaves[i], self.system.connections
        incoming = [
            (feeding := self._feeding.get((i, name))) is not None and feeding.source in self._looped
            for name in _names(slave, "input")
        ]
        led = [each for each in connections if each.source == i and each.target in self._looped]
        leading = {slave.variables[each.output].name for each in led}
        outgoing = [name in leading for name in _names(slave, "output")]
        return np.array(incoming, bool), np.array(outgoing, bool)

    @cached_property
    def _looped(self) -> set[int]:
        """Slaves that the plant reaches and that reach it."""
        pairs = {(each.source, each.target) for each in self.system.connections}
        return _reachable(pairs, self.plant) & _reachable({(target, source) for source, target in pairs}, self.plant)

    def _value(self, values: Mapping[tuple[int, str], float], slave: int, name: str) -> float:
        """The value of an input at rest."""
        feeding = self._feeding.get((slave, name))
        if feeding is None:
            return next(each.start or 0.0 for each in self.system.slaves[slave].variables if each.name == name)
        return values.get(self._source(feeding), 0.0)

    def _source(self, connection: Connection) -> tuple[int, str]:
        return connection.source, self.system.slaves[connection.source].variables[connection.output].name

    def _inputs(self) -> tuple[RealArray, ...]:
        """For each sampled slave its inputs from [signals, outputs]; references don't move."""
        found = []
        for i in self.sampled:
            names = _names(self.system.slaves[i], "input")
            matrix = np.zeros((len(names), len(self._signals) + len(self._outputs)))
            for row, name in enumerate(names):
                feeding = self._feeding.get((i, name))
                source = None if feeding is None else self._source(feeding)
                if source in self._signals:
                    matrix[row, self._signals[source]] = 1.0
                elif source in self._outputs:
                    matrix[row, len(self._signals) + self._outputs[source]] = 1.0
            found.append(matrix)
        return tuple(found)

    def _channels(self, plant: LinearPlant) -> dict[str, int]:
        """Input of the plant → index of the sampled output that feeds it, through lags if there are some."""
        return {
            name: self._outputs[source]
            for name in plant.inputs
            if (source := self.through_lags((self.plant, name))[0]) in self._outputs
        }

    def through_lags(self, target: tuple[int, str]) -> tuple[tuple[int, str] | None, list[float]]:
        """What feeds an input through lags, none if nothing does, and their time constants [s]; for an output of a lag what feeds that."""
        times = list[float]()
        slave = self.system.slaves[target[0]]
        if isinstance(slave, Lag) and target[1] in (outputs := _names(slave, "output")):
            times.append(slave.latency[target[1]])
            target = target[0], _names(slave, "input")[outputs.index(target[1])]
        if (feeding := self._feeding.get(target)) is None:
            return None, times
        if not isinstance(self.system.slaves[feeding.source], Lag):
            return self._source(feeding), times
        source, more = self.through_lags(self._source(feeding))
        return source, times + more

    def signal_paths(self) -> list[tuple[str, list[float]]]:
        """For each of the linear loop's signals the plant's output that it is, and the time constants [s] of lags between them.

        An output without a name stands for a lag that the plant doesn't feed.
        """
        found = []
        for source in self._signals:
            end, times = (source, []) if source[0] == self.plant else self.through_lags(source)
            if end is None or end[0] != self.plant:
                end = self.plant, ""
            found.append((end[1], times))
        return found

    def _continuous(self, plant: LinearPlant, channels: list[int]) -> Continuous:
        """Plant and lags: states [x, outputs of lags]."""
        n = len(plant.a)
        lags = [(i, lag, k) for i, lag in self._lags for k in range(len(_names(lag, "output")))]
        size, outputs, signals = n + len(lags), len(self._outputs), len(self._signals)
        a, held, by_channel = (np.zeros((size, each)) for each in (size, outputs, len(channels)))
        c, c_held, c_channel = (np.zeros((signals, each)) for each in (size, outputs, len(channels)))
        a[:n, :n], c[: len(plant.outputs), :n] = plant.a, plant.c
        places = {(i, _names(lag, "output")[k]): n + j for j, (i, lag, k) in enumerate(lags)}

        def feed(source: tuple[int, str], by_rate: RealArray, by_signal: RealArray, rows: slice, out: slice) -> None:
            """What an input adds to rates in rows and to signals in out."""
            if source in places:
                a[rows, places[source]] += by_rate
                c[out, places[source]] += by_signal
            elif source in self._outputs and self._outputs[source] in channels:
                by_channel[rows, channels.index(self._outputs[source])] += by_rate
                c_channel[out, channels.index(self._outputs[source])] += by_signal
            elif source in self._outputs:
                held[rows, self._outputs[source]] += by_rate
                c_held[out, self._outputs[source]] += by_signal
            elif source[0] == self.plant:
                name = self.system.slaves[self.plant].name
                raise InputError(
                    f"an output of {name} feeds {name} or a lag directly: margins need a sampled slave between"
                )

        for k, name in enumerate(plant.inputs):
            if (feeding := self._feeding.get((self.plant, name))) is not None:
                feed(self._source(feeding), plant.b[:, k], plant.d[:, k], slice(0, n), slice(0, len(plant.outputs)))
        for j, (i, lag, k) in enumerate(lags):
            rate, row = 1.0 / lag.latency[_names(lag, "output")[k]], n + j
            a[row, row] -= rate
            c[self._signals[i, _names(lag, "output")[k]], row] = 1.0
            if (feeding := self._feeding.get((i, _names(lag, "input")[k]))) is not None:
                feed(self._source(feeding), np.array([rate]), np.zeros(0), slice(row, row + 1), slice(0, 0))
        return Continuous(a, c, (held, c_held), (by_channel, c_channel))


class WiredLoop:
    """The slaves of a scene's loop and their connections; `at` linearises them at a pose.

    Args:
        scene: the scene, driven by torques.
        loop: its planned motion, controllers, shapers and imperfections.
        robot: the robot's FMU, if there is one; otherwise its variables are those of its model.

    Attributes:
        wired: the slaves and what they take.
        system: the system.
        sampled: indices of the sampled slaves.

    Raises:
        InputError: no controller feeds the robot, or slaves can't be connected or linearised.
    """

    def __init__(self, scene: Scene, loop: Loop, robot: Slave | None = None) -> None:
        if scene.cosimulation.drive != "torque" or not loop.controllers:
            raise InputError(
                f'scene {scene.name} has no loop: margins need `cosimulation.drive = "torque"` and a [[controller]]'
            )
        # disturbances come from outside of the loop
        scene = scene.model_copy(update={"disturbance": ()})
        robot = robot or standing_for(torque_driven_plant(scene), PLANT)
        references = TrajectorySlave(loop.driving, name=REFERENCES)
        wiring = wire(references, robot, loop.controllers, loop.inline_blocks, loop.connect)
        slaves: list[Slave] = [references, robot, *loop.controllers, *(each.slave for each in loop.inline_blocks)]
        self.system: System = connect(slaves, wiring.connections)
        # the real robot for small motions: with its own payload, and without Coulomb friction
        self._scene = without_coulomb_friction(scene.replace(dict(loop.parameters)) if loop.parameters else scene)
        sections = [each for each in scene.controller if each.kind in MODEL_BASED]
        models = tuple(each.name or each.kind.replace("-", "_") for each in sections)
        self.wired = WiredSystem(self.system, 1, models)
        self.sampled = self.wired.sampled

    @property
    def payload(self) -> float:
        """The robot's own payload [kg]."""
        return self._scene.payload.mass

    def around(self, parameters: Mapping[str, float]) -> WiredLoop:
        """The same loop around a robot with other parameters of the FMU, which controllers don't know."""
        found = copy(self)
        found._scene = without_coulomb_friction(scene_with_parameters(self._scene, parameters))
        return found

    def at(
        self,
        position: tuple[float, float],
        identify: bool = True,
        velocity: RealArray | None = None,
        payload: float | None = None,
    ) -> tuple[LinearLoop, tuple[str, ...]]:
        """The linear loop about the equilibrium at a place of the end effector [m], and the names of its channels.

        Args:
            position: the place.
            identify: see `WiredSystem.about`.
            velocity: of the joints (2,) [rad/s], at which controllers have the gains that they have there; the robot stands still.
            payload: mass [kg] of the robot's payload instead of its own; controllers assume what they did.

        Raises:
            InputError: see `WiredSystem.about`.
            ValueError, EquilibriumError: see `linear_plant`.
        """
        plant = self.plant(position, payload)
        values = dict(zip(plant.outputs, plant.rest[1].tolist(), strict=True))
        places = {f"{joint}.reference.position": f"{joint}.position" for joint in ("joint1", "joint2")}
        resting = {(0, reference): values[measured] for reference, measured in places.items() if measured in values}
        return self.wired.about(plant, identify=identify, resting=resting, moving=_moving(plant, velocity))

    def plant(self, position: tuple[float, float], payload: float | None = None) -> LinearPlant:
        """The linear robot that `at` has, with the outputs that something takes."""
        scene = self._scene if payload is None else self._scene.replace({"payload.mass": payload})
        return kept_plant(scene, position, self.wired.measured)


def _moving(plant: LinearPlant, velocity: RealArray | None) -> dict[str, float]:
    """Signals that a velocity of the joints changes, and their values; empty for standstill."""
    if velocity is None or not velocity.any():
        return {}
    n = len(plant.a) // 2
    found = dict(zip(plant.outputs, (plant.rest[1] + plant.c[:, n : n + 2] @ velocity).tolist(), strict=True))
    found = {name: value for name, value in found.items() if ".velocity" in name}
    for joint, value in zip(("joint1", "joint2"), velocity.tolist(), strict=True):
        found |= {f"{joint}.{kind}velocity": value for kind in ("", "reference.", "command.")}
    return found


def standing_for(plant: SymbolicModel, name: str) -> Any:
    """Stands for the FMU of a plant, of which only the variables matter."""
    variables = [SlaveVariable(each.name, each.causality, each.unit) for each in (*plant.inputs, *plant.outputs)]
    return SimpleNamespace(name=name, variables=tuple(variables), feedthrough=plant.feedthrough)


def kept_plant(scene: Scene, position: tuple[float, float], outputs: Sequence[str]) -> LinearPlant:
    """The linear robot, which the cache keeps: gains change more often than robots; see `linear_plant`."""
    robot = scene.model_dump_json(include={"mechanism", "payload", "effects"})
    key = content_hash(text.encode() for text in (package_fingerprint(), robot, repr(position), *outputs))
    file = f"plants/{key}.json"
    if (known := read_cached(file)) is not None:
        data = json.loads(known)
        rest = (np.array(data["rest"][0]), np.array(data["rest"][1]))
        a, b, c, d = (np.array(each) for each in data["matrices"])
        return LinearPlant(a, b, c, d, tuple(data["inputs"]), tuple(outputs), rest)
    # the robot alone, so that loops around it share its equations
    alone = {"controller": (), "imperfection": (), "filter": (), "shaper": (), "disturbance": ()}
    plant = linear_plant(scene.model_copy(update=alone), position, outputs)
    matrices = [each.tolist() for each in (plant.a, plant.b, plant.c, plant.d)]
    at_rest = [each.tolist() for each in plant.rest]
    store(file, json.dumps({"matrices": matrices, "inputs": plant.inputs, "rest": at_rest}).encode())
    return plant


def _linearised(slave: Slave, inputs: RealArray, identify: bool) -> tuple[LinearBlock, RealArray]:
    """A sampled slave at constant inputs, and its outputs; a user's code is called in a child process, which it may crash."""
    linearise = linear_block if isinstance(slave, BlockSlave) or not identify else identified_block
    if not (AVAILABLE and is_foreign(slave)):
        return linearise(slave, inputs)
    try:
        found: tuple[LinearBlock, RealArray] = in_child(lambda: linearise(slave, inputs), lambda: None, CALL_LIMIT)
    except ChildLostError as error:
        raise InputError(f"{slave.name} can't be linearised about standstill: {error}") from None
    return found


def _reachable(pairs: set[tuple[int, int]], start: int) -> set[int]:
    """What a slave reaches by pairs from one slave to another."""
    found = {start}
    while more := {target for source, target in pairs if source in found} - found:
        found |= more
    return found


def _names(slave: Slave, causality: str) -> list[str]:
    return [each.name for each in slave.variables if each.causality == causality]
