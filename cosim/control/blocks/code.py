"""Output and update of a block as one CasADi function, evaluated in CasADi's virtual machine or in compiled C.

Either way the loop in C calls CasADi's evaluation directly: the virtual machine is C++ itself.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from ctypes import CDLL, c_char_p, c_long, c_void_p, cast, py_object, pythonapi
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from flexfmu.cosim.engine.binding import Evaluation
from flexfmu.cosim.engine.slave import Call, RealArray
from flexfmu.fmu_build.block_build import sample_function
from flexfmu.fmu_build.cache import cache_folder, content_hash, read_cached, store
from flexfmu.fmu_build.codegen import with_elementary_functions
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.sources import Sources, runtime_sources
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, find_compiler, native_platform
from flexfmu.model.symbolic import SharedLibrary, SymbolicBlock

COMPILED_FROM = 200
"""Blocks of at least this many operations are compiled by default.

The virtual machine takes 2.5 ns for an operation, compiled C a tenth of that, and a compiler some 0.2 s: for smaller blocks it
would take more than a million samples to pay. The rigid inverse dynamics of a five-bar have 240 operations or more."""

PLAIN_FROM = 5000
"""Functions at points of at least this many operations are compiled without optimisation: the compiler takes a fifth of the time, and the
function two or three times as long."""

EXPORTED_FLAGS = (*GENERATED_FLAGS, "-DGCC_HASCLASSVISIBILITY")
"""Compiler flags of an FMU's generated code, so that both round alike; the macro makes CasADi export its functions."""


QUIET_FUNCTIONS = ("SXFunction", "MXFunction", "Map", "Switch", "LinearInterpolant", "BSplineInterpolant", "External")
"""CasADi's classes of functions that need no Python and raise nothing; compiled C is an External."""

LOUD_OPERATIONS = tuple(
    getattr(casadi, f"OP_{name}")
    for name in ("ASSERTION", "MONITOR", "PRINTME", "DUMP", "SOLVE", "INVERSE", "DETERMINANT")
)
"""Operations that raise or print."""

_pointer: Any = pythonapi.PyCapsule_GetPointer
_pointer.argtypes, _pointer.restype = (py_object, c_char_p), c_void_p


def block_function(block: SymbolicBlock, compiled: bool | None = None) -> casadi.Function:
    """Return output and update of a block as one function (x, u, p) → (y, next x) with dense vectors.

    Args:
        block: the block.
        compiled: True for compiled C, False for the virtual machine; None compiles from `COMPILED_FROM` operations on.

    Raises:
        ModelError: a function of the block has a wrong shape.
        MissingCompilerError, CompileError: it can't be compiled.
    """
    function = sample_function(block)
    if compiled is None:
        compiled = function.n_instructions() >= COMPILED_FROM
    if not compiled:
        return function
    return compile_function(function, c_files=block.c_files, libraries=block.libraries)


def bound(
    function: casadi.Function, arguments: Sequence[RealArray], results: Sequence[RealArray | None]
) -> tuple[Any, Call]:
    """Bind a function to memory: contiguous vectors that its call reads and writes, None for results that aren't wanted.

    Returns:
        The buffer, which must live as long as the call, and the call.
    """
    buffer: Any
    buffer, call = function.buffer()
    for i, values in enumerate(arguments):
        buffer.set_arg(i, values.data)
    for i, found in enumerate(results):
        if found is not None:
            buffer.set_res(i, found.data)
    return buffer, call


def evaluation(function: casadi.Function, call: Any) -> Evaluation | None:
    """Return the evaluation of a function's buffer for C; None if it may take Python or raise, or isn't known to be called.

    Args:
        function: the function.
        call: its call on bound memory.
    """
    address = _evaluator()
    if address is None or not all(_needs_no_python(each) for each in (function, *function.find_functions())):
        return None
    (capsule,) = call.args
    return Evaluation(address, _pointer(capsule, None), call)


@cache
def _evaluator() -> int | None:
    """Address of ``void casadi::_function_buffer_eval(void *)``, which the call of a buffer makes; None if not found."""
    library = Path(casadi.__file__).with_name("libcasadi.dll" if os.name == "nt" else "_casadi.so")
    try:
        return cast(CDLL(str(library))["_ZN6casadi21_function_buffer_evalEPv"], c_void_p).value
    except (OSError, AttributeError):
        return None


def _needs_no_python(function: casadi.Function) -> bool:
    """Whether the evaluation neither calls Python, nor prints, nor raises: no callback, assertion, linear solver and so on."""
    kind = function.class_name()
    count = function.n_instructions() if kind in ("SXFunction", "MXFunction") else 0
    return kind in QUIET_FUNCTIONS and not any(function.instruction_id(i) in LOUD_OPERATIONS for i in range(count))


class CompiledAtPoints:
    """A CasADi function of dense vectors, compiled, for many points at once: a drop-in for `flexfmu.model.vectorised.Vectorised`.

    Args:
        function: the function.

    Raises:
        MissingCompilerError, CompileError, ArchiveError: as `compile_function`.
    """

    def __init__(self, function: casadi.Function) -> None:
        self._sizes = [function.numel_out(i) for i in range(function.n_out())]
        code, name = _generated(function), function.name()
        loop = _AT_POINTS.format(
            name=name,
            arguments=function.n_in(),
            results=function.n_out(),
            given=", ".join(str(function.numel_in(i)) for i in range(function.n_in())),
            found=", ".join(map(str, self._sizes)),
            integers=function.sz_iw() + 1,
            numbers=function.sz_w() + 1,
        )
        text, beside, level = code + loop, tuple[tuple[str, str], ...](), "-O1"
        if function.n_instructions() >= PLAIN_FROM:
            text, beside, level = _ROOT + text, (("root.c", _ROOT_FILE),), "-O0"
        self._call: Any = CDLL(str(library(name, text, beside, flags=(*EXPORTED_FLAGS, level))))[f"{name}_at_points"]

    def __call__(self, arguments: Sequence[RealArray]) -> list[RealArray]:
        """Results (N, size) for arguments (N, size), one row for each point."""
        rows = [np.ascontiguousarray(each, dtype=float) for each in arguments]
        found = [np.empty((len(rows[0]), size)) for size in self._sizes]
        given, wanted = ((c_void_p * len(each))(*(one.ctypes.data for one in each)) for each in (rows, found))
        self._call(c_long(len(rows[0])), given, wanted)
        return found


_AT_POINTS = """
CASADI_SYMBOL_EXPORT void {name}_at_points(long count, const casadi_real *const *arguments, casadi_real *const *results) {{
  const long given[] = {{{given}}}, found[] = {{{found}}};
  const casadi_real *arg[{arguments}];
  casadi_real *res[{results}], w[{numbers}];
  casadi_int iw[{integers}];
  for (long k = 0; k < count; k++) {{
    for (int i = 0; i < {arguments}; i++) arg[i] = arguments[i] + k * given[i];
    for (int i = 0; i < {results}; i++) res[i] = results[i] + k * found[i];
    {name}(arg, res, iw, w, 0);
  }}
}}
"""
"""Calls a generated function at one point after the other, whose arguments and results lie in rows."""

_ROOT = "#include <math.h>\ndouble root(double x);\n#define sqrt root\n"
_ROOT_FILE = "#include <math.h>\ndouble root(double x) { return sqrt(x); }\n"
"""Without optimisation compilers call the square root of the C library, which isn't linked."""


def _generated(*functions: casadi.Function) -> str:
    """CasADi's C code of functions, the first of which names the file."""
    generator = casadi.CodeGenerator(f"{functions[0].name()}.c")
    for each in functions:
        generator.add(each)
    return with_elementary_functions(str(generator.dump()))


def compile_function(
    function: casadi.Function,
    *companions: casadi.Function,
    c_files: Mapping[str, str] | None = None,
    libraries: Mapping[str, SharedLibrary] | None = None,
) -> casadi.Function:
    """Return the same function in compiled C; each generated source is compiled once.

    Args:
        function: the function.
        companions: functions that CasADi looks up by name in the same library, such as the Jacobian ``jac_<name>``.
        c_files: C files and headers that the function calls, name → text.
        libraries: shared libraries that these call, name → library.

    Raises:
        MissingCompilerError: there is no C compiler.
        CompileError: the compiler fails.
        ArchiveError: neither the cache's folder nor a temporary one can be written.
    """
    code = _generated(function, *companions)
    called = tuple((c_files or {}).items()), tuple((libraries or {}).items())
    return casadi.external(function.name(), str(library(function.name(), code, *called)))


@lru_cache(maxsize=64)
def library(
    name: str,
    code: str,
    c_files: tuple[tuple[str, str], ...] = (),
    libraries: tuple[tuple[str, SharedLibrary], ...] = (),
    flags: tuple[str, ...] = EXPORTED_FLAGS,
) -> Path:
    """Compile a C file to a shared library, which the cache keeps under the hash of its content; errors as for `compile_function`.

    Args:
        name: name of the library.
        code: the C file, generated.
        c_files: further C files and headers, (name, text) each.
        libraries: shared libraries that these call, (name, library) each; they are stored beside the compiled one.
        flags: of the compiler.
    """
    own = runtime_sources("elementary")
    texts = own | dict(c_files)
    sources = Sources(name, "", "", {f"{name}.c": code}, texts, {}, libraries=dict(libraries), joined=tuple(own))
    platform = native_platform()
    content = compile_library(sources, find_compiler(platform), generated_flags=flags)
    for beside, each in libraries:
        store(f"blocks/{beside}", each.content)
    file = f"blocks/{content_hash([content])}{platform.suffix}"
    return cache_folder() / file if read_cached(file) == content else store(file, content)
