"""From what the master records of a scene to what its users read: short names, the rigid motion beside the real one."""

from __future__ import annotations

from collections.abc import Iterator

from flexfmu.cosim.loop.recording import constants, plain_names
from flexfmu.cosim.master.selection import Selection
from flexfmu.cosim.measuring.rigid_motion import RigidMotion
from flexfmu.cosim.results import Recording
from flexfmu.cosim.scene_system import PLANT, REFERENCES, SceneSystem


class SceneRecording:
    """Names and completes recordings of a scene.

    Args:
        parts: slaves and wiring.
        rigid: the motion of the rigid robot.
        selection: what to keep, by the names in the finished recording.

    Attributes:
        needed: the same by the names of the master.

    Raises:
        InputError: there is no such signal.
    """

    def __init__(self, parts: SceneSystem, rigid: RigidMotion, selection: Selection) -> None:
        self._rigid, self._selection = rigid, selection
        self._with_rigid = any(map(selection.keeps, rigid.names))
        outputs = set(_outputs(parts))
        selection.check({*map(_short, outputs), *outputs, *parts.wiring.feeding, *parts.constants, *rigid.names})
        self.needed = Selection(_sources(parts, selection, outputs), selection.order)

    def of(self, recorded: Recording, parts: SceneSystem) -> Recording:
        """What was recorded, with short names and the torques that nothing feeds."""
        time, columns = recorded.time, plain_names(recorded.columns, PLANT, REFERENCES, parts.wiring.feeding)
        columns |= constants(parts.plant, parts.constants, time.size)
        if self._with_rigid:
            columns |= self._rigid.columns(time)
        return self._selection.of(Recording(time, columns))


def _outputs(parts: SceneSystem) -> Iterator[str]:
    """All outputs as the master names them."""
    for slave in parts.slaves:
        for variable in slave.variables:
            if variable.causality == "output":
                yield f"{slave.name}.{variable.name}"


def _short(name: str) -> str:
    """The name that a finished recording may have for an output."""
    owner, _, variable = name.partition(".")
    return variable if owner in (PLANT, REFERENCES) else name


def _sources(parts: SceneSystem, selection: Selection, outputs: set[str]) -> set[str] | None:
    """Outputs that the signals to keep are made of; None for all."""
    if selection.names is None:
        return None
    feeding = parts.wiring.feeding
    return {name for name in outputs if selection.keeps(name) or selection.keeps(_short(name))} | {
        feeding[name] for name in selection.names if name in feeding
    }
