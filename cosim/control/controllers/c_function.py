"""A controller written in C: one function with a fixed signature, called by the loop in C and compiled into the block's FMU.

The function calculates outputs and next states from the time, inputs, parameters and states, and keeps nothing itself, so that
every importer may repeat a sample. Its file is compiled with its prototype in front, so that the compiler refuses another
signature, and with the toolkit's elementary functions, so that its FMU gives the same bits everywhere.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from ctypes import CDLL, c_void_p
from functools import lru_cache
from pathlib import Path
from time import process_time

import casadi
import numpy as np

from flexfmu.cosim.control.blocks.code import library
from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import check_units, named_parameters, named_signals
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.child_process import AVAILABLE, CALL_LIMIT, ChildLostError, in_child
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.fmu_build.cache import content_hash
from flexfmu.fmu_build.errors import CompileError
from flexfmu.model.scene.controllers import CFunctionSection
from flexfmu.model.symbolic import SharedLibrary, SymbolicBlock

SIGNATURE = "void {}(double t, const double *u, const double *p, const double *x, double *y, double *next_x)"
"""Time [s], inputs, parameters and states → outputs and next states."""

LIBRARIES = (".so",)
"""Suffixes of shared libraries."""

TRIED, LEAST_TRIED, TRYING = 2000, 4, 0.2
"""Largest and smallest number of calls that try whether equal arguments give equal results, and time for them [s]."""

BEYOND = 64
"""Number of zeros behind the arguments of calls that try a function."""

CALL = "user_function"
"""Name of the function that CasADi calls, and of its file."""

_NO_CODE = re.compile(
    r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|^[ \t]*#(?:\\\n|[^\n])*", re.DOTALL | re.MULTILINE
)
"""Comments, strings, characters and lines of the preprocessor."""

_STATIC = re.compile(r"\bstatic\s+[^;={}()]*?\w+\s*(?:\[[^\]]*\]\s*)*(?=[;=,])")
_GLOBAL = re.compile(
    r"(?!(?:typedef|extern|static|enum)\b|(?:struct|union)\s+\w+\s*$)[A-Za-z_][\w\s*]*[\s*]\w+\s*(?:\[[^\]]*\]\s*)*(?=[=,]|$)"
)
"""Declarations of variables that keep their value between calls; a global one begins a statement outside all braces."""

_CALL_FILE = """/* Calls {function} as CasADi calls its functions: (x, u, p) -> (y, next_x); the last state counts the samples. */
#include <math.h>

{prototype};
int {call}(const double **arg, double **res, long long *iw, double *w, int mem);

int {call}(const double **arg, double **res, long long *iw, double *w, int mem) {{
  double *y = res[0] ? res[0] : w, *next_x = res[1] ? res[1] : w + {outputs};
  int k;
  (void)iw, (void)mem;
  /* what the function doesn't write is no number */
  for (k = 0; k < {outputs}; ++k) y[k] = NAN;
  for (k = 0; k < {states}; ++k) next_x[k] = NAN;
  {function}({offset!r} + arg[0][{states}] * {sample_time!r}, arg[1], arg[2], arg[0], y, next_x);
  next_x[{states}] = arg[0][{states}] + 1.0;
  return 0;
}}
"""

_LIBRARY_FILE = """/* What CasADi asks a library for: the numbers of arguments, results and their elements. */
#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
typedef long long casadi_int;

EXPORT int {call}(const double **arg, double **res, long long *iw, double *w, int mem);
static const casadi_int in[3][3] = {{{{{states} + 1, 1, 1}}, {{{inputs}, 1, 1}}, {{{parameters}, 1, 1}}}};
static const casadi_int out[2][3] = {{{{{outputs}, 1, 1}}, {{{states} + 1, 1, 1}}}};
EXPORT casadi_int {call}_n_in(void) {{ return 3; }}
EXPORT casadi_int {call}_n_out(void) {{ return 2; }}
EXPORT const casadi_int *{call}_sparsity_in(casadi_int i) {{ return in[i]; }}
EXPORT const casadi_int *{call}_sparsity_out(casadi_int i) {{ return out[i]; }}
EXPORT int {call}_work(casadi_int *arg, casadi_int *res, casadi_int *iw, casadi_int *w) {{
  *arg = 3, *res = 2, *iw = 0, *w = {outputs} + {states} + 1;
  return 0;
}}
"""


@builds(CFunctionSection)
def c_function(s: CFunctionSection, context: LoopContext) -> SymbolicBlock:
    """Build the block of a function in C.

    Its signature is `SIGNATURE`: t is the instant of the sample [s], counted from the start; u, p and x have the inputs, parameters
    and states in their order; the function writes all of y and next_x. It must not keep values between calls: an importer may
    repeat a sample; `static` and global variables that aren't `const` are refused, and so is a function, of a shared library for
    example, that gives other results for equal arguments when it is tried (on Linux). The file is C99; on Linux it may be a shared
    library (``.so``), which the FMU contains. By default the function is called like its first file, without ``lib``.

    Raises:
        InputError: a file can't be read or compiled, has no such function, or keeps values between calls; or a name is repeated.
        MissingCompilerError: there is no C compiler.
    """
    name, units, states = context.name, s.units, s.states
    if not s.outputs:
        raise InputError(f'{name}: a controller needs `outputs`, such as ["joint1.torque", "joint2.torque"]')
    # variables by their names
    taken, given = named_signals(s.inputs, "input", units), named_signals(s.outputs, "output", units)
    values = named_parameters(s.parameters, units)
    check_units(units, [each.name for each in (*taken, *given, *values)], name)
    # the function's files, its call, and what describes the call to CasADi
    paths = [Path(each) for each in s.source]
    first = paths[0]
    function = s.function or (first.stem.removeprefix("lib") if first.suffix in LIBRARIES else first.stem)
    if not re.fullmatch(r"[A-Za-z_]\w*", function):
        raise InputError(f"{name}: {function!r} is no name of a C function; give `function`")
    facts = {
        "function": function,
        "call": CALL,
        "prototype": SIGNATURE.format(function),
        "inputs": len(taken),
        "parameters": len(values),
        "outputs": len(given),
        "states": len(states),
        "sample_time": float(s.sample_time),
        "offset": float(s.offset),
    }
    libraries = _shared_libraries([path for path in paths if path.suffix in LIBRARIES], function)
    files = _user_files([path for path in paths if path.suffix not in LIBRARIES], facts["prototype"])
    caller = "".join(f"/* needs {each} */\n" for each in libraries) + _CALL_FILE.format(**facts)
    call, compiled = _loaded(_LIBRARY_FILE.format(**facts) + caller, files, libraries, function)

    def equations(x: Vector, u: Vector, p: Vector) -> tuple[Vector, Vector]:
        y, following = call(x, u, p)
        return y, following

    built = block(
        name,
        f"The function {function} in C",
        equations,
        inputs=taken,
        outputs=given,
        parameters=values,
        states=[*states, 0.0],
        symbol=casadi.MX,
        c_files={**files, f"{CALL}.c": caller},
        libraries=libraries,
        **s.sampling,
    )
    sizes = len(taken), len(given), len(states)
    if (unlike := _unlike(compiled, sizes, tuple(s.parameters.values()), states)) is not None:
        place, one, other = unlike
        what = given[place].name if place < len(given) else f"next_x[{place - len(given)}]"
        raise InputError(
            f"{', '.join(map(str, paths))}: {function} keeps values between calls: with equal arguments {what} was {one:.9g} in one "
            f"order of calls and {other:.9g} in another, so that samples can't be repeated; make what it keeps one of `states`"
        )
    return built


def _user_files(paths: Sequence[Path], prototype: object) -> dict[str, str]:
    """The user's files, name → text; in C files the prototype stands in front.

    Raises:
        InputError: a file can't be read, or has a variable that keeps its value between calls.
    """
    texts = {}
    for path in paths:
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it isn't UTF-8 text"
            raise InputError(f"can't read the C file {path}: {reason}") from None
        if kept := _kept(text):
            raise InputError(
                f"{path}: `{kept}` keeps its value between calls, so that samples can't be repeated: make it one of `states`, "
                "or `const` if it never changes"
            )
        front = f'#include "elementary.h"\n{prototype};\n#line 1 "{path.name}"\n' if path.suffix == ".c" else ""
        texts[path.name] = front + text
    return texts


def _kept(code: str) -> str:
    """The declaration of a variable in C that keeps its value between calls of a function; empty if there is none."""
    code = _NO_CODE.sub(" ", code)
    found = _STATIC.findall(code)
    # what stands outside all braces
    count = 1
    while count:
        code, count = re.subn(r"\{[^{}]*\}", ";", code)
    found += [match[0] for statement in code.split(";") if (match := _GLOBAL.match(statement.strip()))]
    return next((" ".join(each.split()) for each in found if not re.search(r"\bconst\b", each)), "")


def _check_defined(function: str, files: Mapping[str, str]) -> None:
    """Check that a file defines the function.

    Raises:
        InputError: none does; the message has the functions that they define.
    """
    bodies = "\n".join(text.partition("#line")[2] or text for text in files.values())  # without the prototype
    defined = re.findall(r"\bvoid\s+(\w+)\s*\([^;{]*\)\s*\{", bodies)
    if not re.search(rf"\b{function}\s*\(", bodies):
        hint = f"name one of theirs as `function` ({', '.join(defined)}), or " if defined else ""
        raise InputError(
            f"{', '.join(files)}: there is no function {function!r}; {hint}add {SIGNATURE.format(function)}"
        )


def _shared_libraries(paths: Sequence[Path], function: str) -> dict[str, SharedLibrary]:
    """The user's shared libraries under names with the hash of their content, since a process loads one file of a name only.

    Raises:
        InputError: a library can't be loaded or has no such function, or this system isn't Linux.
    """
    found = {}
    for path in paths:
        if sys.platform != "linux":
            raise InputError(f"{path}: shared libraries are taken on Linux; give the C source instead")
        try:
            loaded, content = CDLL(str(path.resolve())), path.read_bytes()
        except OSError as error:
            raise InputError(f"can't load the shared library {path}: {error}") from None
        if not hasattr(loaded, function):
            raise InputError(f"the shared library {path} has no function {function!r}; name it as `function`")
        found[f"{path.stem}-{content_hash([content])[:12]}.so"] = SharedLibrary(content, function)
    return found


def _loaded(
    code: str, c_files: Mapping[str, str], libraries: Mapping[str, SharedLibrary], function: str
) -> tuple[casadi.Function, Path]:
    """The compiled function, with derivatives by finite differences for whoever linearises it, and its library.

    Raises:
        InputError: the files can't be compiled, or don't define the function.
        MissingCompilerError: there is no C compiler.
    """
    try:
        path = library(f"{CALL}_library", code, tuple(sorted(c_files.items())), tuple(libraries.items()))
    except CompileError as error:
        if not libraries:
            _check_defined(function, c_files)
        if error.undefined:
            raise InputError(f"{error}; add the C file or library that does to `source`") from None
        wanted = "" if "linking" in str(error) else f"; the function must be\n    {SIGNATURE.format(function)}"
        raise InputError(f"{error}{wanted}") from None
    return casadi.external(CALL, str(path), {"enable_fd": True, "fd_method": "central"}), path


@lru_cache(maxsize=64)
def _unlike(
    path: Path, sizes: tuple[int, int, int], parameters: tuple[float, ...], states: tuple[float, ...]
) -> tuple[int, float, float] | None:
    """A result that isn't a function of the arguments: its place among outputs and next states, and two values of it.

    Two child processes call the function with the same arguments, one in the order of a run, the other in the reverse order: what
    it keeps between calls differs. None where all results are equal to the last bit. Also where a child can't be had or crashes; the
    run, which follows, tells that.

    Args:
        path: the compiled library.
        sizes: numbers of inputs, outputs and states.
        parameters: their values.
        states: their start values.
    """
    inputs, outputs, _ = sizes
    random = np.random.default_rng(1)
    # some samples at rest, the others from small signals to saturated ones
    signals = random.normal(size=(TRIED, inputs)) * 10.0 ** random.uniform(-3.0, 2.0, (TRIED, 1))
    signals[::4] = 0.0

    def forth() -> tuple[list[RealArray], list[RealArray]]:
        call, end = _caller(path, sizes, parameters), process_time() + TRYING
        taken, found = [np.array([*states, 0.0])], list[RealArray]()
        while len(found) < TRIED and (len(found) < LEAST_TRIED or process_time() < end):
            found.append(call(taken[-1], signals[len(found)]))
            following = found[-1][outputs:]
            # a run ends where a state is no number; here it begins again
            taken.append(following if np.isfinite(following).all() else np.array([*states, following[-1]]))
        return taken, found

    def back() -> list[RealArray]:
        call = _caller(path, sizes, parameters)
        return [call(taken[k], signals[k]) for k in reversed(range(len(first)))]

    if not AVAILABLE:
        return None
    try:
        taken, first = in_child(forth, lambda: None, CALL_LIMIT)
        second = in_child(back, lambda: None, CALL_LIMIT)[::-1]
    except ChildLostError:
        return None
    ones, others = np.array(first), np.array(second)
    different = np.argwhere((ones != others) & ~(np.isnan(ones) & np.isnan(others)))
    if not different.size:
        return None
    k, place = different[0].tolist()
    return place, float(ones[k, place]), float(others[k, place])


def _caller(
    path: Path, sizes: tuple[int, int, int], parameters: tuple[float, ...]
) -> Callable[[RealArray, RealArray], RealArray]:
    """The compiled function as (states with the number of the sample, inputs) → outputs and next states."""
    inputs, outputs, states = sizes
    function = CDLL(str(path))[CALL]
    # zeros behind them, for a function that reads too far
    x, u, p = (np.zeros(n + BEYOND) for n in (states + 1, inputs, len(parameters)))
    p[: len(parameters)] = parameters
    result, work = np.empty(outputs + states + 1), np.empty(outputs + states + 1)
    given = (c_void_p * 3)(x.ctypes.data, u.ctypes.data)
    found = (c_void_p * 2)(result.ctypes.data, result[outputs:].ctypes.data)

    def call(state: RealArray, signals: RealArray) -> RealArray:
        x[: states + 1], u[:inputs], given[2] = state, signals, p.ctypes.data
        function(given, found, None, c_void_p(work.ctypes.data), 0)
        return result.copy()

    return call
