"""The plants that a scene can drive, with what their documentation shows."""

from __future__ import annotations

from dataclasses import replace

from flexfmu.model.choice_text import choice_notes
from flexfmu.model.motion_driven import motion_driven_plant
from flexfmu.model.scene.assembly import bases, elbows
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import Bar, Drawing, Spot, SymbolicModel
from flexfmu.model.torque_driven import torque_driven_plant


def build_model(scene: Scene) -> SymbolicModel:
    """The plant that a scene drives as equations and variables."""
    model = torque_driven_plant(scene) if scene.cosimulation.drive == "torque" else motion_driven_plant(scene)
    return replace(model, drawing=draw_five_bar(scene), effects=(*model.effects, *choice_notes(scene)))


def draw_five_bar(scene: Scene) -> Drawing:
    """Both legs with motors, elbows and end effector at the start of the path, undeformed."""
    mechanism, end = scene.mechanism, scene.trajectory.start
    bars: list[Bar] = []
    spots: list[Spot] = []
    for leg, (base, elbow) in enumerate(zip(bases(mechanism), elbows(mechanism, end), strict=True), start=1):
        bars.append(Bar(f"link{leg}1", "proximal", base, elbow, mechanism.proximal.diameter))
        bars.append(Bar(f"link{leg}2", "distal", elbow, end, mechanism.distal.diameter))
        spots += [Spot(f"joint{leg}", "motor", base), Spot(f"elbow{leg}", "joint", elbow)]
    return Drawing(tuple(bars), (*spots, Spot("end_effector", "end effector", end)))
