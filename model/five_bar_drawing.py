"""The five-bar of a scene as a drawing."""

from __future__ import annotations

from flexfmu.model.assembly import bases, elbows
from flexfmu.model.drawing import Bar, Drawing, Spot
from flexfmu.model.scene import Scene


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
