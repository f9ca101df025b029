"""The scene: all inputs of a simulation, as frozen sections that mirror the TOML file (SI units, rad)."""

from __future__ import annotations

from functools import cached_property, reduce
from html import escape
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from flexfmu.model.scene.assembly import check_start_pose, check_working_mode, end_effector
from flexfmu.model.scene.choice import LARGEST, Accuracy, integrator_tolerance
from flexfmu.model.scene.controllers import ControllerSection, LearningSection
from flexfmu.model.scene.cosimulation import Cosimulation
from flexfmu.model.scene.disturbances import DisturbanceKind, PayloadChangeSection
from flexfmu.model.scene.effects import LOADS, Effects
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.filters import FilterTable
from flexfmu.model.scene.imperfections import ImperfectionSection
from flexfmu.model.scene.keys import set_value
from flexfmu.model.scene.loop import FOLDER, ObjectSection, as_parts
from flexfmu.model.scene.mechanism import Mechanism, Payload
from flexfmu.model.scene.messages import sentences
from flexfmu.model.scene.motion import TableSection, TrajectorySection, with_kind
from flexfmu.model.scene.motor import MotorSection, one_table
from flexfmu.model.scene.plan import PlanSection
from flexfmu.model.scene.section import Section, as_tuple
from flexfmu.model.scene.shapers import ShaperSection
from flexfmu.trajectories.curves import Point

MOST_ERRORS = 20
"""Largest number of errors that a message names."""

LARGEST_LENGTH = 10.0
"""Largest length of usual robots [m]; beyond it a wrong unit is likely."""


class Scene(Section):
    """A complete scene. `flexfmu.model.scene.file.load_scene` reads one from a TOML file.

    Example:
        ``scene.replace({"payload.mass": 0.1, "trajectory.duration": 0.30})`` is the same scene with two values changed.

    With ``accuracy``, ``{"peak_torque_1": 1e-3, "end_position_error": "1 um"}``, a run chooses effects, communication step,
    integrator and tolerance such that the errors of these metrics, of model and numerics together, are at most that.
    """

    name: Annotated[str, Field(min_length=1, pattern=r"^[\w.+-]*\w[\w.+-]*$")]
    mechanism: Mechanism
    payload: Payload
    effects: Effects
    trajectory: Annotated[TrajectorySection | TableSection, BeforeValidator(with_kind), Field(discriminator="kind")]
    cosimulation: Cosimulation
    controller: Annotated[tuple[ControllerSection, ...], BeforeValidator(as_parts)] = ()
    shaper: Annotated[tuple[ShaperSection, ...], BeforeValidator(as_parts)] = ()
    imperfection: Annotated[tuple[ImperfectionSection, ...], BeforeValidator(as_parts)] = ()
    filter: Annotated[tuple[FilterTable, ...], BeforeValidator(as_tuple)] = ()
    disturbance: Annotated[tuple[DisturbanceKind, ...], BeforeValidator(as_tuple)] = ()
    motor: Annotated[MotorSection | None, BeforeValidator(one_table)] = None
    plan: PlanSection | None = None
    accuracy: Accuracy = None

    @cached_property
    def origin(self) -> str:
        """File or name that the scene was loaded from, whatever was changed since; empty for one that was made otherwise."""
        return ""

    @property
    def is_open(self) -> bool:
        """Whether effects or numerical settings are still to be chosen."""
        return self.effects.select is not None or bool(self.accuracy)

    @property
    def learners(self) -> tuple[LearningSection, ...]:
        """Controllers that learn from cycle to cycle."""
        return tuple(each for each in self.controller if isinstance(each, LearningSection))

    @property
    def has_objects(self) -> bool:
        """Whether objects of the caller's program are parts of the loop."""
        return any(isinstance(each, ObjectSection) for each in (*self.controller, *self.shaper, *self.imperfection))

    def __repr__(self) -> str:
        """Return five lines with the beginning of each section; `print` shows all keys."""
        parts = {key: len(getattr(self, key)) for key in ("controller", "shaper", "imperfection", "filter")}
        counts = "".join(f", {key}s: {count}" for key, count in parts.items() if count)
        lines = [f"Scene {self.name}, payload {self.payload.mass:g} kg{counts}"]
        for key in ("mechanism", "effects", "trajectory", "cosimulation"):
            text = f"  {key}: {_listed(getattr(self, key))}"
            lines.append(text if len(text) < 80 else text[:78] + "…")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        """Return a table of all sections."""
        sections = list[tuple[str, str]]()
        for key in type(self).model_fields:
            value = getattr(self, key)
            many = value if isinstance(value, tuple) else (value,)
            sections += [(key, _listed(each)) for each in many if isinstance(each, Section)]
        rows = "".join(f"<tr><th>{escape(key)}</th><td>{escape(text)}</td></tr>" for key, text in sections)
        return f"<p><b>Scene {escape(self.name)}</b></p><table><tbody>{rows}</tbody></table>"

    @model_validator(mode="before")
    @classmethod
    def _fill_in_for_choice(cls, data: Any) -> Any:
        effects, cosimulation = (
            data.get(key) if isinstance(data, dict) else None for key in ("effects", "cosimulation")
        )
        if not (isinstance(effects, dict) and isinstance(cosimulation, dict) and effects.get("select") == "auto"):
            return data
        # an error in this tolerance is reported once, for its own key
        tolerance = effects.get("tolerance")
        number = tolerance if isinstance(tolerance, float | int) else LARGEST
        effects, cosimulation = (
            {"basis": "craig-bampton", **effects},
            {"tolerance": integrator_tolerance(number), **cosimulation},
        )
        return {**data, "effects": effects, "cosimulation": cosimulation}

    @model_validator(mode="after")
    def _effects_are_chosen_once(self) -> Self:
        if self.accuracy and self.effects.select is not None:
            raise ValueError(
                "`accuracy` chooses the effects as well: leave out `effects.select`, `effects.tolerance` and `effects.of`"
            )
        return self

    @model_validator(mode="after")
    def _residual_needs_a_dwell(self) -> Self:
        for name in self.effects.of or ():
            if name.startswith("residual") and not self.trajectory.dwell:
                raise ValueError(
                    f"`effects.of` names {name}, but `trajectory.dwell` is 0 s: give a dwell, or remove {name}"
                )
        return self

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        owners: dict[str, str] = {}
        for key in ("controller", "shaper", "imperfection", "filter", "disturbance"):
            for index, section in enumerate(getattr(self, key)):
                name, place = getattr(section, "name", None), f"`{key}[{index}].name`"
                if name is not None and owners.setdefault(name, place) != place:
                    raise ValueError(f"{owners[name]} and {place} are both {name!r}: give each a name of its own")
        return self

    @model_validator(mode="after")
    def _disturbances_fit_the_robot(self) -> Self:
        if not self.disturbance:
            return self
        if self.cosimulation.drive != "torque":
            raise ValueError(
                "disturbances act on a robot that torques drive, a motion-driven one follows its references whatever acts "
                'on it: set `cosimulation.drive` = "torque", or leave `disturbance` out'
            )
        mass = self.payload.mass
        for index, each in enumerate(self.disturbance):
            if not isinstance(each, PayloadChangeSection):
                continue
            if not mass:
                raise ValueError(
                    f"`disturbance[{index}]` changes the payload: give `payload.mass` above 0 kg, that of the gripper for example"
                )
            if each.picked_up is None and (each.mass or 0.0) > mass:
                raise ValueError(
                    f"`disturbance[{index}].mass` = {each.mass:g} kg is dropped, but `payload.mass` is {mass:g} kg: reduce it, "
                    "or give the instant at which it is `picked_up`"
                )
        return self

    @model_validator(mode="after")
    def _cycles_are_given_once(self) -> Self:
        if self.trajectory.way_back != "none" and self.learners:
            raise ValueError(
                "controllers that learn repeat the motion there and back by their own `cycles`: leave out "
                "`trajectory.way_back`, `cycles` and `pause`; the dwell is the pause"
            )
        return self

    @model_validator(mode="after")
    def _transmission_has_a_motor(self) -> Self:
        effects = self.effects
        if effects.transmission is not None and self.cosimulation.drive == "torque" and not effects.motor_inertia:
            raise ValueError(
                "`effects.transmission` needs `effects.motor_inertia` above 0 kg.m2 where torques drive the robot: a motor "
                "without inertia behind a spring has no equation of motion; give the inertia, or leave the transmission out"
            )
        return self

    @model_validator(mode="after")
    def _modes_agree_with_start_pose(self) -> Self:
        try:
            check_start_pose(self.mechanism, self.start)
            if isinstance(self.trajectory, TableSection) and self.trajectory.table.coordinates == "joints":
                check_working_mode(self.mechanism, self.trajectory.table.start, self.start)
        except ValueError as error:
            raise ValueError("; ".join((str(error), *self.unit_hints))) from None
        return self

    @property
    def start(self) -> Point:
        """Position x, y of the rigid end effector at the start of the motion [m]."""
        section = self.trajectory
        if isinstance(section, TrajectorySection):
            return section.start
        start = section.table.start
        return start if section.table.coordinates == "end-effector" else end_effector(self.mechanism, start)

    @property
    def unit_hints(self) -> tuple[str, ...]:
        """A sentence for each value that suggests a wrong unit, millimetres or GPa for example; none for usual robots.

        These are hints, not errors: soft materials and huge mechanisms may be intended.
        """
        # lengths that suggest millimetres
        mechanism, motion = self.mechanism, self.trajectory
        links = {"proximal": mechanism.proximal, "distal": mechanism.distal}
        lengths = {f"mechanism.{name}.length": link.length for name, link in links.items()}
        lengths |= {"mechanism.base_half_distance": mechanism.base_half_distance}
        if isinstance(motion, TrajectorySection):
            lengths |= {"trajectory.height": motion.height, "trajectory.width": motion.width}
        elif motion.table.coordinates == "end-effector":
            lengths |= {"trajectory.file": motion.table.largest}
        hints = [
            f"`{key}` = {value:g} m is above {LARGEST_LENGTH:g} m: lengths are in m, millimetres are 1e-3 m"
            for key, value in lengths.items()
            if value > LARGEST_LENGTH
        ]
        hints += [
            f"`mechanism.{name}.diameter` = {link.diameter:g} m is above half the length, {link.length:g} m: diameters are "
            f"in m, millimetres are 1e-3 m"
            for name, link in links.items()
            if link.diameter > 0.5 * link.length
        ]
        # densities in g/cm3, moduli in GPa
        material = mechanism.material
        for key, value, unit, least, remedy in (
            ("density", material.density, "kg/m3", "100", "1 g/cm3 is 1000 kg/m3"),
            ("youngs_modulus", material.youngs_modulus, "Pa", "1e8", "it is in Pa, 1 GPa is 1e9 Pa"),
        ):
            if value < float(least):
                hints.append(f"`mechanism.material.{key}` = {value:g} {unit} is below {least} {unit}: {remedy}")
        return tuple(hints)

    @property
    def loads(self) -> dict[str, Any]:
        """Key → value for the keys of `LOADS` whose effect the robot has."""
        values = {key: self.effects if "." not in key else self for key in LOADS}
        values = {key: reduce(getattr, key.split("."), section) for key, section in values.items()}
        return {key: value for key, value in values.items() if LOADS[key].is_in(value)}

    def replace(self, changes: dict[str, Any]) -> Scene:
        """A new, validated scene with values changed by dotted keys.

        Args:
            changes: dotted key of the scene file → new value (a section may be given as a dict); elements of arrays have
                their index or name, ``controller[0].derivative`` or ``controller.pd.derivative``.

        Raises:
            SceneError: a key is unknown or a value is invalid.
        """
        # set each dotted key in the scene's plain data, then validate all of it
        data = self.model_dump(exclude_none=True)
        for key, value in changes.items():
            set_value(data, key, value, f"scene {self.name}")
        found = parse_scene(data, source=f"scene {self.name}")
        found.__dict__["origin"] = self.origin
        return found


def _listed(section: Section) -> str:
    """The keys of a section that differ from their defaults, with their values."""
    data = section.model_dump(mode="json", exclude_defaults=True)
    return ", ".join(f"{name} = {value}" for name, value in data.items())


def parse_scene(data: dict[str, Any], source: str, folder: Path | None = None) -> Scene:
    """A validated scene from plain data.

    Args:
        data: sections and keys.
        source: name of the origin in messages.
        folder: base of relative paths in the scene; None leaves them as they are.

    Raises:
        SceneError: a key or value is invalid; the message gives key, value, unit and remedy of each.
    """
    try:
        return Scene.model_validate(data, context={FOLDER: folder})
    except ValidationError as error:
        found = error.errors()
        more = f"; and {len(found) - MOST_ERRORS} more" if len(found) > MOST_ERRORS else ""
        raise SceneError(f"{'; '.join(sentences(found[:MOST_ERRORS], Scene))}{more} ({source})") from None
