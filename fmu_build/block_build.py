"""The FMU of a discrete-time block: sampling, C code of output and update, variables and structure.

The FMU samples at start time + offset + k * sample time, independently of the communication step, which may contain many sample
instants or none. At an instant within a step it evaluates the input polynomials (constant unless derivatives are set). After a step
the outputs are those of the last sample instant.

If the step ends on a sample instant, outputs with direct feedthrough keep the previous sample until an input is set; from then on
they follow the inputs. The next step completes this sample with the latest inputs. So importers that set inputs before they read
outputs get the new sample at once, others one communication step later; new states are never combined with old inputs. Before the
first instant, the outputs follow from the start states and the initial inputs.

Shift registers are copied in runs, which are loops in C. As scalars, a delay line of thousands of samples would be thousands
of statements, which take a C compiler minutes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import isfinite
from typing import Any

import casadi

from flexfmu.fmu_build import codegen
from flexfmu.fmu_build.description import Content, Description
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.interface import Interface, counter_variable, feedthrough, real_variables
from flexfmu.fmu_build.naming import Naming, named
from flexfmu.fmu_build.picture import block_picture
from flexfmu.fmu_build.regular_sampling import regular
from flexfmu.fmu_build.templating import render
from flexfmu.model.symbolic import SymbolicBlock


def regular_block(block: SymbolicBlock) -> SymbolicBlock:
    """The block with one sample time, and zero as the start of inputs that have none.

    Raises:
        ModelError: the sampling or a start state is impossible, or the instants have no common step.
    """
    check_block(block)
    inputs = tuple(replace(each, start=0.0) if each.start is None else each for each in block.inputs)
    return replace(regular(block), inputs=inputs)


def block_content(block: SymbolicBlock, naming: Naming) -> Content:
    """What a block's FMU has of its own.

    Raises:
        ModelError: the block violates its contract.
    """
    block = regular_block(block)
    functions, facts = generate_block(block)
    values = {"block": named(block, naming), "sample": facts, "max_input_order": codegen.MAX_INPUT_ORDER}
    return Content(
        "block",
        block_description(block),
        functions,
        lambda guid: render("block_description.c.j2", guid=guid, **values),
        "block.html.j2",
        picture=block_picture(),
        values={"model": block},
        c_files=block.c_files,
        libraries=block.libraries,
    )


SAMPLES = "statistics.samples"
"""Name of the sample counter, the only Integer variable."""


def block_description(block: SymbolicBlock) -> Description:
    """The content of a block's model description.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    return Description(
        name=block.name,
        text=f"{block.description.rstrip('.')}. Samples every {block.sample_time!r} s, first {block.offset!r} s after the "
        "start, and holds its outputs in between.",
        interface=block_interface(block),
        max_input_order=codegen.MAX_INPUT_ORDER,
        annotations={"Sampling": {"sampleTime": repr(block.sample_time), "offset": repr(block.offset)}},
    )


def block_interface(block: SymbolicBlock) -> Interface:
    """The variables of a block: inputs, parameters, discrete outputs, and the sample counter.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    reals = real_variables((*block.inputs, *block.parameters, *block.outputs), output_variability="discrete")
    # outputs depend on inputs by direct feedthrough; initially on all inputs and parameters
    everything = [variable.name for variable in block.inputs]
    declared = {output.name: block.feedthrough.get(output.name, everything) for output in block.outputs}
    return Interface(
        variables=(*reals, counter_variable(SAMPLES, "Samples completed since initialisation", 0)),
        outputs=feedthrough(block.outputs, block.inputs, declared),
        initial_unknowns=tuple(output.name for output in block.outputs),
        initial_knowns=tuple(variable.name for variable in (*block.inputs, *block.parameters)),
    )


SAMPLE_FILE = codegen.function_file("sample")

LARGE = 5000
"""Number of lines of C from which GCC's optimiser is switched off: its time grows quadratically (half a minute for 10 000
lines), and straight-line code gains little."""

_QUICK = """#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC optimize("O0")
#endif
"""

SHORTEST_RUN = 16
"""Smallest number of states in a copied run; fewer are cheaper as statements."""

_ARGUMENTS = ("x", "u", "p")


def sample_function(block: SymbolicBlock) -> casadi.Function:
    """Function (x, u, p) → (y, next x) of output and update, dense.

    Common scalar subexpressions and calls of C functions are shared; matrix operations and long copies remain loops in C.

    Raises:
        ModelError: a function of the block has wrong sizes.
    """
    sizes = len(block.states), len(block.inputs), len(block.parameters)
    _check_function(block, "output", block.output, sizes, len(block.outputs))
    _check_function(block, "update", block.update, sizes, len(block.states))
    functions = (block.output, block.update)
    # scalar functions share subexpressions, matrix functions keep their loops
    is_scalar = all(function.is_a("SXFunction") for function in functions)
    symbol: Any = casadi.SX if is_scalar else casadi.MX
    arguments = [symbol.sym(name, size) for name, size in zip(_ARGUMENTS, sizes, strict=True)]
    # inlined, so that output and update share one call of a function in C
    calls_c = bool(block.c_files)
    results = [casadi.densify(function.call(arguments, calls_c, False)[0]) for function in functions]
    if is_scalar or calls_c:
        results = casadi.cse(results)
    sample = casadi.Function("model_sample", arguments, results, list(_ARGUMENTS), ["y", "next_x"])
    return with_runs_copied(sample) if is_scalar else sample


def generate_block(block: SymbolicBlock) -> tuple[dict[str, str], codegen.GeneratedFunction]:
    """C files of the block's function (name → text, header included) and the facts for the constant tables.

    Raises:
        ModelError: the block violates its contract, or CasADi can't generate C for one of its operations.
    """
    check_block(block)
    function = sample_function(block)
    facts = codegen.function_facts("sample", function)
    try:
        code = codegen.c_code(function)
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise ModelError(f"block '{block.name}' cannot be exported: CasADi has no C for it ({reason})") from error
    # long straight-line code is compiled without the optimiser
    code = code if code.count("\n") < LARGE else _QUICK + code
    return {SAMPLE_FILE: code, codegen.HEADER_FILE: render(codegen.HEADER_FILE + ".j2", functions=(facts,))}, facts


def check_block(block: SymbolicBlock) -> None:
    """Check sample time, offset and start states.

    Raises:
        ModelError: the sample time isn't positive, the offset is negative, or a start state isn't finite.
    """
    # sampling, then start states
    name = block.name
    if not (block.sample_time > 0.0 and (isfinite(block.sample_time) or block.instants)):
        raise ModelError(
            f"the sample time of block '{name}' must be positive, got {block.sample_time} s; 1e-3 is 1 kHz"
        )
    if not (isfinite(block.offset) and block.offset >= 0.0):
        raise ModelError(f"the offset of block '{name}' must be zero or positive, got {block.offset} s")
    for index, state in enumerate(block.states):
        if not isfinite(state):
            raise ModelError(f"start value {index} of the states of block '{name}' must be finite, got {state}")


def _check_function(
    block: SymbolicBlock, name: str, function: casadi.Function, sizes: tuple[int, ...], result: int
) -> None:
    got = tuple(function.numel_in(i) for i in range(function.n_in()))
    results = tuple(function.numel_out(i) for i in range(function.n_out()))
    if got != sizes or results != (result,):
        raise ModelError(
            f"function '{name}' of block '{block.name}' must take (x, u, p) of sizes {sizes} and give {result} values, "
            f"it takes {got} and gives {results}"
        )


def with_runs_copied(function: casadi.Function) -> casadi.Function:
    """The scalar function (x, u, p) → (y, next x) with long runs next_x[i..j] = x[k..l] as copies.

    Returns the function itself if there are no such runs.
    """
    symbols = function.sx_in()
    y, next_x = function.call(symbols)
    # for each next state the index of the state that it copies, or -1
    total, index = next_x.numel(), {symbols[0][j].element_hash(): j for j in range(symbols[0].numel())}
    entries = [next_x[i] for i in range(total)]
    sources = [index.get(entry.element_hash(), -1) if entry.is_symbolic() else -1 for entry in entries]
    # long runs of them: (first next state, first state, length)
    breaks = [i for i, (one, next_one) in enumerate(pairwise(sources), 1) if one < 0 or next_one != one + 1]
    parts = [(begin, sources[begin], end - begin) for begin, end in pairwise([0, *breaks, total]) if end > begin]
    runs = [run for run in parts if run[1] >= 0 and run[2] >= SHORTEST_RUN]
    if not runs:
        return function
    # scalar equations of the states outside the runs
    copied = {i for begin, _, length in runs for i in range(begin, begin + length)}
    computed = casadi.Function(
        f"{function.name()}_computed", symbols, [y, next_x[[i for i in range(total) if i not in copied]]]
    )
    # their results and the copied runs in the order of the states; matrix operations remain loops in C
    arguments = [casadi.MX.sym(name, symbol.numel()) for name, symbol in zip("xup", symbols, strict=True)]
    outputs, states = computed.call(arguments)
    pieces, at, used = [], 0, 0
    for begin, source, length in [*runs, (total, 0, 0)]:
        pieces += [states[used : used + begin - at, 0], arguments[0][source : source + length, 0]]
        used, at = used + begin - at, begin + length
    following = casadi.vertcat(*(piece for piece in pieces if piece.numel()))
    return casadi.Function(function.name(), arguments, [outputs, following], function.name_in(), function.name_out())
