"""Sweeps in this process's own folders: what a case is, what is kept, and how it continues."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import signal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexfmu
from flexfmu.cosim.cli.console import print_rich
from flexfmu.cosim.cli.studies import _shown_sweep
from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.metrics.metrics import measuring, metrics_of
from flexfmu.cosim.studies.sweep import work
from flexfmu.cosim.studies.sweep.cases import Cases, make_cases
from flexfmu.cosim.studies.sweep.result import Results, SweepResult
from flexfmu.cosim.studies.sweep.work import Job, Row, groups_of, shares_of
from flexfmu.fmu_build.errors import ArchiveError, MissingCompilerError
from flexfmu.model.scene.errors import SceneError

SCENE = flexfmu.load_scene("barnard2012-6kg").replace(
    {"trajectory.duration": 0.2, "trajectory.dwell": 0.02, "cosimulation.step": 1e-3, "cosimulation.tolerance": 1e-4}
)
LOOP = SCENE.replace(
    {
        "cosimulation.drive": "torque",
        "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 20.0, "sample_time": 1e-3}],
    }
)
PEAK = ["peak_torque_1"]


def alone(changes: dict[str, Any], names: list[str] = PEAK, scene: flexfmu.Scene = SCENE) -> dict[str, float | None]:
    """Metrics of the changed scene's own run, by an FMU with the same effects."""
    return metrics_of(flexfmu.run(scene.replace(changes), fmu=flexfmu.build(scene)), names)


@pytest.mark.slow
def test_a_case_is_the_changed_scene() -> None:
    """Parameters of the FMU, geometry that the motion is planned with, texts, other effects: as a scene of its own."""
    lengths, kinds = [0.24, 0.25], ["poly7", "bang-bang"]
    varied: dict[str, Any] = {"payload.mass": [0.0, 3.0], "mechanism.proximal.length": lengths}
    varied["trajectory.profile.kind"] = kinds
    found = flexfmu.sweep(SCENE, varied, metrics=PEAK, processes=2)
    assert found.failed == []
    for row in found:
        assert row["peak_torque_1"] == pytest.approx(
            alone({key: row[key] for key in varied})["peak_torque_1"], rel=1e-4
        )


@pytest.mark.slow
def test_many_cases_side_by_side_are_the_changed_scenes() -> None:
    """Shares in lanes, among them an invalid case, agree with own runs within the tolerance, for peaks and for all metrics."""
    masses = [float(each) for each in np.linspace(0.0, 8.0, 40)]
    cases = [{"payload.mass": mass, "trajectory.duration": 0.2} for mass in masses]
    cases.append({"trajectory.profile.kind": "trapezoidal", "trajectory.profile.ramp": 0.25})
    cases.append({"trajectory.profile.ramp": 0.25})
    for names in (PEAK, [*PEAK, "end_position_error"]):
        found = flexfmu.sweep(SCENE, cases, metrics=names, processes=1)
        assert [row["case"] for row in found.failed] == [41]
        assert "`trajectory.profile`" in found.failed[0]["message"]
        for number in (0, 17, 39, 40):
            expected = alone(cases[number], names)
            for name in names:
                assert found[number][name] == pytest.approx(expected[name], rel=1e-3, abs=1e-7)


def test_samples_are_whole_where_the_scene_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numbers of modes are, masses aren't, even if the ends of the interval are written as whole numbers."""

    monkeypatch.setattr(Job, "rows", lambda job, share: [job.failed(number, "") for number in share.numbers])
    varied = {"payload.mass": "0:8", "effects.distal_axial": "2:5"}
    found = flexfmu.sweep(SCENE, varied, sample="lhs:8", metrics=PEAK)
    assert sorted(row["effects.distal_axial"] for row in found) == [2, 2, 3, 3, 4, 4, 5, 5]
    assert not any(row["payload.mass"].is_integer() for row in found)


def test_cases_share_fmus_where_they_can() -> None:
    """One FMU for parameters, motions and loops; one for each number of modes. Every case is in one share."""
    cases, _ = make_cases(
        {
            "effects.proximal_bending": [1, 2],
            "payload.mass": range(20),
            "trajectory.duration": [0.2, 0.19, 0.1],
            "effects.gravity[1]": [-9.81, 0.0],
        }
    )
    groups = groups_of(SCENE, cases)
    assert [len(each.numbers) for each in groups] == [120, 120]
    assert all(each.parameters is not None for each in groups)
    metrics = Job(SCENE, cases, groups, measuring(PEAK)).metrics
    shares = [*shares_of(groups, cases, metrics, together=True)]
    assert sorted(number for share in shares for number in share.numbers) == list(range(240))
    # similar durations go together
    assert all(len({cases.rows[number][0] for number in share.numbers}) == 1 for share in shares)
    durations = [{cases.rows[number][2] for number in share.numbers} for share in shares]
    assert {0.1} in durations
    assert all(each <= {0.2, 0.19} or each == {0.1} for each in durations)
    # controllers depend on everything, and the FMU on none of them
    for key in ("controller[0].derivative", "pd.kd"):
        (group,) = groups_of(LOOP, make_cases({"payload.mass": [1.0, 2.0], key: [100.0, 200.0]})[0])
        assert group.parameters is None


@pytest.mark.parametrize(
    ("varied", "metric", "message"),
    [
        ({"payload.mas": [1.0]}, "peak_torque_1", "did you mean `mass`"),
        ({"payload.mass": [1.0, -1.0]}, "peak_torque_1", r"`payload.mass` must be at least 0"),
        ({"payload.mass": "-1:8"}, "peak_torque_1", "is an interval"),
        ({"controller[1].derivative": [1.0]}, "peak_torque_1", "element"),
        ({"payload.mass.x": [1.0]}, "peak_torque_1", "not a section"),
        (
            {"controller.pd.derivative": [10.0], "pd.kd": [20.0]},
            "peak_torque_1",
            r"`pd\.kd` and `controller\.pd\.derivative` are the same key",
        ),
        ({"effects.proximal_bending": [0, 1]}, "margin", "did you mean"),
        ({"payload.mass": [1.0]}, "inertia_ratio_1", r"of this robot: it needs a scene with `\[motor\]`"),
    ],
)
def test_what_cannot_be_is_told_before_work_starts(
    varied: dict[str, Any], metric: str, message: str, tmp_path: Path
) -> None:
    """Nothing is simulated and nothing written."""
    with pytest.raises((SceneError, InputError), match=message):
        flexfmu.sweep(LOOP, varied, metrics=[metric], out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_cases_that_fail_say_why() -> None:
    """`ramp` belongs to one profile alone; signals that the robot lacks are named in each line, without an FMU for each."""
    varied = {"trajectory.profile.kind": ["poly7", "trapezoidal"], "trajectory.profile.ramp": [0.2, 0.3]}
    found = flexfmu.sweep(SCENE, varied, metrics=PEAK, processes=1)
    assert [row["case"] for row in found.failed] == [0, 1]
    assert found[3]["peak_torque_1"] > 0.0
    assert found[0]["peak_torque_1"] is None
    found = flexfmu.sweep(SCENE, {"payload.mass": [1.0, 2.0]}, metrics=PEAK, record=["joint1.torqe"], processes=1)
    message = "there is no signal 'joint1.torqe' to record; did you mean 'joint1.torque'?"
    assert [row["message"] for row in found] == [message] * 2


def test_a_key_may_name_its_slave_by_the_kind_that_varies() -> None:
    """Each value is that of the key with an index."""
    scene = SCENE.replace({"shaper": [{"kind": "zvd"}]})
    found = [
        flexfmu.sweep(scene, {key: ["zv", "zvd"]}, metrics=PEAK, processes=1)
        for key in ("shaper.zvd.kind", "zvd.kind", "shaper[0].kind")
    ]
    values = [[row["peak_torque_1"] for row in each] for each in found]
    assert values[0] == values[1] == values[2]
    assert values[0][0] != values[0][1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished sweep with signals."""
    path = tmp_path_factory.mktemp("sweep") / "out"
    swept(path)
    return path


def swept(path: Path, **options: Any) -> SweepResult:
    """The sweep of `folder`."""
    usual: dict[str, Any] = {"metrics": PEAK, "record": ["joint1.torque"], "record_step": 0.0125, "processes": 2}
    varied = {"payload.mass": [1.0, 2.0], "trajectory.profile.kind": ["poly7"]}
    return flexfmu.sweep(SCENE, varied, out=path, **usual | options)


def test_results_in_files_and_notebooks(folder: Path) -> None:
    """Units in the headings, exact numbers, types and units in Parquet and data frames, signals at their interval."""
    with open(folder / "sweep.csv", encoding="utf-8", newline="") as file:
        head, *lines = csv.reader(file)
    assert head == ["case", "payload.mass [kg]", "trajectory.profile.kind", "peak_torque_1 [N.m]", "message"]
    result, frame = swept(folder), swept(folder).to_pandas()
    peaks = [row["peak_torque_1"] for row in result]
    assert [float(line[3]) for line in lines] == frame["peak_torque_1"].tolist() == peaks
    assert frame.attrs["units"] == {"payload.mass": "kg", "peak_torque_1": "N.m"}
    assert not (folder / "journal.csv").exists()
    recording, step = result.recording(1), 0.0125
    assert np.unique(recording.time)[:3].tolist() == [0.0, step, 2.0 * step]
    assert recording.time[-1] == pytest.approx(0.22)
    # between communication points as exact as these
    run = flexfmu.run(SCENE.replace({"payload.mass": 2.0, "cosimulation.step": 1e-3 / 2.0})).recording
    values = [each["joint1.torque"].values[each.time == step][0] for each in (recording, run)]
    assert values[0] == pytest.approx(values[1], rel=1e-4)
    # short text, table, picture
    assert (len(repr(result).splitlines()), result._repr_html_().count("<tr>")) == (5, 3)
    assert (len(result.plot().axes), result[-1], peaks[1].label) == (1, result[1], "Peak torque, joint 1")
    assert result.summary()["peak_torque_1"]["max_case"] == 1
    table = pytest.importorskip("pyarrow.parquet").read_table(folder / "sweep.parquet")
    assert table.schema.field("payload.mass").metadata == {b"unit": b"kg"}
    assert table["peak_torque_1"].to_pylist() == peaks


def test_another_sweep_in_the_folder_is_refused(folder: Path) -> None:
    """The message says what differs; the results stay."""
    before = (folder / "sweep.csv").read_bytes()
    with pytest.raises(InputError, match=r'metrics was \["peak_torque_1"\], now \["peak_torque_2"\]'):
        swept(folder, metrics=["peak_torque_2"])
    with pytest.raises(InputError, match=r"cases.count was 2, now 1.*--restart"):
        flexfmu.sweep(SCENE, {"payload.mass": [1.0]}, metrics=PEAK, out=folder)
    with pytest.raises(InputError, match=r"scene.trajectory.duration was 0.2, now 0.3"):
        flexfmu.sweep(
            SCENE.replace({"trajectory.duration": 0.3}), {"payload.mass": [1.0, 2.0]}, metrics=PEAK, out=folder
        )
    assert (folder / "sweep.csv").read_bytes() == before


def test_restart_discards(tmp_path: Path) -> None:
    """The folder then has the new sweep alone."""
    swept(tmp_path / "out")
    (tmp_path / "out" / "sweep.json").write_text("damaged")
    with pytest.raises(ResultsError, match="--restart"):
        swept(tmp_path / "out")
    found = swept(tmp_path / "out", metrics=["peak_torque_2"], record=None, record_step=None, restart=True)
    assert found.metrics == ("peak_torque_2",)
    assert not [*(tmp_path / "out" / "signals").iterdir()]


ROWS = [Row(number, (number / 3.0, None), 'a, "b"\nc' if number == 4 else "") for number in range(9)]


def results(folder: Path) -> Results:
    """Nine cases of two metrics."""
    return Results(Cases(("a",), [(number,) for number in range(9)]), ("m1", "m2"), {}, folder)


def written(folder: Path, order: list[int]) -> bytes:
    """The table after adding rows in some order."""
    with results(folder) as store:
        for number in order:
            store.add([ROWS[number]])
        store.finish()
    return (folder / "sweep.csv").read_bytes()


def test_torn_lines_are_cut_off(tmp_path: Path) -> None:
    """Wherever the last line is torn, the same table results, sorted by case; a line that is no case is an error."""
    whole = written(tmp_path / "whole", [4, 8, 0, 1, 7, 2, 6, 3, 5])
    with results(tmp_path / "out") as store:
        store.add(ROWS[:5])
    journal = tmp_path / "out" / "journal.csv"
    data = journal.read_bytes()
    ends = [i + 1 for i, sign in enumerate(data) if sign == ord("\n")]
    for low, high in pairwise(ends[-2:]):
        for end in range(low, high):
            folder = tmp_path / f"out{end}"
            with results(folder):
                pass
            (folder / "journal.csv").write_bytes(data[:end])
            with results(folder) as store:
                assert store.finished.tolist() == [True] * 4 + [False] * 5
            assert written(folder, [4, 5, 6, 7, 8]) == whole
    journal.write_bytes(data.replace(b"\n3,", b"\nx,"))
    with pytest.raises(ResultsError, match="no case"):
        results(tmp_path / "out")


def test_a_process_that_dies_is_replaced(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A case that kills its process twice is a row with its message; one that does so once has its result."""
    flag = tmp_path / "flag"
    rows = Job.rows

    def deadly(job: Job, share: Any) -> list[Row]:
        mass = job.cases.rows[share.numbers[0]][0]
        if mass == 2.0 or (mass == 3.0 and not flag.exists()):
            flag.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return rows(job, share)

    monkeypatch.setattr(Job, "rows", deadly)
    found = flexfmu.sweep(SCENE, {"payload.mass": [3.0, 2.0, 1.0]}, metrics=PEAK, processes=2)
    assert [row["message"] for row in found] == ["", "the process that simulated it ended with SIGKILL", ""]
    assert found[0]["peak_torque_1"] > found[2]["peak_torque_1"] > 0.0


def test_one_sweep_at_a_time_in_a_folder(tmp_path: Path) -> None:
    """Two processes would write the same journal."""
    pytest.importorskip("fcntl")
    with results(tmp_path) as store:
        pid = os.fork()
        if not pid:
            try:
                results(tmp_path)
            except ResultsError as error:
                os._exit(7 if "another command works" in str(error) else 1)
            os._exit(0)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7
        assert not store.finished.any()


@pytest.mark.slow
def test_the_example_of_the_docs(capsys: pytest.CaptureFixture[str]) -> None:
    """docs/sweep.md works as it stands: the heaviest payload in the shortest time needs the largest torque."""
    text = (Path(__file__).parents[4] / "docs" / "sweep.md").read_text(encoding="utf-8")
    code = text.partition("```python\n")[2].partition("```")[0]
    exec(compile(code, "sweep.md", "exec"), {})
    assert capsys.readouterr().out == "8 0.3 N.m\n"


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("fault", [MissingCompilerError("no C compiler: install one"), FULL])
def test_what_no_case_can_help_ends_the_sweep(fault: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """One error instead of a table of them, which a later sweep in the folder would take for results."""

    def fails(*_: Any, **__: Any) -> None:
        if fault is FULL:
            raise ArchiveError("cannot compile") from fault
        raise fault

    monkeypatch.setattr(work, "build_scene", fails)
    with pytest.raises(ArchiveError if fault is FULL else MissingCompilerError):
        flexfmu.sweep(SCENE, {"payload.mass": [1.0, 2.0]}, metrics=PEAK, processes=1)


def test_extremes_are_named_by_their_values(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Whoever reads the table sees with which values a metric is largest, and which case failed first."""
    varied = {"payload.mass": [1.0, 2.0, 3e4], "trajectory.blend": [{"kind": "lame", "height": 0.02, "width": 0.02}]}
    found = SweepResult(
        "a",
        make_cases(varied)[0],
        ("still", "m"),
        np.array([[0.0, 2.0], [0.0, 5.0], [np.nan] * 2]),
        {2: "too heavy"},
        {},
        {},
    )
    assert "still goes" not in found.page()
    assert "m goes from 2 (payload.mass=1" in found.page()
    assert found.summary()["m"]["max_values"] == {
        "payload.mass": 2.0,
        "trajectory.blend": varied["trajectory.blend"][0],
    }
    assert "first payload.mass=30000, trajectory.blend=lame" in repr(found)
    print_rich(*_shown_sweep(found, [tmp_path / "sweep.csv"]))
    printed = capsys.readouterr().out
    assert "payload.mass=1, trajectory.blend=lame" in printed
    assert "payload.mass=2, trajectory.blend=lame" in printed
    assert "1 failed, the first with payload.mass=30000, trajectory.blend=lame: too heavy" in printed


@pytest.mark.parametrize(("others", "labels"), [(6, [f"pd.kp={kp}, pd.kd={kd}" for kp in (2000, 20000) for kd in (20, 40, 60)]), (10, ["pd.kp=2000", "pd.kp=20000"])])  # fmt: skip
def test_points_have_colours_and_a_legend(others: int, labels: list[str]) -> None:
    """Of as many keys as there are colours for; values are without powers of ten."""
    varied = {"payload.mass": [1.0, 2.0], "pd.kp": [2e3, 2e4], "pd.kd": [20.0 * k for k in range(1, others // 2 + 1)]}
    cases = make_cases(varied)[0]
    found = SweepResult("a", cases, ("m",), np.arange(2.0 * others)[:, np.newaxis], {}, {}, {})
    page = found.page()
    (text,) = re.findall(r'<script type="application/json">(.*?)</script>', page)
    curves = [each for each in json.loads(text)["panels"][0]["curves"] if each["is_read"]]
    assert [each["label"] for each in curves] == labels
    assert len({each["colour"] for each in curves}) == len(labels)
    # with a line where it has one point for each value
    assert {each["width"] > 0.0 for each in curves} == {others == 6}
