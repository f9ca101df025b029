"""Output and update of a block as one CasADi function, evaluated in CasADi's virtual machine or in compiled C."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import casadi

from flexfmu.fmu_build.block_codegen import sample_function
from flexfmu.fmu_build.cache import cached, content_hash, store
from flexfmu.fmu_build.codegen import with_elementary_functions
from flexfmu.fmu_build.compilation import compile_library
from flexfmu.fmu_build.platforms import native_platform
from flexfmu.fmu_build.sources import Sources, elementary_sources
from flexfmu.fmu_build.toolchain import GENERATED_FLAGS, find_compiler
from flexfmu.model.symbolic import SymbolicBlock

COMPILED_FROM = 200
"""Blocks of at least this many operations are compiled by default.

The virtual machine takes 2.5 ns for an operation, compiled C a tenth of that, and a call of either takes 0.4 us. In
smaller blocks the call costs more than the evaluation. The rigid inverse dynamics of a five-bar have 240 operations
or more."""

EXPORTED_FLAGS = (*GENERATED_FLAGS, "-DGCC_HASCLASSVISIBILITY")
"""Compiler flags of an FMU's generated code, so that both round alike; the macro makes CasADi export its functions."""


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
    return compile_function(function) if compiled else function


def compile_function(function: casadi.Function, *companions: casadi.Function) -> casadi.Function:
    """Return the same function in compiled C; each generated source is compiled once.

    Args:
        function: the function.
        companions: functions that CasADi looks up by name in the same library, such as the Jacobian ``jac_<name>``.

    Raises:
        MissingCompilerError: there is no C compiler.
        CompileError: the compiler fails.
        ArchiveError: neither the cache's folder nor a temporary one can be written.
    """
    generator = casadi.CodeGenerator(f"{function.name()}.c")
    for each in (function, *companions):
        generator.add(each)
    code = with_elementary_functions(str(generator.dump()))
    return casadi.external(function.name(), str(_library(function.name(), code)))


@lru_cache(maxsize=64)
def _library(name: str, code: str) -> Path:
    """Compile a generated C file to a shared library, which the cache keeps under the hash of its content."""
    sources = Sources(name, "", "", {f"{name}.c": code}, elementary_sources(), {})
    platform = native_platform()
    content = compile_library(sources, find_compiler(platform), generated_flags=EXPORTED_FLAGS)
    file = f"blocks/{content_hash([content])}{platform.suffix}"
    path = cached(file)
    return path if path is not None and path.read_bytes() == content else store(file, content)
