"""The section `effects`: the physics of the model, and the tables that register effects.

A new effect needs a key in `Effects`, its class in `EFFECTS` and, unless `select = "auto"` chooses it, an entry in
`LOADS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self, get_args

from pydantic import BeforeValidator, Field, model_validator

from flexfmu.model.scene.choice import ChoiceSection, ChoiceTolerance, MetricNames
from flexfmu.model.scene.section import LARGEST, NOT_TINY, Section, as_tuple, named_kind, quantity

MAXIMUM_MODES = 40
"""Largest number of modes of one family; the tests check the shapes up to this mode."""

Acceleration = Annotated[float, Field(ge=-1e4, le=1e4)]

ModeCount = Annotated[int, quantity("modes", ge=0, le=MAXIMUM_MODES)]


class NoDampingSection(Section):
    """No structural damping."""

    kind: Literal["none"] = "none"


class ModalDampingSection(Section):
    """C_ii = 2 ratio sqrt(K_ii M_ii) for every mode of every link, with the link's own modal mass and stiffness."""

    text: ClassVar[str] = "Modal damping of every link mode, ratio {0.ratio:g}"
    kind: Literal["modal"]
    ratio: Annotated[float, quantity("1", ge=0.0, le=1e3)]


class StiffnessDampingSection(Section):
    """C = time * K on the elastic coordinates."""

    text: ClassVar[str] = "Damping proportional to the stiffness, time constant {0.time:g} s"
    kind: Literal["stiffness"]
    time: Annotated[float, quantity("s", ge=0.0, le=1e3)]


class MassDampingSection(Section):
    """C = rate * M on the elastic coordinates, with the modal mass matrix M of the link alone."""

    text: ClassVar[str] = "Damping proportional to the mass, rate {0.rate:g} 1/s"
    kind: Literal["mass"]
    rate: Annotated[float, quantity("1/s", ge=0.0, le=1e6)]


class RayleighDampingSection(Section):
    """C = rate * M + time * K on the elastic coordinates, with the modal mass matrix M of the link alone."""

    text: ClassVar[str] = "Damping {0.rate:g} 1/s times the mass and {0.time:g} s times the stiffness"
    kind: Literal["rayleigh"]
    rate: Annotated[float, quantity("1/s", ge=0.0, le=1e6)]
    time: Annotated[float, quantity("s", ge=0.0, le=1e3)]


DampingSection = Annotated[
    NoDampingSection | ModalDampingSection | StiffnessDampingSection | MassDampingSection | RayleighDampingSection,
    BeforeValidator(named_kind),
    Field(discriminator="kind"),
]


class SmoothFrictionSection(Section):
    """Friction torque viscous w + coulomb w / sqrt(w² + velocity²) at each motor, with the motor rate w."""

    text: ClassVar[str] = "Friction of each motor: {0.viscous:g} N m s/rad viscous, {0.coulomb:g} N m dry"
    kind: Literal["smooth"] = "smooth"
    viscous: Annotated[float, quantity("N.m.s/rad", ge=0.0, le=LARGEST)] = 0.0
    coulomb: Annotated[float, quantity("N.m", ge=0.0, le=LARGEST)] = 0.0
    velocity: Annotated[float, quantity("rad/s", gt=0.0, le=LARGEST), NOT_TINY] = 0.01

    @property
    def is_there(self) -> bool:
        """Whether there is any friction."""
        return bool(self.viscous or self.coulomb)


class StictionSection(Section):
    """Friction with stiction: a motor sticks up to `breakaway` (by default `coulomb`), and slips with `coulomb`.

    With a Stribeck velocity w_s, friction falls smoothly: coulomb + (breakaway - coulomb) exp(-(w / w_s)²).
    """

    text: ClassVar[str] = (
        "Friction of each motor: {0.viscous:g} N m s/rad viscous, {0.coulomb:g} N m dry, sticking up to {0.holding:g} N m"
    )
    kind: Literal["stiction"]
    viscous: Annotated[float, quantity("N.m.s/rad", ge=0.0, le=LARGEST)] = 0.0
    coulomb: Annotated[float, quantity("N.m", ge=0.0, le=LARGEST)] = 0.0
    breakaway: Annotated[float, quantity("N.m", ge=0.0, le=LARGEST)] | None = None
    stribeck_velocity: Annotated[float, quantity("rad/s", gt=0.0, le=LARGEST), NOT_TINY] | None = None

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
                f"`breakaway` must be at least `coulomb` = {self.coulomb} N·m, got {self.breakaway} N·m: "
                "a motor at rest is held by no less friction than one that turns"
            )
        return self


def _smooth_by_default(value: Any) -> Any:
    return {"kind": "smooth", **value} if isinstance(value, dict) else value


JointFrictionSection = Annotated[
    SmoothFrictionSection | StictionSection, BeforeValidator(_smooth_by_default), Field(discriminator="kind")
]


class Transmission(Section):
    """Elastic transmission between each motor and its proximal link."""

    stiffness: Annotated[float, quantity("N.m/rad", gt=0.0, le=LARGEST), NOT_TINY]
    damping: Annotated[float, quantity("N.m.s/rad", ge=0.0, le=LARGEST)] = 0.0


FamilyName = Literal["proximal_bending", "proximal_axial", "distal_bending", "distal_axial"]
CHOOSABLE = (*get_args(FamilyName), "beam", "foreshortening", "quasi_static")
"""Keys of `effects` that `select = "auto"` chooses; the others belong to the robot."""


class Effects(Section):
    """The physics of the model; a family with zero modes is rigid and has no code in the FMU.

    `select = "auto"` chooses the elastic effects: as few as keep the errors of the metrics in `of` below `tolerance`.
    """

    gravity: Annotated[tuple[Acceleration, Acceleration], BeforeValidator(as_tuple), quantity("m/s2")]
    basis: Literal["assumed-modes", "craig-bampton"]
    proximal_bending: ModeCount = 0
    proximal_axial: ModeCount = 0
    distal_bending: ModeCount = 0
    distal_axial: ModeCount = 0
    beam: Literal["euler-bernoulli", "timoshenko"] = "euler-bernoulli"
    foreshortening: Literal[False, True, "exact"] = False
    quasi_static: Annotated[tuple[FamilyName, ...], BeforeValidator(as_tuple)] = ()
    damping: DampingSection = NoDampingSection()
    motor_inertia: Annotated[float, quantity("kg.m2", ge=0.0, le=LARGEST)] = 0.0
    joint_friction: JointFrictionSection = SmoothFrictionSection()
    transmission: Transmission | None = None
    reactions: bool = False
    select: Literal["auto"] | None = None
    tolerance: ChoiceTolerance | None = None
    of: MetricNames | None = None
    choice: ChoiceSection | None = None

    @model_validator(mode="after")
    def _choice_is_free(self) -> Self:
        # keys of a choice without `select`, or `select` without these keys
        for key, value in {"tolerance": self.tolerance, "of": self.of}.items():
            if self.select is None and value is not None:
                raise ValueError(f'`{key}` belongs to `select = "auto"`: add that, or remove `{key}`')
            if self.select is not None and not value:
                raise ValueError(
                    f'`{key}` is missing: `select = "auto"` needs `tolerance = 0.01` and `of = ["peak_position_error"]`'
                )
        # keys that an automatic choice excludes
        chosen = [f"`{key}`" for key in CHOOSABLE if getattr(self, key) != type(self).model_fields[key].default]
        if self.select is not None and chosen:
            raise ValueError(
                f'`select = "auto"` chooses {", ".join(chosen)}: remove what it chooses, or remove `select`'
            )
        if self.select is not None and self.basis != "craig-bampton":
            raise ValueError(
                f'`select = "auto"` needs `basis = "craig-bampton"`, whose few shapes converge, got {self.basis!r}: leave `basis` out'
            )
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


EFFECTS = (
    "link_effects.LinkInertia",
    "link_effects.RotaryInertia",
    "link_effects.ElasticFamily",
    "link_effects.Foreshortening",
    "link_effects.ExactBending",
    "loads.PointPayload",
    "loads.PayloadInertia",
    "loads.Gravity",
    "loads.ModalDamping",
    "loads.ProportionalDamping",
    "loads.MotorInertia",
    "loads.ViscousFriction",
    "loads.CoulombFriction",
    "loads.StickingFriction",
    "loads.ElasticTransmission",
)
"""Module and class of every effect below `flexfmu.model`, in the order of their parameters in the FMU.

They are names, so that reading a scene doesn't import CasADi; `flexfmu.model.five_bar` imports the classes."""


@dataclass(frozen=True)
class Load:
    """An effect that belongs to the robot: never chosen, but left out to estimate its contribution.

    Attributes:
        absent: value of the key without the effect.
        change: the difference without the effect, in words.
        text: sentence in the summary of a run, in which {0} stands for the value; by default the ``text`` of the value, a section.
    """

    absent: Any
    change: str
    text: str = ""

    def sentence(self, value: Any) -> str:
        """What the summary of a run says of this value."""
        return (self.text or str(value.text)).format(value)

    def is_in(self, value: Any) -> bool:
        """Whether this value of the key adds the effect to the model; sections may have `is_there` for this."""
        return bool(getattr(value, "is_there", value != self.absent))


LOADS: Mapping[str, Load] = {
    "payload.inertia": Load(
        0.0, "without the payload's rotary inertia", "Rotary inertia of the payload of {0:g} kg m2, on link 12"
    ),
    "gravity": Load((0.0, 0.0), "without gravity", "Gravity of ({0[0]:g}, {0[1]:g}) m/s2"),
    "damping": Load(NoDampingSection(), "without structural damping"),
    "motor_inertia": Load(0.0, "without the motors' inertia", "Inertia of {0:g} kg m2 of each motor"),
    "joint_friction": Load(SmoothFrictionSection(), "without friction"),
    "transmission": Load(None, "with rigid transmissions", "Elastic transmissions of {0.stiffness:g} N m/rad"),
}
"""Load for each key, in the order of `flexfmu effects`; the key is below `effects` unless it contains a dot."""
