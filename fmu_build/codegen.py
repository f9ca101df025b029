"""C code of a symbolic model: functions from CasADi, constant tables from a template.

The code is deterministic: the same model gives the same bytes, without dates and paths.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np

from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.interface import find_states
from flexfmu.fmu_build.templating import render
from flexfmu.fmu_build.twins import Entry, function_code, lanes_code, two_functions
from flexfmu.model.symbolic import EVENT_SIGNATURES, FUNCTION_SIGNATURES, SymbolicModel, Variable

MAX_INPUT_ORDER = 9
"""Highest order that fmi2SetRealInputDerivatives accepts: two-point Hermite data of value and four derivatives."""

DESCRIPTION_FILE = "model_description.c"
HEADER_FILE = "model_functions.h"
LANES_FILE = "model_residual_lanes.c"
SPARSE_FILE = "model_sparse.c"

SIGNATURES = {**FUNCTION_SIGNATURES, **EVENT_SIGNATURES, "jacobian": (("y", "v", "a", "u", "d"), "entries")}

UNKNOWNS = ("y", "v", "a", "j", "dy", "dv")
INPUTS = ("u", "u1", "u2", "du")
"""Arguments in `FUNCTION_SIGNATURES` with one entry for each unknown, and for each input."""

_MATHEMATICS = "#include <math.h>"

_CODE_OPTIONS: Any = {"casadi_int": "int", "with_export": False}


@dataclass(frozen=True)
class GeneratedFunction:
    """A generated function: field in the model's table, C name, sizes of CasADi's work arrays, and whether it shares them with another."""

    field: str
    symbol: str
    n_arg: int
    n_res: int
    n_iw: int
    n_w: int
    shares_work: bool = False


def function_file(name: str) -> str:
    """Name of the C file of the generated function ``name``; one file each, to compile in parallel."""
    return f"model_{name}.c"


def identifier(name: str) -> str:
    """``name`` as a C identifier: all characters but letters and digits become underscores."""
    cleaned = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return cleaned if re.match(r"[A-Za-z_]", cleaned) else f"model_{cleaned}"


@dataclass(frozen=True)
class Pattern:
    """Entries of a sparse matrix and of its factors, by columns; the rows of each column in the order of elimination.

    Attributes:
        order: unknowns in the order of elimination.
        starts: first entry of each column, and the number of entries.
        diagonals: which entry of each column is on the diagonal.
        rows: row of each entry.
    """

    order: tuple[int, ...]
    starts: tuple[int, ...]
    diagonals: tuple[int, ...]
    rows: tuple[int, ...]


SPARSE_FROM = 8
"""Number of unknowns from which a Newton matrix may be sparse."""

SPARSE_SHARE = 0.1
"""Products in the factors of a sparse matrix, most for one of n rows, relative to n^3: those of a dense one are a third of that."""


def sparse_matrix(model: SymbolicModel) -> tuple[Pattern, casadi.Function] | None:
    """The pattern of M, D and K, derivatives of the residual by accelerations, rates and coordinates, with that of their factors, and
    the function that gives the entries of the three; None where dense matrices take less time, and where friction changes rows."""
    n = model.degrees_of_freedom
    if n < SPARSE_FROM or model.frictions:
        return None
    names, residual = SIGNATURES["jacobian"][0], _function(model, "residual")
    arguments = [casadi.SX.sym(name, residual.sparsity_in(i)) for i, name in enumerate(names)]
    value = residual(*arguments)
    blocks = [casadi.jacobian(value, arguments[i]) for i in (2, 1, 0)]
    pattern = casadi.Sparsity.diag(n)
    for block in blocks:
        pattern = pattern + block.sparsity() + block.sparsity().T
    # factors, whose pattern is that of Cholesky's
    upper, order = pattern.ldl(True)
    if sum(count**2 for count in np.diff(upper.T.colind())) > SPARSE_SHARE * n**3:
        return None
    factors = upper + upper.T + casadi.Sparsity.diag(n)
    position = {unknown: k for k, unknown in enumerate(order)}
    columns = [[order[row] for row in factors.row()[slice(*factors.colind()[k : k + 2])]] for k in range(n)]
    columns = [columns[position[c]] for c in range(n)]
    starts = np.cumsum([0, *map(len, columns)]).tolist()
    rows = [row for column in columns for row in column]
    diagonals = [starts[c] + column.index(c) for c, column in enumerate(columns)]
    entries = casadi.vertcat(*(block[row, c] for block in blocks for c, column in enumerate(columns) for row in column))
    return Pattern(tuple(order), tuple(starts), tuple(diagonals), tuple(rows)), casadi.Function(
        "jacobian", arguments, [casadi.densify(entries)]
    )


def generate_functions(model: SymbolicModel) -> tuple[dict[str, str], tuple[GeneratedFunction, ...]]:
    """C files of the model's functions (name → text, header included) and the facts for the constant tables.

    Raises:
        ModelError: a function is missing or has a wrong signature, or the mass matrix isn't symmetric or not that of the residual.
    """
    sizes = _sizes(model)
    functions = {
        name: _function(model, name) for name in (*FUNCTION_SIGNATURES, *(EVENT_SIGNATURES if model.events else ()))
    }
    if (sparse := sparse_matrix(model)) is not None:
        functions["jacobian"] = sparse[1]
        sizes["entries"] = (3 * len(sparse[0].rows), 1)
    prepared = {name: _prepare(name, function, sizes) for name, function in functions.items()}
    _check_mass_matrix(model, prepared)
    facts = {name: function_facts(name, function) for name, function in prepared.items()}
    # operations of twins side by side where the model has any; CasADi's code for what branches
    codes = dict[str, str]()
    if (rates := _rates_code(model, prepared)) is not None:
        *texts, n_w = rates
        codes = dict(zip(RATES, texts, strict=True))
        facts |= {name: replace(facts[name], n_w=n_w, shares_work=True) for name in RATES}
    for name, function in prepared.items():
        if name not in codes:
            codes[name] = function_code(function, twin_arguments(model, name)) or with_all_arguments(c_code(function))
    files = {function_file(name): code for name, code in codes.items()}
    if (lanes := lanes_code(prepared["residual"])) is not None:
        files[LANES_FILE] = render(LANES_FILE + ".j2", function=lanes)
    if sparse is not None:
        files[SPARSE_FILE] = render(SPARSE_FILE + ".j2", pattern=sparse[0])
    return files | {HEADER_FILE: render(HEADER_FILE + ".j2", functions=facts.values())}, tuple(facts.values())


RATES = ("motion_rate1", "motion_rate2")
"""The functions that share operations, `motion_rate1` also with the mass matrix and the outputs, which it gives behind its results."""


def _rates_code(model: SymbolicModel, functions: Mapping[str, casadi.Function]) -> tuple[str, str, int] | None:
    """C code of both `RATES`, and the size of the work array that hands on what the second one takes from the first."""
    names = SIGNATURES[RATES[1]][0]
    symbols = {name: casadi.SX.sym(name, functions[RATES[1]].sparsity_in(i)) for i, name in enumerate(names)}
    rates, mass, outputs, second = (
        casadi.vec(functions[each](*(symbols[name] for name in SIGNATURES[each][0])))
        for each in (RATES[0], "mass_matrix", "outputs", RATES[1])
    )
    first = casadi.vertcat(rates, mass, outputs)
    together = casadi.Function(
        "rates", list(symbols.values()), [casadi.cse(casadi.densify(casadi.vertcat(first, second)))]
    )
    symbol_names = (functions[RATES[0]].name(), functions[RATES[1]].name())
    return two_functions(together, first.numel(), symbol_names, twin_arguments(model, RATES[1]))


def twin_arguments(model: SymbolicModel, name: str) -> list[tuple[Entry, Entry]]:
    """Twins among the arguments of the function ``name``."""
    twins: dict[str, tuple[tuple[int, int], ...]] = dict.fromkeys(UNKNOWNS, model.twin_unknowns)
    twins |= dict.fromkeys(INPUTS, model.twin_inputs)
    arguments = enumerate(SIGNATURES[name][0])
    return [((k, first), (k, second)) for k, argument in arguments for first, second in twins.get(argument, ())]


def generate_description(
    model: SymbolicModel,
    functions: tuple[GeneratedFunction, ...],
    guid: str,
    tolerance: float,
    *,
    has_lanes: bool = False,
) -> str:
    """The C file that defines ``flex_the_model``.

    Args:
        model: the model.
        functions: its generated functions.
        guid: GUID of the FMU.
        tolerance: default relative tolerance.
        has_lanes: whether there is a residual for lanes, see `lanes_code`.
    """
    return render(
        DESCRIPTION_FILE + ".j2",
        model=model,
        states=find_states(model),
        functions=functions,
        guid=guid,
        tolerance=tolerance,
        n_derived=_function(model, "derive").numel_out(0),
        max_input_order=MAX_INPUT_ORDER,
        has_lanes=has_lanes,
        sparse=any(each.field == "jacobian" for each in functions),
        rates_share=any(each.shares_work for each in functions),
    )


def _function(model: SymbolicModel, name: str) -> casadi.Function:
    if name not in model.functions:
        raise ModelError(f"model '{model.name}' has no function '{name}'")
    return model.functions[name]


def _sizes(model: SymbolicModel) -> dict[str, tuple[int, int]]:
    """Shape of every argument and result by its name in `FUNCTION_SIGNATURES`."""
    n, m = model.degrees_of_freedom, len(model.inputs)
    # coordinates and their directions of differentiation, inputs, outputs
    vectors = dict.fromkeys((*UNKNOWNS, "r"), n) | dict.fromkeys(INPUTS, m)
    vectors |= {"o": len(model.outputs), "rates2": n + len(model.outputs)}
    vectors["changes"] = n + len(model.outputs) + len(model.acceleration_terms)
    # parameters, and values derived from them
    vectors |= dict.fromkeys(("p", "dp"), len(model.parameters))
    vectors |= dict.fromkeys(("d", "dd"), n_derived := _function(model, "derive").numel_out(0))
    vectors["start"] = 2 * n if model.nominals else n
    vectors["start_rates"] = n_derived + vectors["start"]
    vectors |= {"margin": 1, "scale": 2 * n + 1, "motion": 2 * n}
    vectors |= {"fired": len(model.events), "crossings": 2 * len(model.events)}
    return {name: (size, 1) for name, size in vectors.items()} | {"m": (n, n)}


def _prepare(name: str, function: casadi.Function, sizes: Mapping[str, tuple[int, int]]) -> casadi.Function:
    """The function with its C name, a dense result and shared subexpressions.

    Raises:
        ModelError: arguments or result have wrong shapes.
    """
    arguments, result = SIGNATURES[name]
    if function.n_in() != len(arguments) or function.n_out() != 1:
        raise ModelError(f"function '{name}' must take ({', '.join(arguments)}) and give {result}, got {function}")
    # check the signature, which the C runtime relies on
    for position, argument in enumerate(arguments):
        _check_shape(f"argument {argument} of '{name}'", function.sparsity_in(position), sizes[argument])
    _check_shape(f"result {result} of '{name}'", function.sparsity_out(0), sizes[result])

    # expand to scalar operations and share common subexpressions
    symbols = [casadi.SX.sym(argument, function.sparsity_in(i)) for i, argument in enumerate(arguments)]
    value = casadi.cse(casadi.densify(function.call(symbols)[0]))
    return casadi.Function(f"model_{name}", symbols, [value], list(arguments), [result])


SPREADS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0)
"""Spreads of the points at which a mass matrix is evaluated, around the start and relative to it, or absolute around 0."""

DRAWN = 8
"""Number of points of each spread."""

EQUAL = 1e-9
"""Relative difference of values that count as equal: rounding errors near a singularity reach 1e-12."""


def _check_mass_matrix(model: SymbolicModel, functions: Mapping[str, casadi.Function]) -> None:
    """Check that the mass matrix is symmetric, and the residual linear in the accelerations with this matrix.

    The integrators of co-simulation use the residual, model exchange the Cholesky factors of the lower half of the matrix: where
    these differ, so do the results. Entries whose expressions aren't the same are compared at points drawn around the start,
    those beyond a singularity left out.

    Raises:
        ModelError: an entry differs from its mirror image, or from the residual's Jacobian.
    """
    names, random = model.unknowns, np.random.default_rng(0)
    y, u, d = (casadi.SX.sym(name, functions["mass_matrix"].sparsity_in(i)) for i, name in enumerate("yud"))
    symbolic = casadi.sparsify(casadi.cse(functions["mass_matrix"](y, u, d)))
    difference = casadi.sparsify(casadi.tril(symbolic - symbolic.T, False))
    pairs = sorted(zip(*difference.sparsity().get_triplet(), strict=True))
    open_pairs = [(i, j) for i, j in pairs if not casadi.simplify(difference[i, j]).is_zero()]
    for spread in np.repeat(SPREADS, DRAWN):
        # a point: parameters within their limits, coordinates, inputs, rates and accelerations
        p = np.array([_drawn(each, spread, random) for each in model.parameters])
        d, y, u = (functions[name](p).full().ravel() for name in ("derive", "initial_coordinates", "initial_inputs"))
        y = y[: len(names)]
        y, u = (values + spread * random.standard_normal(values.size) for values in (y, u))
        if not float(functions["singularity"](y, u, d)) >= model.minimum_margin:
            continue
        v, a = spread * random.standard_normal(y.size), random.standard_normal(y.size)
        mass = functions["mass_matrix"](y, u, d).full()
        where = f"at {', '.join(f'{name} = {value:.4g}' for name, value in zip(names, y, strict=True))}"
        # symmetry, relative to the entries and to those on the diagonal
        for i, j in open_pairs:
            size = max(abs(mass[i, j]), abs(mass[j, i]), np.sqrt(abs(mass[i, i] * mass[j, j])))
            if abs(mass[i, j] - mass[j, i]) > EQUAL * size:
                raise ModelError(
                    f"the mass matrix of model '{model.name}' isn't symmetric: its entry ({names[i]}, {names[j]}) is "
                    f"{mass[i, j]:.6g}, its entry ({names[j]}, {names[i]}) is {mass[j, i]:.6g} {where}; write the equations "
                    f"of motion so that it is, as those of Lagrange are"
                )
        # the residual's change by accelerations
        bias, moving = (functions["residual"](y, v, each, u, d).full().ravel() for each in (0.0 * a, a))
        with np.errstate(invalid="ignore"):  # a run tells where the equations aren't finite
            unequal = abs(moving - bias - mass @ a) > EQUAL * (abs(bias) + abs(mass) @ abs(a))
        if unequal.any():
            row = int(np.argmax(unequal))
            raise ModelError(
                f"'mass_matrix' of model '{model.name}' isn't the Jacobian of 'residual' by the accelerations: in the row of "
                f"{names[row]} the residual changes by {(moving - bias)[row]:.6g}, the matrix times the accelerations is "
                f"{(mass @ a)[row]:.6g} {where}; make it casadi.jacobian(residual, a), of a residual that is linear in a"
            )


def _drawn(parameter: Variable, spread: float, random: np.random.Generator) -> float:
    """A parameter's value near its start, within its limits."""
    start = parameter.start or 0.0
    value = start + 0.1 * spread * random.standard_normal() * (abs(start) or 1.0)
    low = value if parameter.minimum is None else parameter.minimum
    high = value if parameter.maximum is None else parameter.maximum
    return float(min(max(value, low), high))


def _check_shape(what: str, sparsity: casadi.Sparsity, expected: tuple[int, int]) -> None:
    shape = sparsity.size()
    is_empty = sparsity.numel() == 0 and expected[0] * expected[1] == 0
    if not is_empty and (shape != expected or not sparsity.is_dense()):
        kind = "dense" if sparsity.is_dense() else "sparse"
        raise ModelError(f"{what} must be dense {expected[0]} x {expected[1]}, got {kind} {shape[0]} x {shape[1]}")


def c_code(function: casadi.Function) -> str:
    """The C code of a function; all its identifiers have the function's name as prefix."""
    generator = casadi.CodeGenerator(f"{function.name()}_", _CODE_OPTIONS)
    generator.add(function)
    return with_elementary_functions(str(generator.dump()))


def with_elementary_functions(code: str) -> str:
    """Generated C code that uses the runtime's own sin, exp, ..., since those of C libraries differ in the last place."""
    return code.replace(_MATHEMATICS, f'{_MATHEMATICS}\n#include "elementary.h"', 1)


def with_all_arguments(code: str) -> str:
    """Generated C code without CasADi's null checks of arguments and results, which take up to a tenth of the time."""
    code = re.sub(r"arg\[(\d+)\]\? (arg\[\1\]\[\d+\]) : 0", r"\2", code)
    return re.sub(r"if \(res\[(\d+)\]!=0\) (?=res\[\1\])", "", code)


def function_facts(name: str, function: casadi.Function) -> GeneratedFunction:
    """Facts about a generated function; ``name`` is its field in the model's table."""
    return GeneratedFunction(
        field=name,
        symbol=function.name(),
        n_arg=function.sz_arg(),
        n_res=function.sz_res(),
        n_iw=function.sz_iw(),
        n_w=function.sz_w(),
    )
