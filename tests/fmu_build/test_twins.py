"""Code in which the operations of two equal parts go side by side: the same bits as one operation after the other."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest

from flexfmu.fmu_build.codegen import _prepare, _sizes, c_code, twin_arguments, with_all_arguments
from flexfmu.fmu_build.sources import runtime_sources
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, CompileJob, find_compiler, native_platform
from flexfmu.fmu_build.twins import Graph, find_twins, function_code
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import SymbolicModel

REAL = "typedef double real;\nstatic inline double flex_real(double x) { return x; }\n"
FUNCTIONS = ("residual", "outputs", "motion_rate1", "motion_rate2")


def _model(changes: dict[str, Any]) -> SymbolicModel:
    return build_model(load_scene("barnard2012-6kg").replace(changes))


def _function(model: SymbolicModel, name: str) -> casadi.Function:
    return _prepare(name, model.functions[name], _sizes(model))


def _library(code: str, flags: tuple[str, ...], folder: Path) -> ctypes.CDLL:
    folder.mkdir()
    files = runtime_sources("elementary") | {"function.c": code, "model_functions.h": REAL}
    for name, text in files.items():
        (folder / name).write_text(text)
    jobs = [CompileJob(n, (*GENERATED_FLAGS, "-fvisibility=default", *flags)) for n in files if n.endswith(".c")]
    compiler = find_compiler(native_platform())
    compiler.compile(jobs, folder)
    compiler.link([job.object_file for job in jobs], "function.so", folder)
    return ctypes.CDLL(str(folder / "function.so"))


def _results(library: ctypes.CDLL, function: casadi.Function, points: int) -> np.ndarray:
    """The function's results at random points."""
    random, results = np.random.default_rng(3), []
    for _ in range(points):
        arguments = [random.uniform(0.1, 1.2, function.numel_in(i)) for i in range(function.n_in())]
        pointers = (ctypes.c_void_p * max(function.sz_arg(), 1))(*(each.ctypes.data for each in arguments))
        result = np.full(function.numel_out(0), np.nan)
        target = (ctypes.c_void_p * max(function.sz_res(), 1))(result.ctypes.data)
        integers, work = (ctypes.c_int * (function.sz_iw() + 1))(), (ctypes.c_double * (function.sz_w() + 1))()
        assert getattr(library, function.name())(pointers, target, integers, work, 0) == 0
        results.append(result)
    return np.array(results)


@pytest.mark.slow
@pytest.mark.parametrize("name", FUNCTIONS)
def test_twins_give_the_bits_of_casadi(name: str, tmp_path: Path) -> None:
    """Side by side or not, with vector types or without: a compiler must not decide about an FMU's numbers."""
    model = _model({})
    function = _function(model, name)
    code = function_code(function, twin_arguments(model, name))
    assert code is not None
    one_by_one = _results(_library(with_all_arguments(c_code(function)), (), tmp_path / "casadi"), function, 20)
    for flags in ((), ("-DFLEX_PLAIN",)):
        side_by_side = _results(_library(code, flags, tmp_path / f"twins{len(flags)}"), function, 20)
        assert np.isfinite(side_by_side).any()
        np.testing.assert_array_equal(side_by_side, one_by_one)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"mechanism.working_mode": "left"},
        {"cosimulation.drive": "torque", "effects.motor_inertia": 0.05},
        {"effects.foreshortening": True, "effects.distal_bending": 1},
    ],
    ids=["left", "torque", "foreshortening"],
)
def test_most_operations_of_the_legs_are_twins(changes: dict[str, Any]) -> None:
    """Both legs go through the same formulas; what closes the mechanism and the frame's signs don't hide that."""
    model = _model(changes)
    for name in FUNCTIONS:
        graph = Graph.of(_function(model, name))
        twins = find_twins(graph, twin_arguments(model, name))
        operations = [node for node in range(len(graph.nodes)) if not graph.is_leaf(node)]
        assert sum(node in twins for node in operations) > 0.7 * len(operations), name


def test_no_twin_needs_the_other() -> None:
    """Twins are computed at once, so an operand must not wait for them."""
    model = _model({})
    graph = Graph.of(_function(model, "residual"))
    twins = find_twins(graph, twin_arguments(model, "residual"))
    needed: list[set[int]] = []
    for node in range(len(graph.nodes)):
        # everything that a node needs, the twins of its operands included
        parts = {part for i in graph.operands(node) for part in twins.get(i, (i,))}
        needed.append(parts.union(*(needed[part] for part in parts if part < node)))
    assert all(first not in needed[second] and second not in needed[first] for first, second in twins.values())
