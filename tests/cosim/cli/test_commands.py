"""The commands in this process: what they write and print, and how they end."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from command_line import flexfmu

from flexfmu.cosim.cli import console
from flexfmu.cosim.engine.errors import ResultsError
from flexfmu.cosim.experiment.scene_run import Run
from flexfmu.cosim.metrics.metric_table import METRICS
from flexfmu.cosim.studies.workprec.trial import RunError
from flexfmu.fmu_build.errors import MissingCompilerError
from flexfmu.model.scene.errors import EquilibriumError
from flexfmu.model.scene.file import load_scene, read_scene_text

MakeRun = Callable[..., Run]
SCENE = "barnard2012-6kg"


@pytest.fixture
def simulated(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Replace the simulation: simulated(run=...) or simulated(error=...); a complete run by default."""

    def replace(error: BaseException | None = None, **options: Any) -> None:
        def run_scene(*_: Any, **__: Any) -> Run:
            if error is not None:
                raise error
            return make_run(**options)

        monkeypatch.setattr("flexfmu.cosim.many.prepared_scene.run_scene", run_scene)

    return replace


def test_run_writes_the_formats_that_are_asked_for(simulated: Callable[..., None], tmp_path: Path) -> None:
    """Every format once, none of an earlier run beside them; units are in summary.json, too."""
    simulated()
    for formats in (["csv"], ["mat", "parquet", "mat"], ["mcap"]):
        options = [word for name in formats for word in ("--format", name)]
        result = flexfmu("run", SCENE, "--out", str(tmp_path), "--no-report", *options)
        assert result.exit_code == 0
        expected = {f"results.{name}" for name in formats}
        assert {path.name for path in tmp_path.iterdir()} == {*expected, "summary.json"}
        assert all(name in result.stdout for name in expected)
    units = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))["units"]
    assert (units["time"], units["joint1.torque"]) == ("s", "N.m")


def test_run_writes_and_prints_its_results(simulated: Callable[..., None], tmp_path: Path) -> None:
    """Three files, and a table that names every metric. --json prints what summary.json holds and nothing else; it doesn't draw
    unless --report is given, and leaves no report of an earlier run; --no-report saves the time."""
    simulated()
    drawn = []
    for options in (["--json", "--report"], ["--json"], [], ["--no-report"]):
        result = flexfmu("run", SCENE, "--out", str(tmp_path), *options)
        assert result.exit_code == 0
        drawn.append((tmp_path / "report.html").is_file())
        if "--json" in options:
            assert result.stdout == (tmp_path / "summary.json").read_text(encoding="utf-8")
            assert json.loads(result.stdout)["scene"]["name"] == SCENE
        if not options:
            assert {path.name for path in tmp_path.iterdir()} == {"results.csv", "summary.json", "report.html"}
            assert all(info.label in result.stdout for info in METRICS.values())
            assert result.stderr == ""
    assert drawn == [True, False, True, False]
    assert "results.csv and summary.json are in" in result.stdout


@pytest.mark.slow
def test_metrics_that_cannot_be_computed_do_not_lose_the_recording(
    simulated: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without an equilibrium at the end pose there are no metrics, but the results are there."""

    def no_equilibrium(*_: Any) -> None:
        raise EquilibriumError("no static equilibrium")

    simulated()
    monkeypatch.setattr("flexfmu.cosim.metrics.metrics.settings_for", no_equilibrium)
    result = flexfmu("run", SCENE, "--out", str(tmp_path))
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert (tmp_path / "summary.json").is_file()


@pytest.mark.parametrize(
    "error",
    [
        MissingCompilerError("no C compiler found; install gcc"),
        KeyboardInterrupt(),
        ResultsError("can't write results.csv: No space left on device"),
        OSError(28, "No space left on device"),
        RunError("plant failed at 0.1 s"),
    ],
)
def test_failures_are_one_line(simulated: Callable[..., None], tmp_path: Path, error: BaseException) -> None:
    """Every failure that a user can meet is one line on standard error, nothing on standard output; a mistake of ours keeps its
    traceback. A folder below a file can't be made: the simulation isn't even started."""
    simulated(error=error)
    result = flexfmu("run", SCENE, "--out", str(tmp_path))
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (1, "", 1)
    simulated(error=ZeroDivisionError("a mistake"))
    assert isinstance(flexfmu("run", SCENE, "--out", str(tmp_path)).exception, ZeroDivisionError)
    (tmp_path / "file").write_text("")
    result = flexfmu("run", SCENE, "--out", str(tmp_path / "file" / "out"))
    assert (result.exit_code, result.stderr.count("\n")) == (1, 1)
    assert "Not a directory" in result.stderr


WRONG_SCENES = {
    "unknown key": ('name = "x"', 'nmae = "x"', "name"),
    "missing key": ("mass = 6.0", "", "payload.mass"),
    "beyond the model's range": ("mass = 6.0", "mass = 1e9", "payload.mass"),
    "not TOML": ("mass = 6.0", "mass = ", "TOML"),
    "path leaves the workspace": ("width = 0.350", "width = 1.350", "reach"),
    "unfeasible clothoid": ('kind = "lame", height = 0.025', 'kind = "clothoid", height = 0.010', "clothoid"),
}
FINE_FOR = {
    "build": {"path leaves the workspace", "unfeasible clothoid"},  # the FMU doesn't depend on the path
    "modes": {"beyond the model's range"},  # frequencies need no FMU, but so heavy a robot has no equilibrium
    "run": set[str](),
}


@pytest.mark.parametrize(
    ("command", "mistake"),
    [(command, mistake) for command, fine in FINE_FOR.items() for mistake in WRONG_SCENES if mistake not in fine],
)
def test_wrong_scene_files_are_one_line_and_status_2(
    command: str, mistake: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each mistake names the key and the file, in one line, with exit status 2."""
    old, new, named = WRONG_SCENES[mistake]
    shipped = read_scene_text(SCENE)[0].replace(f'name = "{SCENE}"', 'name = "x"')
    assert old in shipped
    (tmp_path / "scene.toml").write_text(shipped.replace(old, new), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FLEXFMU_CACHE", str(tmp_path / "cache"))
    result = flexfmu(command, "scene.toml")
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.stderr
    assert named in result.stderr


SHIPPED = "barnard2012-0.1kg.*barnard2012-6kg"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *((f"{command} barnard2012-7kg", SHIPPED) for command in ("run", "build", "modes")),
        (f"build {SCENE} --platform amiga -o x.fmu", "linux64"),
        (f"run {SCENE} --format xlsx", "no format 'xlsx' of results; choose from csv, parquet, mat, mcap"),
        (f"run {SCENE} --live --no-report", "--live is about report.html: leave out --no-report"),
        (f"modes {SCENE} --poses 4", "must be odd and at least 3"),
        ("validate missing.fmu", "missing.fmu"),
        ("validate text.fmu", "text.fmu"),
        ("validate .", "no FMU at ."),
        (f"modes {SCENE} --set payload.mas=3", "did you mean `mass`"),
        (f"modes {SCENE} --set payload.mass=-1", "at least 0.0 kg, got -1 kg"),
        (f"modes {SCENE} --set payload.mass", "isn't KEY=VALUE"),
        (f"modes {SCENE} --set controller[0].derivative=3", "controller has no elements"),
        ("run some.ssp --set payload.mass=3", "--set payload.mass=3"),
        (f"run {SCENE} --stop-time 0.4", "a scene ends with its motion and `trajectory.dwell`"),
        ("workprec --hard --set payload.mass=3", "--set payload.mass=3"),
        ("new robot", "ends in .toml"),
        ("new none/robot.toml", "there is no folder"),
        ("new other.toml --from barnard", "barnard2012-0.1kg or barnard2012-6kg"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    simulated: Callable[..., None], arguments: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It names what would be right; nothing is simulated or written."""
    simulated(error=AssertionError("simulated"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.fmu").write_text("not a zip")
    result = flexfmu(*arguments.split())
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.stderr
    assert re.search(message if message == SHIPPED else re.escape(message), result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["text.fmu"]


def test_a_wrong_environment_variable_is_wrong_usage(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends like a wrong option."""
    monkeypatch.setenv("FLEXFMU_CACHE_LIMIT", "much")
    result = flexfmu("cache")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "FLEXFMU_CACHE_LIMIT is the most that the cache takes in MB, got 'much'" in result.stderr


def test_modes_json_has_the_contract_s_poses() -> None:
    """Start, middle and end of the path, ascending frequencies, the paper's first one near 58 Hz."""
    result = flexfmu("modes", SCENE, "--poses", "3", "--json")
    assert result.exit_code == 0
    poses = json.loads(result.stdout)["poses"]
    assert [pose["s"] for pose in poses] == [0.0, 0.5, 1.0]
    assert all(list(pose) == ["s", "x", "y", "q11", "q21", "frequencies"] for pose in poses)
    for pose in poses:
        assert pose["frequencies"] == sorted(pose["frequencies"])
        assert 57.0 - 0.5 < pose["frequencies"][0] < 59.0
    assert (poses[0]["x"], poses[0]["y"]) == pytest.approx(load_scene(SCENE).trajectory.start)
    assert poses[2]["x"] == pytest.approx(0.175)


def test_modes_of_a_rigid_robot_are_none() -> None:
    """A rigid scene has no frequencies, and that is no error."""
    rigid = ("--set", "effects.proximal_bending=0", "--set", "effects.distal_axial=0")
    result = flexfmu("modes", SCENE, "--poses", "3", *rigid)
    assert result.exit_code == 0
    assert "no natural frequencies" in result.stdout


def test_version_and_usage() -> None:
    """--version prints the installed version; a missing argument or an unknown command is status 2."""
    assert flexfmu("--version").stdout == f"flexfmu {version('flexfmu')}\n"
    assert flexfmu("run").exit_code == flexfmu("fly").exit_code == 2
    assert {flexfmu("modes", SCENE, "--poses", count).exit_code for count in ("2", "-1", "x")} == {2}


def test_long_work_in_a_pipe_says_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A line on standard error when one is due, none before."""
    for interval, lines in ((60.0, []), (0.0, ["flexfmu: running, 50 %", "flexfmu: timing"])):
        monkeypatch.setattr(console, "PIPED_INTERVAL", interval)
        with console.progress() as show:
            show("running", 0.5)
            show("timing", None)
        assert capsys.readouterr().err.splitlines() == lines
