"""`flexfmu export` and `flexfmu run` of SSP files, as they are typed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep
from zipfile import ZipFile

import pytest
import tomlkit
from ssp_support.packages import SSD, inline, of_second, parameter_set
from typer.testing import CliRunner, Result

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.engine.results import Recording
from flexfmu.model.scene.file import load_scene

MakeSsp = Callable[..., Path]
ISOLATES = pytest.mark.skipif(sys.platform != "linux", reason="isolation needs Linux")


def flexfmu(*arguments: str) -> Result:
    """Run a command."""
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.slow
def test_export_then_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A shipped scene leaves under its name and runs as it is, with the step that was asked for."""
    monkeypatch.chdir(tmp_path)
    exported = flexfmu("export", "barnard2012-6kg", "--json")
    assert exported.exit_code == 0, exported.output
    facts = json.loads(exported.stdout)
    assert Path(facts["path"]).stat().st_size == facts["bytes"]
    ran = flexfmu("run", facts["path"], "--step", "1e-3", "--json")
    assert ran.exit_code == 0, ran.output
    summary = json.loads(ran.stdout)
    assert summary == json.loads((tmp_path / "results" / "barnard2012-6kg" / "summary.json").read_text())
    assert (summary["outcome"], summary["communication_step"]) == ("completed", 1e-3)
    assert summary["end_time"] == summary["stop_time"]
    recording = Recording.read_csv(tmp_path / "results" / "barnard2012-6kg" / "results.csv")
    assert recording["end_effector.position.x"].values[-1] == pytest.approx(0.175, abs=1e-3)


@pytest.mark.slow
def test_export_names_what_other_masters_pass_on_late(tmp_path: Path) -> None:
    """Blocks of the same instants, not those that an offset keeps apart; delays put out states, which are in time."""
    robot = load_scene("barnard2012-6kg").replace({"cosimulation.drive": "torque", "effects.motor_inertia": 0.1})
    pd = {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}
    encoder = {"kind": "encoder", "counts_per_turn": 1e6, "sample_time": 2.5e-4}
    delay = {"kind": "delay", "signal": "position", "time": 2e-3}
    scenes = {
        "together": {"controller": [pd], "imperfection": [encoder]},
        "apart": {"controller": [pd | {"offset": 1e-4}], "imperfection": [encoder]},
        "delayed": {"controller": [pd | {"offset": 5e-4}], "imperfection": [delay | {"sample_time": 5e-4}]},
    }
    notes = {}
    for name, sections in scenes.items():
        path = tmp_path / f"{name}.toml"
        path.write_text(tomlkit.dumps(robot.replace(sections).model_dump(exclude_none=True)))
        exported = flexfmu("export", str(path), "-o", str(tmp_path / f"{name}.ssp"))
        assert exported.exit_code == 0, exported.output
        notes[name] = exported.stderr
    assert "note: encoder -> pd sample at the same instants" in notes["together"]
    assert notes["apart"] == notes["delayed"] == ""


def test_files_are_known_by_their_content(make_ssp: MakeSsp, tmp_path: Path) -> None:
    """What `flexfmu export -o robot.zip` wrote runs too, as that command says; an FMU is no scene and is named."""
    renamed = make_ssp().rename(tmp_path / "robot.zip")
    ran = flexfmu("run", str(renamed), "--step", "0.1", "--out", str(tmp_path / "out"))
    assert ran.exit_code == 0, ran.output
    with ZipFile(tmp_path / "robot.fmu", "w") as fmu:
        fmu.writestr("modelDescription.xml", "<fmiModelDescription/>")
    refused = flexfmu("run", str(tmp_path / "robot.fmu"))
    assert refused.exit_code == 2
    assert "robot.fmu is no SSP" in refused.stderr


def test_run_tells_what_it_ignored_and_texts(
    make_ssp: MakeSsp, make_decay: Callable[..., Path], tmp_path: Path
) -> None:
    """A parameter that fits nothing is a warning, in words. The table shows a String's last text, not its code; results.csv has
    all of them."""
    said = '<ScalarVariable name="said" valueReference="1" causality="output" variability="discrete"><String/></ScalarVariable>'
    files = {"resources/decay.fmu": make_decay(("</ModelVariables>", f"{said}</ModelVariables>"))}
    path = make_ssp(of_second(inline(parameter_set(rat='Real value="2"'))), files)
    ran = flexfmu("run", str(path), "--step", "0.1", "--out", str(tmp_path / "out"))
    assert ran.exit_code == 0, ran.output
    assert "warning: parameters that fit no variable were ignored: rat" in ran.stdout
    assert "second.x [m]" in ran.stdout
    line = next(each for each in ran.stdout.splitlines() if "first.said" in each)
    assert line.split(maxsplit=1)[1].strip() == '"decay, 10"'
    assert {each.name for each in (tmp_path / "out").iterdir()} == {"results.csv", "summary.json"}
    assert Recording.read_csv(tmp_path / "out" / "results.csv")["first.said"].text_at(0) == "decay, 0"


def in_trouble(kind: str) -> str:
    """The system whose second FMU fails at 0.5 s."""
    return of_second(inline(parameter_set(trouble=f'Enumeration value="{kind}"')))


NO_STOP = SSD.replace(' stopTime="1"', "")


@pytest.mark.parametrize(
    ("ssd", "status", "problem"),
    [
        (SSD.replace('version="1.0" name', 'version="3.0" name'), 2, "is of SSP 3.0"),
        (NO_STOP, 2, "decays.ssp names no stop time, nor does any FMU in it; say it: flexfmu run --stop-time SECONDS"),
        (SSD.replace('stopTime="1"', 'stopTime="-1"'), 2, "-1"),
        (in_trouble("fails"), 1, "tired"),
        pytest.param(
            in_trouble("exits"), 1, "failed at 0.5 s: it ended its process with exit status 0", marks=ISOLATES
        ),
    ],
    ids=["refused", "no stop time", "no time", "fails on the way", "exits"],
)
def test_failures_are_one_line(ssd: str, status: int, problem: str, make_ssp: MakeSsp, tmp_path: Path) -> None:
    """Status 2 for a file that is wrong, 1 for a run that fails, be it that an FMU calls exit, with what was recorded until
    then; the option that the line names helps."""
    arguments = ("run", str(make_ssp(ssd)), "--step", "0.1", "--out", str(tmp_path / "out"))
    result = flexfmu(*arguments)
    assert result.exit_code == status, result.output
    assert problem in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert (tmp_path / "out" / "results.csv").exists() == (status == 1)
    if status == 1:
        assert json.loads((tmp_path / "out" / "summary.json").read_text())["end_time"] == pytest.approx(0.5)
        assert Recording.read_csv(tmp_path / "out" / "results.csv").time[-1] == pytest.approx(0.5)
    if ssd == NO_STOP:
        ran = flexfmu(*arguments, "--json", "--stop-time", "0.4")
        assert json.loads(ran.stdout)["end_time"] == 0.4


@pytest.mark.parametrize("isolate", ["--no-isolate", pytest.param("--isolate", marks=ISOLATES)])
def test_what_fmus_print_is_no_result(make_ssp: MakeSsp, tmp_path: Path, isolate: str) -> None:
    """`--json` on standard output is JSON and nothing else, whatever a library prints there."""
    options = ["--step", "0.1", "--out", str(tmp_path / "out"), isolate, "--json"]
    program = "from flexfmu.cosim.cli.main import main; main()"
    command = [sys.executable, "-c", program, "run", str(make_ssp(in_trouble("ends"))), *options]
    environment = {**os.environ, "DECAY_PRINTS": "yes"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    # an FMU that ends the run is no failure either: status 0, complete files
    assert json.loads(done.stdout)["outcome"] == "ended_by_slave"
    assert Recording.read_csv(tmp_path / "out" / "results.csv").time[-1] == pytest.approx(0.5)
    assert "a licence of 1000 lines" in done.stderr


def hanging(process: int, isolated: bool, begin: dict[str, float]) -> bool:
    """Whether a process, or the one that its guard has started, has spent a second of processor time since it was looked at first, which
    all but an endless call doesn't take; however busy the machine is."""
    found = [str(process)]
    for _ in range(2 if isolated else 0):  # the guard, and the FMU's process
        found = [child for each in found for child in children(each)]
    return any(spent(each) - begin.setdefault(each, spent(each)) > 1.0 for each in found)


def children(process: str) -> list[str]:
    """Numbers of the processes that a process has started; none of one that is gone."""
    try:
        return Path(f"/proc/{process}/task/{process}/children").read_text().split()
    except OSError:
        return []


def spent(process: str) -> float:
    """Processor time of a process [s]; 0 of one that is gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return int(fields[11]) / os.sysconf("SC_CLK_TCK")


@pytest.mark.slow
@ISOLATES
@pytest.mark.parametrize("isolated", [True, False])
def test_sigterm_leaves_nothing_behind(isolated: bool, make_ssp: MakeSsp, tmp_path: Path) -> None:
    """SIGTERM ends a run like Ctrl-C, with status 143: what was recorded is written, no folder and no child stays. A
    program that an FMU holds within itself ends too, though it can't tidy up."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    path = make_ssp(in_trouble("hangs"))
    options = ["--step", "0.1", "--out", str(tmp_path / "out"), "--isolate" if isolated else "--no-isolate"]
    command = [sys.executable, "-c", "from flexfmu.cosim.cli.main import main; main()", "run", str(path), *options]
    running = subprocess.Popen(command, env={**os.environ, "TMPDIR": str(temporary)}, stderr=subprocess.PIPE, text=True)
    end, begin = monotonic() + 600.0, dict[str, float]()
    while not (list(temporary.glob("flexfmu-*")) and hanging(running.pid, isolated, begin)) and monotonic() < end:
        sleep(0.1)
    assert list(temporary.glob("flexfmu-*"))
    running.send_signal(signal.SIGTERM)
    _, problem = running.communicate(timeout=600)
    assert running.returncode == 143, problem
    if isolated:
        assert not list(temporary.glob("flexfmu-*"))
        assert Recording.read_csv(tmp_path / "out" / "results.csv").time[-1] == pytest.approx(0.5)
