"""Controllers written in C: the numbers of the built-in ones, their place in the loop in C, and what is said about wrong ones."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from blocks import c_function, sampled
from fmpy import simulate_fmu

import flexfmu
from flexfmu.cosim.control.blocks.slave import BlockSlave
from flexfmu.cosim.control.controllers.c_function import SIGNATURE
from flexfmu.cosim.design.margins.loop_warnings import stability_warning
from flexfmu.cosim.engine.binding import Evaluation
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.master.simulator import isolation
from flexfmu.cosim.exchange.slave_export import export_slaves
from flexfmu.cosim.exchange.ssp.export import export_ssp
from flexfmu.cosim.exchange.ssp.loading import load_ssp
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.fmu_build.build import build_fmu
from flexfmu.fmu_build.errors import ModelError
from flexfmu.model.scene.errors import SceneError
from flexfmu.model.scene.schema import Scene
from flexfmu.model.symbolic import SymbolicBlock

INPUTS = [
    f"joint{j}.{kind}" for kind in ("reference.position", "reference.velocity", "position", "velocity") for j in (1, 2)
]
OUTPUTS = ["joint1.torque", "joint2.torque"]
PD = """
  for (int j = 0; j < 2; ++j) y[j] = p[0] * (u[j] - u[4 + j]) + p[1] * (u[2 + j] - u[6 + j]);
"""
H = 1e-3
Write = Callable[..., Path]


@pytest.fixture(scope="module")
def write(tmp_path_factory: pytest.TempPathFactory) -> Write:
    """Writes a C file with a function of the signature: write(name, body, front)."""
    folder = tmp_path_factory.mktemp("c")

    def written(name: str, body: str, front: str = "") -> Path:
        path = folder / f"{name}.c"
        path.write_text(f"{front}\n{SIGNATURE.format(name)} {{{body}}}\n", encoding="utf-8")
        return path

    return written


def section(path: Path, **changes: Any) -> dict[str, Any]:
    """The table of PD control in C."""
    return {
        "kind": "c-function",
        "source": str(path),
        "inputs": INPUTS,
        "outputs": OUTPUTS,
        "parameters": {"kp": 5e3, "kd": 50.0},
        "sample_time": H,
        **changes,
    }


def pd_block(path: Any, **changes: Any) -> SymbolicBlock:
    """The block of PD control in C."""
    keys = {key: value for key, value in section(path, **changes).items() if key not in ("kind", "source")}
    block: SymbolicBlock = c_function(changes.get("source", str(path)), **keys)
    return block


def single(source: Any, **keys: Any) -> SymbolicBlock:
    """The block of a function of one input and one output."""
    block: SymbolicBlock = c_function(source, inputs=["in"], outputs=["out"], sample_time=H, **keys)
    return block


@pytest.mark.slow
def test_it_is_the_built_in_pd(write: Write, robot: Scene, tmp_path: Path) -> None:
    """The same numbers as `pd` in the loop, as an exported FMU and as an SSP file, with the names of the scene."""
    path, built_in = write("own_pd", PD), {"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": H}
    expected = run_scene(robot.replace({"controller": [built_in]})).recording
    scene = robot.replace({"controller": [section(path)]})
    fmu = export_slaves(scene, tmp_path, names=["c_function"]).slaves[0].path
    runs = [run_scene(scene), run_scene(robot.replace({"controller": [{"kind": "fmu", "path": str(fmu)}]}))]
    for run in runs:
        assert run.completed, run.message
        for name in ("joint1.position", "joint2.torque", "end_effector.position.x"):
            values = expected[name].values
            np.testing.assert_allclose(run.recording[name].values, values, rtol=0.0, atol=1e-12 * abs(values).max())
    packed = load_ssp(export_ssp(scene, tmp_path / "c.ssp")).simulate().recording
    np.testing.assert_allclose(
        packed["joint1.position"].values, expected["joint1.position"].values, rtol=0.0, atol=1e-11
    )
    own = {name for name in runs[0].recording.columns if not name.startswith("end_effector.reference")}
    assert set(packed.columns) == own


def test_states_parameters_and_time(write: Write) -> None:
    """y_k = a x_k + sin(t_k), x_k+1 = x_k + u_k, the time counted from the first instant's offset; both to the last bit but the
    sine's."""
    path = write("sums", "y[0] = p[0] * x[0] + sin(t); next_x[0] = x[0] + u[0];", "#include <math.h>")
    u = np.random.default_rng(3).normal(size=30)
    y = sampled(single(path, parameters={"a": 3.0}, states=[0.25], offset=0.1), u)[:, 0]
    x = 0.25 + np.concatenate([[0.0], np.cumsum(u[:-1])])
    np.testing.assert_allclose(y, 3.0 * x + np.sin(0.1 + H * np.arange(30)), rtol=1e-14, atol=1e-15)


def test_loop_in_c_calls_it(write: Write) -> None:
    """No Python in a sample; compiled C has the numbers of CasADi's virtual machine; and the run is isolated, since C may crash."""
    block, found = pd_block(write("own_pd", PD)), []
    for compiled in (False, True):
        slave, values = BlockSlave(block, compiled=compiled), np.empty(2)
        slave.set(np.arange(8), np.linspace(-1.0, 1.0, 8))
        slave.initialize(0.0, 1.0, None)
        slave.get(np.array([10, 11]), values)
        found.append(values)
    assert found[0].tolist() == found[1].tolist() != [0.0, 0.0]
    assert any(isinstance(call, Evaluation) for call in slave.sample_calls("sample") or ())
    assert isolation(None, [slave], 1.0, caller_owned=True) is not None


def test_several_files(write: Write, tmp_path: Path) -> None:
    """Headers and further C files belong to the function."""
    (tmp_path / "half.h").write_text("double half(double x);\n")
    (tmp_path / "half.c").write_text('#include "half.h"\ndouble half(double x) { return 0.5 * x; }\n')
    first = write("halved", "y[0] = half(u[0]);", '#include "half.h"')
    files = [first, tmp_path / "half.c", tmp_path / "half.h"]
    assert sampled(single([str(each) for each in files]), [3.0]) == 1.5


@pytest.mark.skipif("sys.platform != 'linux'", reason="shared libraries are taken on Linux")
def test_a_shared_library_is_in_the_fmu(write: Write, tmp_path: Path) -> None:
    """The FMU holds the library, whatever its SONAME, and needs no other file: it runs after that is gone; and two libraries of one
    name are two."""
    found = []
    for gain in (1.0, 2.0):
        library = tmp_path / "libgain.so"
        source = write("gain", f"y[0] = {gain} * u[0];")
        subprocess.run(["cc", "-shared", "-fPIC", "-Wl,-soname,libgain.so.7", "-o", library, source], check=True)
        block = single(library)
        fmu = build_fmu(block, tmp_path / f"gain{gain:g}.fmu").path
        library.unlink()
        result = simulate_fmu(str(fmu), start_values={"in": 3.0}, stop_time=2 * H, output=["out"])
        found += [sampled(block, [3.0]), result["out"][-1]]
    assert found == [3.0, 3.0, 6.0, 6.0]


@pytest.mark.skipif("sys.platform != 'linux'", reason="isolation needs Linux")
def test_a_crash_ends_the_run_alone(write: Write, robot: Scene, tmp_path: Path) -> None:
    """The message names the slave, and what was recorded stays; margins end with an error."""
    path = write("crash", "y[0] = t < 0.05 ? 0.0 : *(volatile double *)0; y[1] = 0.0;")
    run = run_scene(robot.replace({"controller": [section(path, parameters={}, name="wild")]}))
    assert not run.completed
    assert "wild" in run.message
    assert run.recording.time[-1] > 0.04
    # at the first instant, before anything is recorded
    path = write("crash_at_once", "y[0] = *(volatile double *)0; y[1] = 0.0;")
    scene = robot.replace({"controller": [section(path, parameters={}, name="wild")]})
    run = run_scene(scene)
    assert run.write(tmp_path / "results.csv").is_file()
    assert stability_warning(run) is None
    with pytest.raises(InputError, match="wild can't be linearised about standstill: it crashed with SIGSEGV"):
        flexfmu.margins(scene)


@pytest.mark.parametrize(
    ("front", "body", "named"),
    [
        ("", "static double sum; sum += u[0]; y[0] = y[1] = sum;", "static double sum"),
        ("", "static double last[2] = {0.0, 0.0}, other; y[0] = last[0]; y[1] = last[1] = u[0];", "static double last[2]"),
        ("double sum = 0.0;", "sum += u[0]; y[0] = y[1] = sum;", "double sum"),
        ("struct s { double sum; };\nstatic struct s kept;", "y[0] = y[1] = kept.sum += u[0];", "static struct s kept"),
        ("typedef struct { int n; } s;\n\ns kept, more;", "y[0] = y[1] = kept.n++;", "s kept"),
        ("static int *place;", "y[0] = y[1] = place ? 1.0 : 0.0;", "static int *place"),
        (
            "/* static double sum; */ // static int n;\n#define KEPT static double\n"
            "static const double table[2][2] = {{1.0, 2.0}, {3.0, 4.0}};\ntypedef double number;\nenum { A, B };\n"
            "struct pair { double a, b; };\nextern const int outside;\nconst int size = 2;\n"
            "static inline double half(double x) { number y = 0.5 * x; return y; }\nstatic double twice(double x);\n"
            "static double twice(double x) { double y = 2.0 * x; return y; }",
            'struct pair two = {half(1.0), 2.0}; static const char *text = "static int n;"; y[0] = two.a; y[1] = twice(table[1][A]) + text[0];',
            "",
        ),
    ],
)  # fmt: skip
def test_variables_that_outlive_a_call_are_refused(write: Write, front: str, body: str, named: str) -> None:
    """They would make a repeated sample another one; tables, helpers and types are no such variables."""
    path = write("memory", body, front)
    refused = pytest.raises(InputError, match=re.escape(f"`{named}` keeps its value between calls"))
    with refused if named else nullcontext():
        pd_block(path, parameters={})


@pytest.mark.skipif("sys.platform != 'linux'", reason="shared libraries are taken on Linux")
@pytest.mark.parametrize(
    ("front", "body", "repeats"),
    [
        ("", "static double sum; sum += 1e-3 * u[0]; y[0] = u[0] + sum;", False),
        ("", "static double sum; if (t == 0.0) sum = 0.0; sum += u[0]; y[0] = sum;", False),
        ("", "static double last; y[0] = u[0] - last; last = u[0];", False),
        ("", "static int fault; fault |= u[0] > 50.0; y[0] = fault ? 0.0 : u[0];", False),
        ("", "static int samples; y[0] = ++samples > 1000 ? u[0] : 0.0;", False),
        ("#include <stdlib.h>", "static double *sum; if (!sum) sum = calloc(1, 8); y[0] = u[0]; next_x[0] = *sum += u[0];", False),
        ("", "static double table[2]; table[1] = 2.0; y[0] = table[1] * u[0];", True),
        ("", "y[0] = x[0]; next_x[0] = x[0] + 1e-3 * u[0];", True),
        ("", "y[0] = u[0]; next_x[0] = 0.0 / 0.0;", True),
    ],
    ids=["integral", "integral with a start", "difference", "latch", "counter", "heap", "scratch", "state", "nan"],
)  # fmt: skip
def test_a_library_with_memory_is_refused(write: Write, tmp_path: Path, front: str, body: str, repeats: bool) -> None:
    """A static integral acts in no repeated sample and has no pole in the margins; scratch memory, which each call writes, and `states` do."""
    path = tmp_path / "libkept.so"
    source = write("kept", ("" if "next_x" in body else "next_x[0] = 0.0;") + body, front)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", path, source], check=True)
    words = r"libkept\.so: kept keeps values between calls: with equal arguments (out|next_x\[0\]) was"
    with nullcontext() if repeats else pytest.raises(InputError, match=words):
        single(path, states=[0.0])


def test_an_output_that_the_function_does_not_write_is_no_number(write: Write, robot: Scene) -> None:
    """A forgotten torque isn't a torque of zero."""
    run = run_scene(robot.replace({"controller": [section(write("half", "y[0] = 0.0;"), parameters={}, name="half")]}))
    assert "half failed at 0 s: joint2.torque became nan" in run.message


@pytest.mark.parametrize(("changes", "message"), [
    ({"function": "other"},
     r"own_pd\.c: there is no function 'other'; name one of theirs as `function` \(own_pd\), or"),
    ({"function": "no name"}, "is no name of a C function"),
    ({"outputs": []}, "needs `outputs`"),
    ({"inputs": ["a", "a"]}, "two variables are named 'a'"),
    ({"units": {"joint1.torqe": "N.m"}}, "did you mean 'joint1.torque'"),
    ({"source": "missing.c"}, "can't read the C file missing.c"),
    ({"source": 3}, "`source`.*got 3"),
])  # fmt: skip
def test_wrong_input_is_named(write: Write, changes: dict[str, Any], message: str) -> None:
    """Every mistake is said in a sentence with what would do."""
    with pytest.raises((InputError, SceneError), match=message):
        pd_block(write("own_pd", PD), **changes)


HALF = "double half(double x);\ndouble half(double x) { return 0.5 * x; }\n"


@pytest.mark.parametrize(("body", "front", "more", "message"), [
    (None, "void f(double t, double *y) { y[0] = t; }\n", "", r"void f\(double t, const double \*u, const double \*p"),
    ("y[0] = absent(u[0]) + gone();", "double absent(double x);\ndouble gone(void);", "",
     "nothing defines absent, gone; add the C file or library that does to `source`"),
    ("y[0] = half(u[0]);", "double half(double x) { return x; }", HALF, "half"),
], ids=["another signature", "a missing symbol", "one that is defined twice"])  # fmt: skip
def test_what_compiler_and_linker_say(write: Write, body: str | None, front: str, more: str, message: str) -> None:
    """The compiler sees the prototype; the linker's own lines say which symbol is missing or there twice, without noise."""
    path = write("f", body or "", front)
    if body is None:
        path.write_text(front)
    (path.parent / "more.c").write_text(more)
    with pytest.raises(InputError, match=message) as refused:
        single([str(path), str(path.parent / "more.c")], function="f")
    assert "exit status" not in str(refused.value)
    assert body is None or SIGNATURE.format("f") not in str(refused.value)


def test_a_file_of_the_runtime_keeps_its_name(write: Write, tmp_path: Path) -> None:
    """A user's file can't replace one that every FMU has."""
    block = single(write("taken", "y[0] = u[0];"))
    with pytest.raises(ModelError, match=r"'model\.h' has the name of a file of every FMU; rename it"):
        build_fmu(replace(block, c_files={**block.c_files, "model.h": ""}), tmp_path / "x.fmu")
