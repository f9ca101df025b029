"""The generated C: the same numbers as CasADi, the same bytes every time, also where two equal parts go side by side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flexfmu.fmu_build import codegen, twins
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.sources import runtime_sources
from flexfmu.fmu_build.templating import c_double, c_string
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, CompileJob, find_compiler, native_platform
from flexfmu.fmu_build.twins import Graph, find_twins, function_code
from flexfmu.model.plants import build_model
from flexfmu.model.scene.file import load_scene
from flexfmu.model.symbolic import FUNCTION_SIGNATURES, SymbolicModel

MakeModel = Callable[..., SymbolicModel]

ROOM = 10_000
"""More than any function here needs for its arguments, results and work."""
REAL = "typedef double real;\nstatic inline double flex_real(double x) { return x; }\n"
FUNCTIONS = ("residual", "outputs", "motion_rate1", "motion_rate2")


def _library(files: Mapping[str, str], folder: Path, *flags: str) -> ctypes.CDLL:
    """C files with the elementary functions, as a library that exports all of them."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {**runtime_sources("elementary"), **files}
    for name, text in files.items():
        (folder / name).write_text(text)
    jobs = [
        CompileJob(name, (*GENERATED_FLAGS, "-fvisibility=default", *flags)) for name in files if name.endswith(".c")
    ]
    compiler = find_compiler(native_platform())
    compiler.compile(jobs, folder)
    compiler.link([job.object_file for job in jobs], "functions.so", folder)
    return ctypes.CDLL(str(folder / "functions.so"))


def _results(
    library: ctypes.CDLL, symbol: str, function: casadi.Function, points: list[list[np.ndarray]]
) -> np.ndarray:
    """Results of a compiled function at some points."""
    results = np.full((len(points), function.numel_out(0)), np.nan)
    integers, work = (ctypes.c_int * ROOM)(), (ctypes.c_double * ROOM)()
    for arguments, result in zip(points, results, strict=True):
        pointers = (ctypes.c_void_p * ROOM)(*(each.ctypes.data for each in arguments))
        target = (ctypes.c_void_p * ROOM)(result.ctypes.data)
        assert getattr(library, symbol)(pointers, target, integers, work, 0) == 0
    return results


def _points(function: casadi.Function, count: int) -> list[list[np.ndarray]]:
    """Drawn arguments."""
    random = np.random.default_rng(1)
    return [[random.uniform(0.1, 1.2, function.numel_in(i)) for i in range(function.n_in())] for _ in range(count)]


def test_compiled_functions_agree_with_casadi(make_oscillators: MakeModel, tmp_path: Path) -> None:
    """What the FMU calculates is what the model says, argument by argument."""
    model = make_oscillators()
    files, facts = codegen.generate_functions(model)
    library = _library(files | {name: runtime_sources()[name] for name in ("real.h", "memory.h")}, tmp_path)
    for fact in facts:
        if fact.shares_work:
            continue
        function = model.functions[fact.field]
        points = _points(function, 2)
        expected = [np.asarray(function(*arguments)).ravel(order="F") for arguments in points]
        found = _results(library, fact.symbol, function, points)
        np.testing.assert_allclose(found, expected, rtol=1e-14, err_msg=fact.field)


def _rates(
    library: ctypes.CDLL, model: SymbolicModel, points: list[list[np.ndarray]], shared: bool
) -> list[np.ndarray]:
    """First rates, mass matrix, outputs and second rates at some points: from the functions that share operations, of which the first
    one gets no numbers for jerk and second derivatives of inputs, or from four."""
    names, found = (codegen.RATES[0], "mass_matrix", "outputs", codegen.RATES[1]), []
    sizes = [model.functions[name].numel_out(0) for name in names]
    for point in points:
        given = dict(zip(FUNCTION_SIGNATURES[names[3]][0], point, strict=True))
        result, begin, work = np.full(sum(sizes), np.nan), 0, (ctypes.c_double * ROOM)()
        for name, size in zip(names, sizes, strict=True):
            if name in codegen.RATES or not shared:
                arguments = [given[each] for each in FUNCTION_SIGNATURES[name][0]]
                if name == names[0]:
                    arguments += [np.full(given[each].size, np.nan) for each in ("j", "u2")]
                pointers = (ctypes.c_void_p * ROOM)(*(each.ctypes.data for each in arguments))
                target = (ctypes.c_void_p * ROOM)(result[begin:].ctypes.data)
                assert getattr(library, f"model_{name}")(pointers, target, (ctypes.c_int * ROOM)(), work, 0) == 0
            begin += size
        found.append(result)
    return found


def _check_rates(model: SymbolicModel, folder: Path, *flags: str) -> None:
    """What shares operations has the bits of four functions apart."""
    prepared = {name: _function(model, name) for name in ("motion_rate1", "mass_matrix", "outputs", "motion_rate2")}
    apart = {
        codegen.function_file(name): codegen.with_all_arguments(codegen.c_code(each)) for name, each in prepared.items()
    }
    together = {name: text for name, text in codegen.generate_functions(model)[0].items() if name in apart}
    points = _points(prepared["motion_rate2"], 10)
    results = [
        _rates(_library(files | {codegen.HEADER_FILE: REAL}, folder / name, *flags), model, points, name == "together")
        for name, files in (("apart", apart), ("together", together))
    ]
    np.testing.assert_array_equal(results[1], results[0])


def test_rates_share_operations(make_oscillators: MakeModel, make_lever: MakeModel, tmp_path: Path) -> None:
    """First rates bring mass matrix and outputs along and need neither jerk nor second derivatives of inputs; second rates go on from
    what the first ones left."""
    for model in (make_oscillators(), make_lever()):
        _check_rates(model, tmp_path / model.name)


@pytest.mark.slow
@pytest.mark.parametrize(("length", "flags"), [(1500, ()), (10, ()), (1500, ("-DFLEX_PLAIN",))])
def test_rates_of_the_robot_share_operations(
    length: int, flags: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same where two legs go side by side, in a few parts or in many."""
    monkeypatch.setattr(twins, "LONG", length)
    _check_rates(_model({}), tmp_path, *flags)


def test_code_is_deterministic_and_complete(make_oscillators: MakeModel, make_lever: MakeModel) -> None:
    """Two models of equal content give equal bytes: the GUID and the cache rely on it. A rigid model has the same set of files as an
    elastic one, so the runtime needs no special case."""
    first, second = (codegen.generate_functions(make_oscillators()) for _ in range(2))
    assert first == second
    description = [codegen.generate_description(make_oscillators(), first[1], "{x}", 1e-6) for _ in range(2)]
    assert description[0] == description[1]
    files, facts = codegen.generate_functions(make_lever())
    assert [fact.field for fact in facts] == list(FUNCTION_SIGNATURES)
    assert {codegen.function_file(name) for name in FUNCTION_SIGNATURES} < set(files)


def _with_mass(
    model: SymbolicModel, matrix: Callable[[casadi.SX, casadi.SX], casadi.SX], rows: np.ndarray | None = None
) -> SymbolicModel:
    """The oscillators with another mass matrix of (y, d), and with other accelerations in the residual where `rows` scales these."""
    y, v, a = (casadi.SX.sym(symbol, 2) for symbol in "yva")
    u, d = casadi.SX.sym("u", 1), casadi.SX.sym("d", 4)
    mass = matrix(y, d)
    inertia = (mass if rows is None else casadi.diag(rows) @ mass) @ a
    residual = inertia + model.functions["residual"](y, v, casadi.SX.zeros(2), u, d)
    functions = {
        "mass_matrix": casadi.Function("mass_matrix", [y, u, d], [casadi.densify(mass)]),
        "residual": casadi.Function("residual", [y, v, a, u, d], [casadi.densify(residual)]),
    }
    return replace(model, functions={**model.functions, **functions})


@settings(max_examples=25)
@given(st.floats(0.05, 20.0), st.floats(0.02, 0.9), st.sampled_from([-1.0, -1e-5, 1e-5, 1e-3, 9.0]), st.booleans())
def test_mass_matrices_that_are_not_symmetric_are_refused(
    make_oscillators: MakeModel, cart: float, coupling: float, error: float, is_late: bool
) -> None:
    """A cart and its pole in any proportion pass, however their symmetry is written. With a row in other units, or an entry that is off
    by a hundred-thousandth, they are refused by the names of the entry's coordinates; also where it shows at other poses than the start."""

    def matrix(y: casadi.SX, d: casadi.SX, factor: casadi.SX | float = 1.0) -> casadi.SX:
        turned = coupling * casadi.cos(y[1]), coupling * (1.0 - 2.0 * casadi.sin(y[1] / 2.0) ** 2)
        return d[0] * casadi.vertcat(casadi.horzcat(1.0 + cart, turned[0]), casadi.horzcat(factor * turned[1], 1.0))

    def wrong(y: casadi.SX, d: casadi.SX) -> casadi.SX:
        return matrix(y, d, 1.0 + error * (casadi.sin(y[0]) if is_late else 1.0))

    codegen.generate_functions(_with_mass(make_oscillators(), matrix))
    with pytest.raises(ModelError, match=r"entry \(second[.]position, first[.]position\) is .*first[.]position = "):
        codegen.generate_functions(_with_mass(make_oscillators(), wrong))


def test_a_mass_matrix_that_is_not_the_residuals_is_refused(make_oscillators: MakeModel) -> None:
    """Co-simulation solves the residual and model exchange the mass matrix: both would run, with different results."""

    def diagonal(y: casadi.SX, d: casadi.SX) -> casadi.SX:
        return d[0] * casadi.SX.eye(2)

    codegen.generate_functions(_with_mass(make_oscillators(), diagonal, np.ones(2)))
    with pytest.raises(ModelError, match=r"row of second[.]position the residual changes by"):
        codegen.generate_functions(_with_mass(make_oscillators(), diagonal, np.array([1.0, 1.01])))


@pytest.mark.parametrize(
    ("sizes", "result"),
    [
        (None, casadi.SX(0)),
        ((2,), casadi.SX.zeros(2)),
        ((2, 2, 2, 1, 4), casadi.SX.zeros(3)),
        ((2, 2, 2, 1, 4), casadi.SX(2, 1)),
    ],
    ids=["missing", "arguments", "shape", "sparse"],
)
def test_wrong_shape_is_refused(make_oscillators: MakeModel, sizes: tuple[int, ...] | None, result: casadi.SX) -> None:
    """A function of another shape would make the runtime read beyond its arrays; one that is missing is named."""
    model = make_oscillators()
    functions = {name: function for name, function in model.functions.items() if name != "residual"}
    if sizes is not None:
        functions["residual"] = casadi.Function("f", [casadi.SX.sym("x", size) for size in sizes], [result])
    with pytest.raises(ModelError, match="residual"):
        codegen.generate_functions(replace(model, functions=functions))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_in_c_are_exact(value: float) -> None:
    """A start value in the binary is the start value in the description, to the last bit; one that is no number is refused."""
    assert float(c_double(value)) == value
    with pytest.raises(ModelError, match="finite"):
        c_double(float("nan"))


@given(st.text())
def test_strings_in_c_survive(text: str) -> None:
    """Any name or sentence can stand in the generated C: quotes, backslashes, trigraphs, all of Unicode."""
    literal = c_string(text)
    body = literal[1:-1]
    assert literal[0] == literal[-1] == '"'
    assert body.isascii()
    assert body.encode().decode("unicode_escape").encode("latin-1") == text.encode()


def test_model_names_become_identifiers() -> None:
    """The library's file name must be a C identifier by the FMI standard."""
    names = {"barnard2012-6kg": "barnard2012_6kg", "6 kg": "model_6_kg", "": "model_"}
    assert {name: codegen.identifier(name) for name in names} == names


def _model(changes: dict[str, Any]) -> SymbolicModel:
    return build_model(load_scene("barnard2012-6kg").replace(changes))


def _function(model: SymbolicModel, name: str) -> casadi.Function:
    return codegen._prepare(name, model.functions[name], codegen._sizes(model))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["residual", "outputs"])
def test_twins_give_the_bits_of_casadi(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Side by side or not, with vector types or without, whole or in parts: a compiler must not decide about an FMU's numbers."""
    model = _model({})
    function = _function(model, name)
    code = function_code(function, codegen.twin_arguments(model, name))
    assert code is not None
    monkeypatch.setattr(twins, "LONG", 10)
    monkeypatch.setattr(twins, "PART", 7)
    parts = function_code(function, codegen.twin_arguments(model, name))
    assert parts is not None
    points, results = _points(function, 20), []
    for number, (text, *flags) in enumerate(
        ((codegen.with_all_arguments(codegen.c_code(function)),), (code,), (code, "-DFLEX_PLAIN"), (parts,))
    ):
        library = _library({"function.c": text, "model_functions.h": REAL}, tmp_path / str(number), *flags)
        results.append(_results(library, function.name(), function, points))
    assert np.isfinite(results[0]).any()
    for side_by_side in results[1:]:
        np.testing.assert_array_equal(side_by_side, results[0])


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
        twins = find_twins(graph, codegen.twin_arguments(model, name))
        operations = [node for node in range(len(graph.nodes)) if not graph.is_leaf(node)]
        assert sum(node in twins for node in operations) > 0.7 * len(operations), name


def test_no_twin_needs_the_other() -> None:
    """Twins are computed at once, so an operand must not wait for them."""
    model = _model({})
    graph = Graph.of(_function(model, "residual"))
    twins = find_twins(graph, codegen.twin_arguments(model, "residual"))
    needed: list[set[int]] = []
    for node in range(len(graph.nodes)):
        # everything that a node needs, the twins of its operands included
        parts = {part for i in graph.operands(node) for part in twins.get(i, (i,))}
        needed.append(parts.union(*(needed[part] for part in parts if part < node)))
    assert all(first not in needed[second] and second not in needed[first] for first, second in twins.values())
