"""Effects are required by the frequencies that they move; a motion that they make ring is told."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import pytest

import flexfmu
from flexfmu.cosim.design.plans import required_effects as module
from flexfmu.cosim.design.plans.assessment import Assessment, Candidate, Judge, Peaks
from flexfmu.cosim.design.plans.goals import Variation, goals_of
from flexfmu.cosim.design.plans.required_effects import FullerModel, required_effects

EXAMPLES = Path(__file__).parents[4] / "examples"


@pytest.mark.parametrize(
    ("source", "required"),
    [
        # shear moves its frequencies by 0.58 %, distal bending by 0.06 %
        ("barnard2012-6kg", {"effects.beam"}),
        # 0.62 % and 0.90 %
        ("barnard2012-0.1kg", {"effects.beam", "effects.distal_bending"}),
        # 2.1 %; the scene has bending distal links
        pytest.param(EXAMPLES / "tubes.toml", {"effects.beam"}, marks=pytest.mark.slow),
        # 0.20 %
        pytest.param(EXAMPLES / "steel.toml", {"effects.beam"}, marks=pytest.mark.slow),
    ],
    ids=["6kg", "0.1kg", "tubes", "steel"],
)
def test_required_effects(source: str | Path, required: set[str]) -> None:
    """Tubes are soft in shear, light payloads let distal links vibrate, foreshortening matters nowhere here."""
    goals = goals_of(flexfmu.load_scene(source))
    assert required_effects(goals).keys() == required


def test_nothing_is_called_for_twice() -> None:
    """A scene with these effects has all that its plan needs: nothing is run."""
    goals = goals_of(flexfmu.load_scene("barnard2012-6kg"))
    fuller = goals_of(goals.scene.replace({**required_effects(goals)}))
    assert not required_effects(fuller)
    assert FullerModel(fuller).residual(Candidate("given", "given", fuller.scene)) == 0.0
    rigid = goals.scene.replace({"effects.proximal_bending": 0, "effects.distal_axial": 0})
    assert "effects.distal_bending" not in required_effects(goals_of(rigid))


class Figures:
    """Residual vibrations by label in place of runs."""

    effects: ClassVar = {"effects.beam": "timoshenko"}

    def __init__(self, goals: object) -> None: ...

    def residual(self, candidate: Candidate) -> float:
        return {"fast": 2e-6, "calm": 0.5e-6, "slow": 0.1e-6}[candidate.label]


@pytest.mark.parametrize(
    ("slower", "taken", "said"), [(1.02, "calm", ""), (1.1, "fast", "leaves 2 µm with effects.beam")]
)
def test_a_hardly_slower_motion_is_taken(slower: float, taken: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A motion that rings with shear gives way to one that is up to 3 % slower, and is told otherwise."""
    monkeypatch.setattr(module, "FullerModel", Figures)
    goals = goals_of(flexfmu.load_scene("barnard2012-6kg"))

    def motion(label: str, time: float) -> Assessment:
        peaks = Peaks(
            Variation(6.0), (1.0, 1.0), (0.0, 0.0), (1.0, 1.0), (1.0, 1.0), 1e-7, 1.0, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0
        )
        return Assessment(Candidate(label, "search", goals.scene), time, (peaks,), (1.0, 1.0, 1.0))

    ranked = [motion("fast", 0.2), motion("calm", 0.2 * slower), motion("slow", 0.3)]
    judge = Judge(goals)
    monkeypatch.setattr(judge, "assess", lambda candidate: next(each for each in ranked if each.candidate is candidate))
    chosen, note = module.most_robust(ranked[0], ranked, judge)
    assert chosen.candidate.label == taken
    assert said in note
    assert bool(said) == bool(note)
