"""Scenes as commands read them: with their effects chosen where they leave that open."""

from __future__ import annotations

from flexfmu.cosim.commands.console import progress
from flexfmu.cosim.commands.errors import show_note
from flexfmu.cosim.effects.choice import resolved
from flexfmu.model.scene import Scene
from flexfmu.model.scene_file import load_scene


def load_resolved(source: str) -> Scene:
    """A scene from its file or by its name; what was chosen is said on standard error.

    Raises:
        SceneError: as for `flexfmu.model.scene_file.load_scene`.
        TrajectoryError: effects are to be chosen along a motion that isn't feasible.
    """
    scene = load_scene(source)
    if scene.effects.select is None:
        return scene
    from flexfmu.model.selection.words import choice_sentence

    with progress() as show:
        chosen = resolved(scene, show)
    show_note(choice_sentence(chosen))
    return chosen
