"""Odd arguments: each gets its status and a sentence, and the instance can be used afterwards."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from ctypes import byref, c_char, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path

import pytest
from boundary_support.raw import (
    DISCARD,
    DO_STEP_STATUS,
    ERROR,
    LAST_SUCCESSFUL_TIME,
    OK,
    PENDING_STATUS,
    TERMINATED,
    WARNING,
    RawInstance,
    raw_instance,
)
from boundary_support.subjects import FILES, fail_a_step
from export_support.blocks import saturation

from flexfmu.fmu_build.build import build_fmu
from flexfmu.model.scene.cosimulation import LEAST_TOLERANCE


@pytest.fixture(params=FILES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def instance(name: str, tmp_path: Path) -> Iterator[RawInstance]:
    with raw_instance(FILES[name](), tmp_path / "fmu") as each:
        yield each


def test_null_pointers_are_refused(instance: RawInstance) -> None:
    """Importers in languages without arrays have passed none; a crash would take the whole tool with it."""
    instance.start()
    state, one = instance.save(), (c_uint * 1)(0)
    real, integer, order = (c_double * 1)(), (c_int * 1)(), (c_int * 1)(1)
    arrays = {
        **{f"fmi2{verb}Real": (one, 1, real) for verb in ("Get", "Set")},
        **{f"fmi2{verb}Integer": (one, 1, integer) for verb in ("Get", "Set")},
        "fmi2SetRealInputDerivatives": (one, 1, order, real),
        "fmi2GetRealOutputDerivatives": (one, 1, order, real),
    }
    refused = [
        *((name, None, *others) for name, (_, *others) in arrays.items()),
        *((name, *others, None) for name, (*others, _) in arrays.items()),
        ("fmi2SetRealInputDerivatives", one, 1, None, real),
        ("fmi2SetDebugLogging", 1, 1, None),
        ("fmi2SetDebugLogging", 1, 1, (c_char_p * 1)(None)),
        ("fmi2GetFMUstate", None),
        ("fmi2SetFMUstate", None),
        ("fmi2SerializedFMUstateSize", None, byref(c_size_t())),
        ("fmi2SerializedFMUstateSize", state, None),
        ("fmi2SerializeFMUstate", state, None, 1 << 20),
        ("fmi2DeSerializeFMUstate", None, 100, byref(c_void_p())),
        ("fmi2GetStatus", DO_STEP_STATUS, None),
        ("fmi2GetRealStatus", LAST_SUCCESSFUL_TIME, None),
        ("fmi2GetBooleanStatus", TERMINATED, None),
        ("fmi2GetStringStatus", PENDING_STATUS, None),
        ("fmi2GetDirectionalDerivative", None, 1, None, 1, None, None),
    ]
    assert [call[0] for call in refused if instance.call(*call) != ERROR] == []
    assert instance.call("fmi2FreeFMUstate", None) == OK
    assert instance.free(state) == OK
    assert instance.step(0.0, 1e-3) == OK


@pytest.mark.parametrize("name", ["robot", "block"])
def test_numbers_that_are_none_are_refused(name: str, instance: RawInstance) -> None:
    """NaN would spread through every FMU that is connected."""
    before = instance.get([instance.references[each] for each in instance.settable])
    for value in (math.nan, math.inf, -math.inf):
        for each in instance.settable:
            assert instance.set([instance.references[each]], [value]) == ERROR
            assert f"{each} must be a finite number" in instance.sentence
        assert instance.set_derivative(instance.references[instance.inputs[0]], 1, value) == ERROR
    assert instance.get([instance.references[each] for each in instance.settable]) == before


def test_impossible_steps_are_refused(instance: RawInstance) -> None:
    """The importer's clock and the FMU's must not drift apart unnoticed, and a step to infinity would never return; the next good step
    is served."""
    instance.start(stop=0.25)
    before = instance.get_outputs()
    for time, size, reason in (
        *((0.0, size, "positive and finite") for size in (0.0, -1e-3, math.nan, math.inf)),
        (math.nan, 1e-3, "finite"),
        (1e-3, 1e-3, "present time 0 s"),
        (-1e-3, 1e-3, "present time 0 s"),
        (0.0, 0.5, "stop time"),
        (0.0, 1.7e308, "stop time"),
    ):
        assert instance.step(time, size) == ERROR
        assert reason in instance.sentence
        assert instance.get_outputs() == before
        assert instance.last_time() == 0.0
    assert instance.step(0.0, 0.25) == OK
    assert instance.call("fmi2Reset") == OK
    instance.start(1.7e308)
    assert instance.step(1.7e308, 1.7e308) == ERROR
    assert "has no finite end" in instance.sentence


def test_wrong_experiments_are_refused(name: str, instance: RawInstance) -> None:
    """Tolerance 0 or a stop before the start are slips of the importer, which it should hear of. The smallest tolerance of a scene is
    the FMU's own: a smaller one counts as that one, with a warning."""
    for arguments in ((1, 0.0, 0.0, 0, 0.0), (1, math.nan, 0.0, 0, 0.0), (1, 2.0, 0.0, 0, 0.0)):
        assert instance.call("fmi2SetupExperiment", *arguments) == ERROR
        assert "tolerance must be between 0 and 1" in instance.sentence
    for start, stop in ((math.nan, 1.0), (math.inf, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, math.nan)):
        assert instance.call("fmi2SetupExperiment", 0, 0.0, start, 1, stop) == ERROR
        assert "time must be" in instance.sentence
    if name == "robot":
        assert instance.call("fmi2SetupExperiment", 1, LEAST_TOLERANCE, 0.0, 0, 0.0) == OK
        assert instance.call("fmi2SetupExperiment", 1, 0.99 * LEAST_TOLERANCE, 0.0, 0, 0.0) == WARNING
        assert f"9.9e-13 is beyond double precision, {LEAST_TOLERANCE:g} is used" in instance.sentence
    instance.start()


def test_unknown_value_references_are_refused(instance: RawInstance) -> None:
    """A value reference of another FMU must not read what lies behind the last variable."""
    instance.start()
    for reference in (len(instance.references), 2**31 - 1, 2**31, 2**32 - 1):
        assert instance.get([reference])[0] == ERROR
        assert "unknown" in instance.sentence
        assert instance.set([reference], [1.0]) == ERROR
        for kind in ("Integer", "Boolean"):
            for verb in ("Get", "Set"):
                assert instance.call(f"fmi2{verb}{kind}", (c_uint * 1)(reference), 1, (c_int * 1)(1)) == ERROR
    assert instance.set([instance.references[instance.outputs[0]]], [0.0]) == ERROR
    assert "is an output" in instance.sentence


def test_spoilt_states_are_refused(name: str, instance: RawInstance, tmp_path: Path) -> None:
    """A state from a file may be cut, changed, or of another FMU; taken for good, it would run on with nonsense."""
    instance.start()
    state = instance.save()
    content = instance.serialized(state)
    for position in range(0, len(content), max(1, len(content) // 97)):
        spoilt = bytearray(content)
        spoilt[position] ^= 0x10
        assert instance.deserialized(bytes(spoilt))[0] == ERROR
    for cut in (b"", content[:1], content[:-1], content + b"\0"):
        assert instance.deserialized(cut)[0] == ERROR
    other_name = next(each for each in FILES if each != name)
    with raw_instance(FILES[other_name](), tmp_path / "other") as other:
        other.start()
        foreign = other.serialized(other.save())
    assert instance.deserialized(foreign)[0] == ERROR
    assert "does not belong to this FMU" in instance.sentence

    # too little room; freed, and freed again
    assert instance.call("fmi2SerializeFMUstate", state, (c_char * 1)(), len(content) - 1) == ERROR
    assert instance.free(c_void_p(state.value)) == OK
    assert instance.free(state) == ERROR
    assert "has been freed" in instance.sentence
    assert instance.call("fmi2SetFMUstate", state) == ERROR


@pytest.mark.parametrize("name", ["robot", "block"])
def test_a_discarded_step_says_why_and_can_be_undone(name: str, instance: RawInstance) -> None:
    """A master halves its step or stops; for both it must know how far the FMU got, and why no further."""
    instance.start()
    state, before = instance.save(), instance.get_outputs()
    fail_a_step(instance, name)
    sentence = next(each.text for each in reversed(instance.heard) if each.status == DISCARD)
    status, reason = c_int(), c_char_p()
    assert instance.call("fmi2GetStatus", DO_STEP_STATUS, byref(status)) == OK
    assert instance.call("fmi2GetStringStatus", PENDING_STATUS, byref(reason)) == OK
    assert status.value == DISCARD
    assert reason.value is not None
    assert reason.value.decode() == sentence
    assert 0.0 <= instance.last_time() < 2.0

    # back to where it was, as if nothing had happened
    assert instance.call("fmi2SetFMUstate", state) == OK
    assert instance.get_outputs() == before
    assert instance.step(0.0, 1e-3) == OK
    after = instance.get_outputs()
    assert instance.call("fmi2Reset") == OK
    instance.start()
    assert instance.step(0.0, 1e-3) == OK
    assert instance.get_outputs() == after
    assert instance.free(state) == OK


def test_inputs_beyond_all_numbers_are_refused(tmp_path: Path) -> None:
    """An extrapolated input that overflows is an infinity that nobody has set; here a limit would hide it."""
    with raw_instance(build_fmu(saturation()).path, tmp_path / "fmu") as instance:
        instance.start()
        assert instance.set_derivative(0, 1, 1.7e308) == OK
        assert instance.step(0.0, 10.0) == DISCARD
        assert "its derivatives have carried it there" in instance.sentence
        assert 1.0 < instance.last_time() < 1.1
        assert instance.get([0])[0] == ERROR


@pytest.mark.parametrize("name", ["block"])
def test_steps_without_end_are_discarded(instance: RawInstance) -> None:
    """Nobody can stop a step that has begun."""
    instance.start()
    for size in (1e9, 1e300):
        assert instance.step(0.0, size) == DISCARD
        assert "samples" in instance.sentence
        assert instance.last_time() == 0.0
    assert instance.step(0.0, 1e-3) == OK


REPLAY = """
import sys
from pathlib import Path
sys.path[:0] = {paths!r}
from boundary_support.raw import OK, raw_instance
path, folder, state = (Path(each) for each in sys.argv[1:])
with raw_instance(path, folder) as instance:
    status, saved = instance.deserialized(state.read_bytes())
    assert status == OK and instance.call("fmi2SetFMUstate", saved) == OK
    for k in range(5, 12):
        if instance.inputs:
            assert instance.set_derivative(0, 1, 0.01 * k) == OK
        assert instance.step(1e-3 * k, 1e-3) == OK
        print(*(value.hex() for value in instance.get_outputs()))
"""


def test_states_go_on_in_another_process(name: str, instance: RawInstance, tmp_path: Path) -> None:
    """A long run that was interrupted goes on to the same bits, whatever the integrator had remembered."""
    instance.start()
    here = []
    for k in range(12):
        if k == 5:
            (tmp_path / "state").write_bytes(instance.serialized(instance.save()))
        if instance.inputs:
            assert instance.set_derivative(0, 1, 0.01 * k) == OK
        assert instance.step(1e-3 * k, 1e-3) == OK
        here.append(" ".join(value.hex() for value in instance.get_outputs()))
    code = REPLAY.format(paths=sys.path)
    arguments = [FILES[name](), tmp_path / "fmu", tmp_path / "state"]
    there = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False)
    assert there.stdout.splitlines() == here[5:], there.stderr
