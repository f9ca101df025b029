"""Plans that are interrupted at any instant go on where they ended, and end with the same result."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from flexfmu.cosim.design.plans.assessment import Candidate, Judge
from flexfmu.cosim.design.plans.planner import PlanResult, plan_scene
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.many.journal import FILE, WorkJournal, about_scene
from flexfmu.model.scene.file import load_scene

SCENE = load_scene("barnard2012-6kg").replace(
    {"trajectory.dwell": 0.01, "plan.payload_band": 0.0, "cosimulation.tolerance": 1e-4}
)
SLOWER = [
    Candidate(f"{share:g} of the time", "search", SCENE.replace({"trajectory.duration": share * 0.43}))
    for share in (1.1, 1.2, 1.3)
]


def planned(journal: WorkJournal) -> PlanResult:
    """The plan of a few given motions."""
    return plan_scene(SCENE, methods=(), candidates=SLOWER, robust=False, journal=journal)


def figures(found: PlanResult) -> list[Any]:
    """All that was assessed, and what was chosen."""
    return [
        (each.candidate.label, each.time, each.peaks[0].torque, each.uses) for each in (*found.assessed, found.chosen)
    ]


@pytest.mark.parametrize("after", [2])
def test_finished_units_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int) -> None:
    """What an error interrupts after some units has these in its folder; the next call makes the others alone."""
    made, left, usual = list[str](), [after], Judge._judged

    def counted(judge: Judge, candidate: Candidate, **options: Any) -> Any:
        if not left[0]:
            raise MemoryError
        left[0] -= 1
        made.append(f"{candidate.label}, {len(judge.variations)}")
        return usual(judge, candidate, **options)

    monkeypatch.setattr(Judge, "_judged", counted)
    with pytest.raises(MemoryError):
        planned(WorkJournal(tmp_path, "plan", about_scene(SCENE)))
    said, left[0] = list[str](), 100
    found = planned(WorkJournal(tmp_path, "plan", about_scene(SCENE), note=said.append))
    assert said == [f"continuing: {after} done"]
    assert not {*made[:after]} & {*made[after:]}
    assert figures(found) == figures(planned(WorkJournal()))
    with pytest.raises(InputError, match=r"has another plan: scene.payload.mass was 6.*--restart"):
        WorkJournal(tmp_path, "plan", about_scene(SCENE.replace({"payload.mass": 3.0})))


@pytest.mark.slow
def test_killed_plans_end_with_the_same_files(tmp_path: Path) -> None:
    """`kill -9` after each unit, then the same command: the files of the command that nothing has killed."""
    command = [
        *(sys.executable, "-m", "flexfmu", "plan", "barnard2012-6kg", "--method", "flexible", "--no-robust"),
        *("-j", "1", "--set", "plan.payload_band=0.1", "--out"),
    ]
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    subprocess.run([*command, whole], check=False, capture_output=True)
    for number in range(2, 6):
        with subprocess.Popen([*command, cut], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            deadline = time.monotonic() + 600.0
            while process.poll() is None and time.monotonic() < deadline:
                if (cut / FILE).exists() and (cut / FILE).read_bytes().count(b"\n") >= number:
                    break
                time.sleep(0.005)
            process.kill()
    again = subprocess.run([*command, cut], check=False, capture_output=True, text=True)
    assert "continuing: " in again.stderr
    assert not (cut / FILE).exists()
    for name in ("front.csv", "planned.csv", "planned.toml"):
        assert (cut / name).read_bytes() == (whole / name).read_bytes()
