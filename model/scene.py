"""The scene: everything that a simulation depends on, as frozen sections that mirror the TOML file (SI units, rad)."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.choice_section import Choice, ChoiceTolerance, MeasureNames, contradictions, fill_in
from flexfmu.model.controller_sections import ControllerSection
from flexfmu.model.cosimulation_section import Cosimulation
from flexfmu.model.errors import SceneError
from flexfmu.model.imperfection_sections import ImperfectionSection
from flexfmu.model.section import Seconds, SecondsOrZero, Section, as_tuple, named_kind, quantity
from flexfmu.model.shaper_sections import ShaperSection

MAXIMUM_MODES = 40
"""Largest number of modes of one family; far above what the 1e-10 orthogonality of the shapes has been tested for."""

LARGEST_LENGTH, LEAST_DENSITY, LEAST_MODULUS = 10.0, 100.0, 1e8
"""Beyond these [m, kg/m3, Pa] a value suggests another unit: no robot has such links, no structural material is so light
or so soft."""

Length = Annotated[float, quantity("m", gt=0.0)]
LengthOrZero = Annotated[float, quantity("m", ge=0.0)]
Point = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m")]
Direction = Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("1")]
ModeCount = Annotated[int, quantity("modes", ge=0, le=MAXIMUM_MODES)]


class Link(Section):
    """A round rod; `inner_diameter` makes it a tube."""

    length: Length
    diameter: Length
    inner_diameter: LengthOrZero = 0.0

    @model_validator(mode="after")
    def _tube_has_a_wall(self) -> Self:
        if self.inner_diameter >= self.diameter:
            raise ValueError(
                f"`inner_diameter` must be below `diameter` = {self.diameter} m, got {self.inner_diameter} m"
            )
        return self


class Material(Section):
    """Linear elastic material of all links."""

    density: Annotated[float, quantity("kg/m3", gt=0.0)]
    youngs_modulus: Annotated[float, quantity("Pa", gt=0.0)]
    poissons_ratio: Annotated[float, quantity("1", gt=-1.0, le=0.5)] = 0.33


class Mechanism(Section):
    """The five-bar mechanism: bases at (-base_half_distance, 0) and (+base_half_distance, 0), leg 1 at the negative side."""

    base_half_distance: Length
    working_mode: Literal["elbows-out", "elbows-in", "left", "right"]
    assembly_mode: Literal["left", "right"]
    proximal: Link
    distal: Link
    material: Material


class Payload(Section):
    """Point mass at the end effector, and rotary inertia that turns with link 12; zero leaves each out of the model."""

    mass: Annotated[float, quantity("kg", ge=0.0)]
    inertia: Annotated[float, quantity("kg.m2", ge=0.0)] = 0.0


class NoDamping(Section):
    """No structural damping."""

    kind: Literal["none"] = "none"


class ModalDamping(Section):
    """C_ii = 2 ratio sqrt(K_ii M_ii) for every mode of every link, with the link's own modal mass and stiffness."""

    kind: Literal["modal"]
    ratio: Annotated[float, quantity("1", ge=0.0, lt=1.0)]


class StiffnessDamping(Section):
    """C = time * K on the elastic coordinates."""

    kind: Literal["stiffness"]
    time: Annotated[float, quantity("s", ge=0.0)]


class MassDamping(Section):
    """C = rate * M on the elastic coordinates, with the link's own modal mass M."""

    kind: Literal["mass"]
    rate: Annotated[float, quantity("1/s", ge=0.0)]


class RayleighDamping(Section):
    """C = rate * M + time * K on the elastic coordinates, with the link's own modal mass M."""

    kind: Literal["rayleigh"]
    rate: Annotated[float, quantity("1/s", ge=0.0)]
    time: Annotated[float, quantity("s", ge=0.0)]


Damping = Annotated[
    NoDamping | ModalDamping | StiffnessDamping | MassDamping | RayleighDamping,
    BeforeValidator(named_kind),
    Field(discriminator="kind"),
]


class SmoothFriction(Section):
    """Friction torque viscous w + coulomb w / sqrt(w² + velocity²) at each motor that turns with w."""

    kind: Literal["smooth"] = "smooth"
    viscous: Annotated[float, quantity("N.m.s/rad", ge=0.0)] = 0.0
    coulomb: Annotated[float, quantity("N.m", ge=0.0)] = 0.0
    velocity: Annotated[float, quantity("rad/s", gt=0.0)] = 0.01

    @property
    def is_there(self) -> bool:
        """Whether there is any friction."""
        return bool(self.viscous or self.coulomb)


class Stiction(Section):
    """Friction that holds a motor up to the torque `breakaway`, `coulomb` by default, and slips with `coulomb`.

    With a Stribeck velocity w_s it falls smoothly, coulomb + (breakaway - coulomb) exp(-(w / w_s)²), else at once.
    """

    kind: Literal["stiction"]
    viscous: Annotated[float, quantity("N.m.s/rad", ge=0.0)] = 0.0
    coulomb: Annotated[float, quantity("N.m", ge=0.0)] = 0.0
    breakaway: Annotated[float, quantity("N.m", ge=0.0)] | None = None
    stribeck_velocity: Annotated[float, quantity("rad/s", gt=0.0)] | None = None

    @property
    def holding(self) -> float:
        """Largest torque [N m] that holds a motor."""
        return self.coulomb if self.breakaway is None else self.breakaway

    @property
    def is_there(self) -> bool:
        """Whether there is any friction."""
        return bool(self.viscous or self.holding)

    @model_validator(mode="after")
    def _holds_more_than_it_brakes(self) -> Self:
        if self.holding < self.coulomb:
            raise ValueError(
                f"`breakaway` must be at least `coulomb` = {self.coulomb} N.m, got {self.breakaway} N.m: "
                "a motor at rest is held by no less friction than one that turns"
            )
        return self


def _smooth_by_default(value: Any) -> Any:
    return {"kind": "smooth", **value} if isinstance(value, dict) else value


JointFriction = Annotated[SmoothFriction | Stiction, BeforeValidator(_smooth_by_default), Field(discriminator="kind")]


class Transmission(Section):
    """Elastic transmission between each motor and its proximal link."""

    stiffness: Annotated[float, quantity("N.m/rad", gt=0.0)]
    damping: Annotated[float, quantity("N.m.s/rad", ge=0.0)] = 0.0


FamilyName = Literal["proximal_bending", "proximal_axial", "distal_bending", "distal_axial"]
CHOOSABLE = (*get_args(FamilyName), "beam", "foreshortening", "quasi_static")
"""Keys of `effects` that `select = "auto"` chooses; the others are given by the robot."""


class Effects(Section):
    """Which physics the model contains; a family with zero modes is rigid and leaves nothing in the generated code.

    With `select = "auto"` the elastic effects are chosen: as few as keep the metrics in `of` within `tolerance`.
    """

    gravity: Annotated[tuple[float, float], BeforeValidator(as_tuple), quantity("m/s2")]
    basis: Literal["assumed-modes", "craig-bampton"]
    proximal_bending: ModeCount = 0
    proximal_axial: ModeCount = 0
    distal_bending: ModeCount = 0
    distal_axial: ModeCount = 0
    beam: Literal["euler-bernoulli", "timoshenko"] = "euler-bernoulli"
    foreshortening: bool = False
    quasi_static: Annotated[tuple[FamilyName, ...], BeforeValidator(as_tuple)] = ()
    damping: Damping = NoDamping()
    motor_inertia: Annotated[float, quantity("kg.m2", ge=0.0)] = 0.0
    joint_friction: JointFriction = SmoothFriction()
    transmission: Transmission | None = None
    reactions: bool = False
    select: Literal["auto"] | None = None
    tolerance: ChoiceTolerance | None = None
    of: MeasureNames | None = None
    choice: Choice | None = None

    @model_validator(mode="after")
    def _choice_is_free(self) -> Self:
        switched_on = tuple(key for key in CHOOSABLE if getattr(self, key) != type(self).model_fields[key].default)
        given = {"tolerance": self.tolerance, "of": self.of}
        for sentence in contradictions(self.select, given, self.basis, switched_on):
            raise ValueError(sentence)
        return self

    @model_validator(mode="after")
    def _static_families_have_modes(self) -> Self:
        for family in self.quasi_static:
            if self.quasi_static.count(family) > 1:
                raise ValueError(f"`quasi_static` names {family} twice: once is enough")
            if not getattr(self, family):
                raise ValueError(
                    f"`quasi_static` names {family}, which has no modes: give `{family}` at least 1, or take it from the list"
                )
        return self


class Blend(Section):
    """Rounding of the path's two corners: d = height along the lift, e = width along the crossing."""

    kind: Literal["lame", "clothoid", "polar"]
    height: Length
    width: Length


class Profile(Section):
    """Motion along the path; `ramp` is the fraction of the duration of each ramp of the trapezoidal velocity."""

    kind: Literal["poly7", "bang-bang", "trapezoidal"]
    ramp: Annotated[float, quantity("1", gt=0.0, le=0.5)] | None = None

    @model_validator(mode="after")
    def _ramp_belongs_to_trapezoidal(self) -> Self:
        if self.kind == "trapezoidal" and self.ramp is None:
            raise ValueError(
                "`ramp` is missing: profile `trapezoidal` needs 0 < ramp <= 0.5 (fraction of the duration)"
            )
        if self.kind != "trapezoidal" and self.ramp is not None:
            raise ValueError(
                f"`ramp` = {self.ramp} belongs to profile `trapezoidal` alone: remove it from `{self.kind}`"
            )
        return self


class TrajectorySection(Section):
    """The Adept half cycle: lift, crossing and lowering with blended corners, then a standstill of `dwell`."""

    start: Point
    lift: Direction
    height: Length
    width: Length
    blend: Blend
    profile: Annotated[Profile, BeforeValidator(named_kind)]
    duration: Seconds
    dwell: SecondsOrZero = 0.0

    @model_validator(mode="after")
    def _blends_fit(self) -> Self:
        if math.hypot(*self.lift) == 0.0:
            raise ValueError("`lift` must be a direction with a length above zero, got [0.0, 0.0]")
        if self.blend.height > self.height:
            raise ValueError(f"`blend.height` must be at most `height` = {self.height} m, got {self.blend.height} m")
        if self.blend.width > self.width / 2:
            raise ValueError(f"`blend.width` must be at most `width`/2 = {self.width / 2} m, got {self.blend.width} m")
        return self


class Scene(Section):
    """A complete scene. `flexfmu.model.scene_file.load_scene` reads one from a TOML file.

    Example:
        ``scene.replace({"payload.mass": 0.1, "trajectory.duration": 0.30})`` is the same scene with two values changed.
    """

    name: Annotated[str, Field(min_length=1, pattern=r"^[\w.+-]*\w[\w.+-]*$")]
    mechanism: Mechanism
    payload: Payload
    effects: Effects
    trajectory: TrajectorySection
    cosimulation: Cosimulation
    controller: Annotated[tuple[ControllerSection, ...], BeforeValidator(as_tuple)] = ()
    shaper: Annotated[tuple[ShaperSection, ...], BeforeValidator(as_tuple)] = ()
    imperfection: Annotated[tuple[ImperfectionSection, ...], BeforeValidator(as_tuple)] = ()

    @model_validator(mode="before")
    @classmethod
    def _fill_in_for_choice(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not {"effects", "cosimulation"} <= data.keys():
            return data
        effects, cosimulation = fill_in(data["effects"], data["cosimulation"])
        return {**data, "effects": effects, "cosimulation": cosimulation}

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
        tables = (("controller", self.controller), ("shaper", self.shaper), ("imperfection", self.imperfection))
        owners: dict[str, str] = {}
        for key, sections in tables:
            for index, section in enumerate(sections):
                name, place = getattr(section, "name", None), f"`{key}[{index}].name`"
                if name is not None and owners.setdefault(name, place) != place:
                    raise ValueError(f"{owners[name]} and {place} are both {name!r}: give each a name of its own")
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
        from flexfmu.model.assembly import check_start_pose

        try:
            check_start_pose(self.mechanism, self.trajectory.start)
        except ValueError as error:
            raise ValueError("; ".join((str(error), *self.unit_hints))) from None
        return self

    @property
    def unit_hints(self) -> tuple[str, ...]:
        """A sentence for each value that suggests another unit, millimetres or GPa for example; none for usual robots.

        They are hints, not errors: soft materials and huge mechanisms can be meant.
        """
        mechanism, path = self.mechanism, self.trajectory
        links = {"proximal": mechanism.proximal, "distal": mechanism.distal}
        lengths = {f"mechanism.{name}.length": link.length for name, link in links.items()}
        lengths |= {"mechanism.base_half_distance": mechanism.base_half_distance}
        lengths |= {"trajectory.height": path.height, "trajectory.width": path.width}
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
        material = mechanism.material
        if material.density < LEAST_DENSITY:
            hints.append(
                f"`mechanism.material.density` = {material.density:g} kg/m3 is below {LEAST_DENSITY:g} kg/m3: 1 g/cm3 is "
                f"1000 kg/m3"
            )
        if material.youngs_modulus < LEAST_MODULUS:
            hints.append(
                f"`mechanism.material.youngs_modulus` = {material.youngs_modulus:g} Pa is below 1e8 Pa: it is "
                f"in Pa, 1 GPa is 1e9 Pa"
            )
        return tuple(hints)

    def replace(self, changes: dict[str, Any]) -> Scene:
        """The scene with values changed by dotted keys, validated anew.

        Args:
            changes: dotted key of the scene file → new value (a section may be given as a dict).

        Raises:
            SceneError: a key is unknown or a value out of range.
        """
        from flexfmu.model.scene_file import parse_scene

        data = self.model_dump(exclude_none=True)
        for key, value in changes.items():
            *parents, last = key.split(".")
            section = data
            for parent in parents:
                section = section.setdefault(parent, {})
                if not isinstance(section, dict):
                    raise SceneError(
                        f"scene {self.name} has no key {key}: {parent} is the value {section!r}, not a section"
                    )
            section[last] = value
        return parse_scene(data, source=f"scene {self.name}")
