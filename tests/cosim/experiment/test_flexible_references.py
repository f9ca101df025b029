"""Scenes whose references are for the flexible robot: its end effector follows the path, judged by the FMU."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.experiment.cycles import repeated
from flexfmu.cosim.experiment.planning import Standstill, plan, plan_rigid
from flexfmu.cosim.reports.summary import jerk_jump, summarise
from flexfmu.model.reference_design.inverse_dynamics import LEAD
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.file import load_scene
from flexfmu.model.scene.schema import Scene
from flexfmu.trajectories.errors import TrajectoryError

FLEXIBLE: dict[str, Any] = {"trajectory.references": "flexible"}


@cache
def robot() -> Scene:
    """The shipped robot with one mode for each proximal link, and little damping."""
    few = {"effects.proximal_bending": 1, "effects.distal_axial": 0, "effects.damping.ratio": 0.01}
    fine = {"trajectory.dwell": 0.05, "cosimulation.tolerance": 1e-8}
    return load_scene("barnard2012-6kg").replace(few | fine)


def test_the_flexible_end_effector_follows_the_path() -> None:
    """Position error, residual vibration and torque fall, by what references for the rigid robot cost."""
    assert robot().replace({"trajectory.references": "rigid"}) == robot()
    rigid, flexible = (flexfmu.run(robot().replace(changes)).metrics for changes in ({}, FLEXIBLE))
    assert flexible.peak_position_error is not None
    assert flexible.peak_position_error < 1e-6 < 1e-4 < (rigid.peak_position_error or 0.0)
    assert flexible.residual_vibration_amplitude is not None
    assert flexible.residual_vibration_amplitude < 1e-7 < 1e-5 < (rigid.residual_vibration_amplitude or 0.0)
    assert flexible.settling_time == 0.0
    assert (flexible.peak_torque_1 or 0.0) < (rigid.peak_torque_1 or 0.0)


def test_other_payloads_keep_the_references_of_the_scene() -> None:
    """A sweep over FMU parameters asks what happens when the payload isn't the one that the references are for."""
    scene = robot().replace(FLEXIBLE)
    wrong = flexfmu.run(scene, parameters={"payload.mass": 4.2})
    known = flexfmu.run(scene.replace({"payload.mass": 4.2}))
    assert (known.metrics.peak_position_error or 1.0) < 1e-6
    assert 2e-5 < (wrong.metrics.peak_position_error or 0.0) < 1e-4


def test_the_joints_start_before_the_end_effector() -> None:
    """By 2 ms, and they stop as long after it; motion and metrics count from the joints' start."""
    motion, rigid = plan(robot().replace(FLEXIBLE)), plan(robot())
    assert motion.duration == pytest.approx(rigid.duration + 2.0 * LEAD, abs=1e-15)
    for time in (-1.0, 0.0, LEAD, 0.1, motion.duration - LEAD, 1.0):
        expected = rigid.task.evaluate(time - LEAD, 2)
        np.testing.assert_array_equal(motion.task.evaluate(time, 2), expected)
    still = motion.joints.evaluate([0.0, motion.duration], 3)
    np.testing.assert_allclose(still[1:], 0.0, atol=1e-6)


def test_shapers_act_on_the_path() -> None:
    """The references follow the shaped motion; shaped joints would no longer follow anything."""
    shaper = {"kind": "zv", "modes": [{"frequency": 40.0, "ratio": 0.1}]}
    shaped = robot().replace(FLEXIBLE | {"shaper": [{**shaper, "apply": "path"}]})
    run = flexfmu.run(shaped)
    assert run.plan.duration > plan(robot().replace(FLEXIBLE)).duration + 0.01
    assert (run.metrics.peak_position_error or 1.0) < 1e-6
    for place in ("joints", "sampled"):
        other = {**shaper, "apply": place, **({"sample_time": 1e-3} if place == "sampled" else {})}
        with pytest.raises(TrajectoryError, match="shape the motion along the path"):
            flexfmu.run(robot().replace(FLEXIBLE | {"shaper": [other]}))


class Line:
    """10 cm to the right, as a class of the user's."""

    duration = 0.2

    def position(self, time: float) -> tuple[float, float]:
        """x and y [m]."""
        s = time / self.duration
        return -0.1 + 0.1 * s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3), 0.33


def test_tables_and_own_motions_of_the_end_effector(tmp_path: Path) -> None:
    """Any motion of the end effector has such references."""
    time = np.linspace(0.0, Line.duration, 101)
    rows = ["time,end_effector.position.x,end_effector.position.y"]
    rows += [f"{t!r},{x!r},{y!r}" for t, (x, y) in ((t, Line().position(t)) for t in time.tolist())]
    (tmp_path / "line.csv").write_text("\n".join(rows))
    section = {"kind": "table", "file": str(tmp_path / "line.csv"), "dwell": 0.05, "references": "flexible"}
    by_table = flexfmu.run(robot().replace({"trajectory": section}))
    own = flexfmu.run(robot().replace(FLEXIBLE), trajectory=Line())
    for run in (by_table, own):
        assert (run.metrics.peak_position_error or 1.0) < 2e-6
        assert run.plan.duration == pytest.approx(Line.duration + 2.0 * LEAD)


def test_what_has_no_such_references_is_refused(tmp_path: Path) -> None:
    """A motion of the joints has references already; the flexible robot's motion isn't the same reversed in time, since damping
    isn't."""
    file = tmp_path / "joints.csv"
    file.write_text(
        "time,joint1.reference.position,joint2.reference.position\n0,3,0.4\n0.1,3,0.4\n0.2,3,0.4\n0.3,3,0.4\n"
    )
    with pytest.raises(SceneError, match="is one of the joints"):
        robot().replace({"trajectory": {"kind": "table", "file": str(file), "references": "flexible"}})
    with pytest.raises(SceneError, match="leave out `way_back`"):
        robot().replace(FLEXIBLE | {"trajectory.way_back": "same-path"})
    with pytest.raises(InputError, match="way back needs others"):
        repeated(plan(robot().replace(FLEXIBLE)), 2)


def test_the_summary_states_the_jerk() -> None:
    """Lamé corners of third order make the path's jerk jump: the joints' jerk depends on the knots, and the summary says so."""
    run = flexfmu.run(robot().replace(FLEXIBLE))
    facts = summarise(run, flexfmu.measure_run(run, companions=0))["references"]
    assert facts["knot_spacing"] == pytest.approx(0.002)
    assert 2e4 < facts["largest_joint_jerk"] < 4e4
    assert "jumps" in facts["warning"]
    straight = Standstill(plan_rigid(robot()).task, 0.01)
    assert jerk_jump(straight) == pytest.approx(facts["jerk_jump"])
