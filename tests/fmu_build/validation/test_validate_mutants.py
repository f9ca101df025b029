"""Validation finds nothing in a sound FMU, written apart from this package, and what is spoilt in its mutants."""

from __future__ import annotations

import json
import os
import platform
import resource
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu as validate_by_fmpy
from typer.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder

from mutants import DESCRIPTION, LIBRARY, MUTANTS, Mutant, compile_spring, sound_variants, spring3, spring_files, zipped

from flexfmu.cosim.cli.main import app
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.archive import pack
from flexfmu.fmu_build.errors import ArchiveError
from flexfmu.fmu_build.toolchain import native_platform
from flexfmu.fmu_build.validation.dependencies import answers
from flexfmu.fmu_build.validation.finding import Finding, Severity
from flexfmu.fmu_build.validation.validate import validate_fmu
from flexfmu.fmu_build.validation.worker import disturbances
from flexfmu.model.scene.file import load_scene

pytestmark = pytest.mark.skipif(native_platform().name != "linux64", reason="compiles and reads ELF")

NAMED = (
    "nan_late part_of_step rate start shared_parameter saving_disturbs undeclared_input environment derivatives_doubled"
)
"""Some that a user meets."""

NAMED_IN_FMI3 = (
    "any_guid part_of_step rate offset_derivative directional state_half undeclared_input start_ignored tunable_refused log_category "
    "constant_indicator event_past get_backwards handler"
)
"""Some that the same checks find in an FMU of FMI 3.0."""

UNKNOWABLE = {"parameter_ignored"}
"""Mutants that are sound FMUs of another model: a parameter may have no influence."""

Found = Callable[..., list[Finding]]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The compiled library."""
    return compile_spring(tmp_path_factory.mktemp("spring"))


@pytest.fixture
def found(library: bytes, tmp_path: Path) -> Found:
    """Function that validates an archive, or a mutant; a file that is no FMU is a finding too."""

    def validate(what: Mutant | bytes, time_limit: float = 60.0, run: bool = True) -> list[Finding]:
        path = tmp_path / "spring.fmu"
        path.write_bytes(what if isinstance(what, bytes) else what.make(spring_files(library)))
        try:
            return validate_fmu(path, time_limit, run if isinstance(what, bytes) else what.runs)
        except ArchiveError as error:
            return [Finding(str(error), check="archive")]

    return validate


def mutant(name: str) -> Mutant:
    """A mutant by its name."""
    return next(each for each in MUTANTS if each.name == name)


@pytest.mark.parametrize(
    "variant",
    [
        "sound",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("runs asynchronously", "large output", "time events")
        ),
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("ends the simulation", "once a process")),
    ],
)
def test_sound_fmu_has_no_findings(found: Found, library: bytes, variant: str) -> None:
    """Whatever is found in mutants is due to what was spoilt; fmi2Terminated, fmi2Pending and one instance a process are no faults."""
    assert found(sound_variants(library)[variant], time_limit=200.0) == []


def test_mutants_that_need_not_run_are_found(found: Found) -> None:
    """Archive and description: all of them, without running anything."""
    still = [each for each in MUTANTS if not each.runs]
    assert len(still) >= 60
    assert [each.name for each in still if not found(each)] == []


@pytest.mark.parametrize("name", NAMED.split())
def test_spoilt_behaviour_is_found(found: Found, name: str) -> None:
    """What costs users most, each by the check for it; none of these ends the process that runs it."""
    findings = found(mutant(name))
    assert any(each.severity is not Severity.NOTE for each in findings)
    assert not any("ended with signal" in each.message for each in findings)


@pytest.mark.slow
def test_behaviour_is_checked_in_fmi3_too(found: Found, tmp_path: Path) -> None:
    """The same FMU by the functions of FMI 3.0: nothing where it is sound, time events and an early end included; mutants are found, in
    the words of that version."""
    library = compile_spring(tmp_path, source="spring3.c")
    assert [found(spring3(library, name)) for name in ("sound", "ends_early", "offset", "ticks")] == [[]] * 4
    for name in NAMED_IN_FMI3.split():
        lines = [str(each) for each in found(spring3(library, name))]
        assert lines, name
        assert not any("fmi2" in line or "[FMI 3.0]" not in line for line in lines)


def test_a_large_fmu_is_checked_in_little_memory(found: Found, library: bytes) -> None:
    """Tables and the like are unpacked and their checksums verified, but not kept."""
    files = spring_files(library) | {"resources/table.bin": os.urandom(1 << 20) * 40}
    archive = zipped(files)
    tracemalloc.start()
    try:
        assert found(archive, run=False) == []
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_a_machine_without_descriptors_is_no_fault_of_the_fmu(library: bytes, tmp_path: Path) -> None:
    """The check that couldn't be made is a note."""
    (tmp_path / "spring.fmu").write_bytes(sound_variants(library)["sound"])
    ran = subprocess.run(
        [sys.executable, "-m", "flexfmu", "validate", "spring.fmu"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (13, 13)),
    )
    assert ran.returncode == 0, ran.stdout
    assert ran.stdout.startswith("note: ")
    assert "this machine has too little left" in ran.stdout


PARTS = 12
"""The mutants that run are so many groups, which several processes share; every fourth group is tried here, all by
`benchmarks/validators.py`."""


@pytest.mark.slow
@pytest.mark.parametrize("part", range(0, PARTS, 4))
def test_mutants_that_run_are_found(found: Found, part: int) -> None:
    """All but those that no run can tell from a sound FMU."""
    running = [each for each in MUTANTS if each.runs and each.name not in {*NAMED.split(), "hang", "pending_forever"}][
        part::PARTS
    ]
    findings = {each.name: found(each) for each in running}
    assert {name for name, listed in findings.items() if not listed} == UNKNOWABLE & set(findings)
    assert [str(each) for listed in findings.values() for each in listed if not each.remedy] == []


@pytest.mark.parametrize(
    ("name", "words"),
    {
        "guid empty": "guid: the attribute guid is empty",
        "guid of another build": "instantiation: fmi2Instantiate returns no instance",
        "start beyond max": "starts at 2.0, outside -1.0 to 1.0",
        "unknown element": "model description: ",
        "no binary": f"binary: {LIBRARY} is missing",
        "binary of another name": "binaries/linux64/other.so is not named after the modelIdentifier spring; name it spring.so",
        "binary is text": "not a 64-bit ELF file",
        "binary for another processor": "another processor",
        "function missing": "does not export fmi2CancelStep",
        "nan_late": "simulation: ",
        "cut off": "build it again",
        "no archive": "is no FMU: not a zip file",
        "description in a folder": "modelDescription.xml is missing",
        "value reference of two parameters": "value reference: stiffness and damping share the value reference 6",
        "unit's exponent": "units: N/m is defined with m=1",
        "dependency out of range": "model description: Outputs refers to variable 20 of 14",
        "folder in capitals": "archive: Resources/data.txt is where no tool looks; call it resources",
        "another version": "fmiVersion is 2.1: FMUs of versions 2.0 and 3.0 are checked",
    }.items(),
)
def test_findings_say_what_and_where(found: Found, name: str, words: str) -> None:
    """Check, name, value and remedy in one line, with the section of the standard where the description is at fault."""
    findings = [str(each) for each in found(mutant(name))]
    lines = [line for line in findings if words in line]
    assert lines
    assert not any("list index" in line for line in findings)  # fmpy's words for an index out of range
    assert all("\n" not in line for line in lines)
    assert "[FMI 2.0.4, 2." in lines[0] or not words.startswith(("value reference:", "units:", "archive:"))


def test_findings_of_one_kind_are_one_line(found: Found, library: bytes) -> None:
    """Sixty missing sources are one finding that names some; what breaks more comes first."""
    sources = "".join(f'<File name="part{n}.c"/>' for n in range(60))
    content = spring_files(library)
    content[DESCRIPTION] = content[DESCRIPTION].replace(b'<File name="spring.c"/>', sources.encode(), 1)
    content["data.txt"] = b""
    content[DESCRIPTION] = content[DESCRIPTION].replace(b'stepSize="0.02"', b'stepSize="0"')
    listed = found(zipped(content), run=False)
    assert [each.check for each in listed] == ["experiment", "sources", "archive"]
    assert len(listed[1].others) == 59
    assert "sources/part0.c is listed but missing (and 59 more: sources/part1.c, " in str(listed[1])


@pytest.mark.slow
def test_one_cause_is_one_line(found: Found) -> None:
    """A crash in every run is one finding that names the checks that it ended."""
    crashes = [each for each in found(mutant("crash")) if "ended with signal 6" in each.message]
    assert {"reset", "state", "instances"} <= set(crashes[0].others)
    assert crashes[0].check == "simulation"
    assert len(crashes) <= 3


@pytest.mark.slow
def test_a_crash_that_wanders_is_not_blamed(found: Found, library: bytes) -> None:
    """Where a new process doesn't repeat it, it is a note that names the call; nothing is left out."""
    findings = found(zipped(spring_files(library) | {"resources/mutant.txt": b"crash_wanders"}))
    assert {each.severity for each in findings} == {Severity.NOTE}
    assert "ended with signal 6 in fmi2DoStep" in findings[0].message
    assert not any("not checked" in each.message for each in findings)


@pytest.mark.slow
def test_an_fmu_that_counts_its_instances_is_checked_to_the_end(found: Found, library: bytes) -> None:
    """Dymola 2020's refuse the 51st instance of a process with a word about a licence: a warning, and nothing is left out."""
    findings = found(zipped(spring_files(library) | {"resources/mutant.txt": b"counts"}))
    assert [(each.check, each.severity) for each in findings] == [("instances", Severity.WARNING)]
    assert findings[0].message == (
        "fmi2Instantiate returns no instance in a process that has made and freed 50 (the licence was not found)"
    )


@pytest.mark.slow
def test_endless_call_is_told_within_the_time_limit(found: Found) -> None:
    """A call that never returns is named, the rest isn't waited for, and the message says how long was waited; so is a step that stays
    pending."""
    lines = [str(each) for each in found(mutant("hang"), time_limit=5.0)]
    assert any("fmi2DoStep did not return within 1 s" in line for line in lines)
    assert any(line.startswith("note: ") and "not checked" in line for line in lines)
    lines = [str(each) for each in found(mutant("pending_forever"), time_limit=10.0)]
    assert any("fmi2DoStep is pending for 5 s" in line for line in lines)


def processes(group_of: str) -> list[str]:
    """Command lines of the running processes that name something."""
    lines = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            lines.append(path.read_bytes().replace(b"\0", b" ").decode(errors="replace"))
        except OSError:
            continue  # it has just ended
    return [line for line in lines if group_of in line and "validation.worker" in line]


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_killed_validation_leaves_no_process_behind(library: bytes, tmp_path: Path, how: signal.Signals) -> None:
    """However the validation ends, the process that hangs in the FMU ends with it."""
    path = tmp_path / "spring.fmu"
    path.write_bytes(mutant("hang").make(spring_files(library)))
    home = tmp_path / "temporary"
    home.mkdir()
    program = f"from pathlib import Path; from flexfmu.fmu_build.validation.validate import validate_fmu; validate_fmu(Path({str(path)!r}))"
    with subprocess.Popen(
        [sys.executable, "-c", program], env=os.environ | {"TMPDIR": str(home)}, stderr=subprocess.DEVNULL
    ) as parent:
        wait_for(lambda: bool(processes(str(home))))
        time.sleep(0.5)
        parent.send_signal(how)
        parent.wait(600.0)
    wait_for(lambda: not processes(str(home)))


def wait_for(condition: Callable[[], bool], longest: float = 600.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + longest
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)


def test_exit_status_tells_severity(library: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """1 for errors, 0 for warnings unless --strict; --json has the same with section, remedy and the time limit."""
    runner, path = CliRunner(), Path("spring.fmu")
    monkeypatch.chdir(tmp_path)

    def status(name: str, *options: str) -> int:
        path.write_bytes(mutant(name).make(spring_files(library)))
        return runner.invoke(app, ["validate", str(path), "--static", *options]).exit_code

    assert status("picture is text") == 0
    assert status("picture is text", "--strict") == 1
    assert status("step of 0") == 1
    data = json.loads(runner.invoke(app, ["validate", str(path), "--static", "--json"]).stdout)
    assert data["time_limit"] == 120.0
    assert [finding["section"] for finding in data["findings"]] == ["2.2.5"]
    assert data["findings"][0]["remedy"].startswith("correct DefaultExperiment")


@pytest.mark.parametrize("name", ["cut off", "damaged", "description in a folder", "no archive"])
def test_files_that_are_no_fmu_give_json_too(library: bytes, tmp_path: Path, name: str) -> None:
    """Who reads JSON reads what is wrong with the worst files; the exit status stays 2, the line on standard error too."""
    path = tmp_path / "spring.fmu"
    path.write_bytes(mutant(name).make(spring_files(library)))
    outcome = CliRunner().invoke(app, ["validate", str(path), "--json"])
    (finding,) = json.loads(outcome.stdout)["findings"]
    assert (finding["check"], finding["severity"]) == ("archive", "error")
    assert str(path) in finding["message"]
    assert outcome.exit_code == 2
    assert str(path) in " ".join(outcome.stderr.split())


def test_description_in_other_case_is_told(library: bytes, tmp_path: Path) -> None:
    """A name that Windows takes for the same one is named; a wrong path says how to get an FMU."""
    content = spring_files(library)
    content["modeldescription.xml"] = content.pop(DESCRIPTION)
    (tmp_path / "spring.fmu").write_bytes(zipped(content))
    with pytest.raises(ArchiveError, match=r"it is called modeldescription\.xml, rename it"):
        validate_fmu(tmp_path / "spring.fmu")
    with pytest.raises(ArchiveError, match="flexfmu build"):
        validate_fmu(tmp_path / "none.fmu")


def test_disturbances_are_named_as_c_does() -> None:
    """A rounding mode by its name, a mask of files in octal digits."""
    before = {"rounding of numbers": 0, "mask of new files": 0o022}
    lines = "\n".join(map(str, disturbances(before, {"rounding of numbers": 0xC00, "mask of new files": 0o777})))
    assert "rounding of numbers to towards zero" in lines or platform.machine() not in ("x86_64", "AMD64")
    assert "mask of new files to 0o777" in lines


def test_unusual_dependencies_are_found(found: Found, tmp_path: Path) -> None:
    """A library that needs others, looks for them where it was built, or shows its insides, loads there alone."""
    library = compile_spring(tmp_path, "-DVISIBLE", "-Wl,--no-as-needed", "-lstdc++", "-Wl,-rpath,/opt/mine")
    text = "\n".join(map(str, found(pack(spring_files(library)), run=False)))
    assert f"dependencies: {LIBRARY} needs libstdc++.so.6" in text
    assert "looks for libraries in /opt/mine" in text
    assert "exports helper_of_mine besides the FMI functions" in text


@pytest.mark.slow
@pytest.mark.parametrize(("drive", "step"), [("motion", 2e-4), ("motion", 5e-3), ("torque", 1e-3)])
def test_robots_have_no_findings(tmp_path: Path, drive: str, step: float) -> None:
    """Neither of fmpy nor of ours; differences over a step that skips vibrations say nothing about derivatives."""
    scene = load_scene("barnard2012-6kg")
    cosimulation = scene.cosimulation.model_copy(update={"drive": drive, "step": step})
    path = tmp_path / "plant.fmu"
    build_scene(scene.model_copy(update={"cosimulation": cosimulation}), output=path)
    assert validate_by_fmpy(str(path)) == validate_fmu(path) == []


def test_mutants_are_mutants(library: bytes, tmp_path: Path) -> None:
    """Each name stands for one mutant, and fmpy finds nothing in the sound FMU."""
    names = [each.name for each in MUTANTS]
    assert len({*names} | UNKNOWABLE) == len(names) >= 190
    (tmp_path / "spring.fmu").write_bytes(zipped(spring_files(library)))
    assert validate_by_fmpy(str(tmp_path / "spring.fmu")) == []


def test_a_change_that_is_refused_is_taken_back() -> None:
    """A model has no value outside of its domain, where a probe may lead; what is checked behind starts from the value before."""

    class Root:
        value = np.array([1e-3])

        def get(self, variables: list[str]) -> np.ndarray[Any, Any]:
            if variables == ["root"] and self.value < 0.0:
                raise ValueError("no number")
            return self.value.copy()

        def set(self, variables: list[str], value: np.ndarray[Any, Any]) -> None:
            self.value = value

    instance, known = Root(), SimpleNamespace(start="1.0", nominal="1.0", declaredType=None, type="Real")
    instance.get([known])
    with pytest.raises(ValueError, match="no number"):
        answers(instance, ["root"], known, 0.01)
    assert instance.value == 1e-3
