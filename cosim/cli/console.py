"""Input and output of the commands: results on standard output, progress on standard error where that is a terminal, every error as
one line with an exit status; scenes whose effects are chosen where they are left open; and files in a folder of results.

Exit status 0: done. 1: it ran and failed. 2: wrong usage or input, nothing was done.
"""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from errno import EMFILE
from hashlib import sha256
from importlib.machinery import PathFinder
from io import StringIO
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, Never, TextIO

import typer

from flexfmu.cosim.engine.errors import InputError, ResultsError
from flexfmu.cosim.engine.files import RESULTS, OutputFolder, to_json
from flexfmu.errors import remove_empty, shortened

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from flexfmu.cosim.engine.results import Recording
    from flexfmu.cosim.engine.showing import ShowProgress
    from flexfmu.model.scene.schema import Scene
    from flexfmu.model.symbolic import SymbolicBlock, SymbolicModel


PIPED_WIDTH = 120
"""Columns of a table that goes into a file or another program, unless the environment has `COLUMNS`."""


def print_text(text: str) -> None:
    """Write to standard output at once. The command ends without a message if the reader has closed the pipe.

    Raises:
        ResultsError: standard output is closed or can't be written, a full disk for example.
    """
    stdout: TextIO | None = sys.stdout
    if stdout is None:
        raise ResultsError("can't write to standard output: it is closed")
    try:
        stdout.write(text.encode(stdout.encoding or "utf-8", "replace").decode(stdout.encoding or "utf-8"))
        stdout.flush()
    except BrokenPipeError:
        abandon_stdout()
        raise typer.Exit(1) from None
    except OSError as error:
        abandon_stdout()
        raise ResultsError(f"can't write to standard output: {error.strerror or error}") from error


def print_rich(*parts: RenderableType) -> None:
    """Write tables and styled text to standard output; see `rich_output`. Sentences are wrapped in a terminal alone."""
    from rich.text import Text

    with rich_output() as console:
        for part in parts:
            shown = Text(part) if isinstance(part, str) else part
            console.print(shown, soft_wrap=isinstance(shown, Text) and not console.is_terminal)


def check_page_compiler() -> None:
    """Check that pages that simulate can be compiled, before anything runs.

    Raises:
        BuildError: there is no ziglang.
    """
    from flexfmu.fmu_build.toolchain import WASM, find_compiler

    find_compiler(WASM)


def print_result(as_json: bool, data: Any, *parts: RenderableType) -> None:
    """Write a result to standard output: its data as JSON, or else these tables and texts."""
    if as_json:
        print_text(to_json(data))
    else:
        print_rich(*parts)


@contextmanager
def rich_output() -> Iterator[Console]:
    """A console whose text goes to standard output when the context ends: as wide as the terminal, and in colours where there is one.

    Raises:
        ResultsError: standard output is closed or can't be written.
    """
    from rich.console import Console

    is_terminal, text = sys.stdout is not None and sys.stdout.isatty(), StringIO()
    columns = os.environ.get("COLUMNS", "")
    width = None if is_terminal else int(columns) if columns.isdigit() and int(columns) else PIPED_WIDTH
    yield Console(file=text, force_terminal=is_terminal or None, width=width, highlight=False)
    print_text(text.getvalue())


OTHERS = 34
"""Columns that a progress bar's text leaves for the bar and the times."""

PIPED_INTERVAL = 60.0
"""Time between two lines of progress in a pipe [s]."""


@contextmanager
def progress() -> Iterator[ShowProgress]:
    """A progress bar on standard error; where that is piped, a line for each `PIPED_INTERVAL`."""
    stderr: TextIO | None = sys.stderr
    if stderr is None or not stderr.isatty():
        due = monotonic() + PIPED_INTERVAL

        def show_line(text: str, fraction: float | None) -> None:
            nonlocal due
            if monotonic() >= due:
                due = monotonic() + PIPED_INTERVAL
                show_note(text if fraction is None else f"{text}, {100.0 * fraction:.0f} %")

        yield show_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    # a long text leaves room for a short bar and the times
    console, times = Console(stderr=True), (TimeElapsedColumn(), TimeRemainingColumn())
    text = TextColumn(
        "{task.description}", table_column=Column(no_wrap=True, max_width=max(console.width - OTHERS, 10))
    )
    with Progress(SpinnerColumn(), text, BarColumn(), *times, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda text, fraction: bar.update(
            task, description=text, total=None if fraction is None else 1.0, completed=fraction or 0.0
        )


def keep_stdout() -> None:
    """Keep standard output for results: what libraries of FMUs print goes to standard error from here on."""
    try:
        own = os.dup(sys.stdout.fileno())
    except (AttributeError, OSError, ValueError):  # there is none
        return
    try:
        os.dup2(2, 1)
    except OSError:  # there is no standard error
        os.close(own)
        return
    sys.stdout = open(own, "w", encoding=sys.stdout.encoding, errors=sys.stdout.errors)  # noqa: SIM115 - lives as long as the process


def end_loading() -> None:
    """Start the garbage collector that the program began without: never through the modules, which stay to the end.

    A caller whose collector runs keeps its own.
    """
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


def abandon_stdout() -> None:
    """Redirect standard output to the null device, since Python would report the same error again when it flushes at exit."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - lives as long as the process


FAILURE, USAGE = 1, 2

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))
"""Signals that end the program in good order; the status is 128 + the signal's number. SIGHUP tells of a lost terminal."""

BY_TYPER = 130
"""Typer's status, without a word, for an interruption before the command begins."""

TERMINATION_GRACE = 5.0
"""How long a call of a library, an FMU's for example, may keep the program from ending after one of `ENDING` [s]."""


NO_MEMORY = ("failed to map segment", "annot allocate memory", "returned NULL without setting")
"""How the loader of libraries and Python itself say that there is no more memory."""


@contextmanager
def orderly_termination() -> Iterator[None]:
    """Signals of `ENDING` end the program like Ctrl-C: results so far are written, temporary folders removed.

    Without that, folders with unpacked FMUs would stay. A program that hangs in a library's call ends all the same. A signal that is
    ignored, SIGHUP under nohup, stays so.
    """
    handled = [each for each in ENDING if signal.getsignal(each) is signal.SIG_DFL]
    asked: list[int] = []

    def interrupt(number: int, _: object) -> Never:
        asked.append(number)
        raise KeyboardInterrupt

    def watch(reading: int) -> None:
        """Python calls handlers between its own instructions alone, but writes the signal's number here at once."""
        while number := os.read(reading, 1):
            if number[0] in handled:
                sleep(TERMINATION_GRACE)
                if not asked:
                    show_note("interrupted in a call of a library that hasn't returned")
                    os._exit(128 + number[0])

    # where Python's handler may wait for a library's call, a thread watches as well
    for each in handled:
        signal.signal(each, interrupt)
    if handled and os.name == "posix":
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        Thread(target=watch, args=(reading,), daemon=True).start()
    try:
        yield
    except SystemExit as ended:
        early = ended.code == BY_TYPER
        if early or (asked and not ended.code):  # a library's code can swallow the interruption
            show_note("interrupted")
        if asked or early:
            sys.exit(128 + asked[0] if asked else FAILURE)
        raise


_command = ExitStack()
"""What a command holds to its end."""


def prepared_folder(path: Path) -> OutputFolder:
    """A folder for a command's results, in which no other command works until it ends.

    Raises:
        ResultsError: the folder can't be written, or another command works in it.
    """
    folder = OutputFolder(path)
    _command.enter_context(folder.claimed())
    return folder


BLAS_ROOM = 100e6, 32e6
"""What NumPy's and SciPy's OpenBLAS each reserve [bytes]: in any case, and for each of at most `BLAS_THREADS` threads."""

BLAS_THREADS = 64

FEWEST_FILES = 5
"""Files that every command opens at once, besides the standard ones."""


def has_descriptors() -> bool:
    """Whether as many files can be opened as every command needs."""
    with ExitStack() as stack:
        try:
            for _ in range(FEWEST_FILES):
                stack.callback(os.close, os.open(os.devnull, os.O_RDONLY))
        except OSError as error:
            return error.errno != EMFILE
    return True


def check_room() -> None:
    """Refuse a limit of memory that NumPy and SciPy can't be loaded in: OpenBLAS, once it gets none, asks for ever.

    Raises:
        MemoryError: there is less.
    """
    if sys.platform == "win32":
        return
    import resource
    from mmap import mmap

    stated = os.environ.get("OPENBLAS_NUM_THREADS", "")
    threads = min(int(stated) if stated.isdecimal() else os.cpu_count() or 1, BLAS_THREADS)
    needed = 2 * int(BLAS_ROOM[0] + BLAS_ROOM[1] * threads)
    if resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
        try:
            mmap(-1, needed).close()
        except OSError:
            raise MemoryError from None


_hints: list[str] = []
"""What the scenes of a command suggest, written beside its results: an error stays one line."""


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn every error that a user can meet into one line on standard error and the exit status, and end with the scenes' hints.

    Anything else is a mistake in flexfmu and keeps its traceback. Warnings that concern the user are one line each as well.
    """
    _hints.clear()
    try:
        with warnings.catch_warnings(), _command:
            warnings.showwarning = _showing(warnings.showwarning)
            yield
    except typer.Exit:
        for hint in _hints:
            show_note(f"warning: {hint}")
        raise
    except KeyboardInterrupt as interruption:
        show_note(": ".join(["interrupted", *map(str, interruption.args)]))
        raise typer.Exit(FAILURE) from None
    except (MemoryError, ImportError, SystemError) as error:
        # libraries that can't be loaded for want of memory are told as such by Python's importer
        if not isinstance(error, MemoryError) and not any(each in str(error) for each in NO_MEMORY):
            raise
        show_note("out of memory: raise the limit (ulimit -v), end other programs, or choose fewer processes with -j")
        raise typer.Exit(FAILURE) from error
    except Exception as error:
        status = _exit_status(error)
        if status is None:
            raise
        message = str(error)
        if isinstance(error, OSError):
            message = f"{error.strerror or error}" + (f" ({error.filename})" if error.filename else "")
        show_note(shortened(message))
        raise typer.Exit(status) from error


def show_note(message: str) -> None:
    """Write an error, a warning or a note as one line to standard error, if there is one: a terminal may be lost."""
    stderr: TextIO | None = sys.stderr
    if stderr is not None:
        with suppress(OSError):
            print(f"flexfmu: {' '.join(message.split())}", file=stderr)


def _showing(others: Callable[..., None]) -> Callable[..., None]:
    """Shows a warning that concerns the user without the line of code that it comes from; others as before."""
    from flexfmu.cosim.engine.errors import CostWarning, DataWarning, LearningWarning, LoopWarning, SlaveWarning
    from flexfmu.fmu_build.errors import CacheWarning
    from flexfmu.model.scene.errors import SceneWarning

    def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
        shown = CacheWarning | CostWarning | DataWarning | LearningWarning | LoopWarning | SceneWarning | SlaveWarning
        if issubclass(category, shown):
            show_note(f"warning: {message}")
        else:
            others(message, category, *where)

    return show


def _exit_status(error: Exception) -> int | None:
    """The exit status for an error; None for a mistake in flexfmu.

    The families of errors are imported here: `flexfmu --help` would wait for SciPy otherwise.
    """
    from flexfmu.cosim.engine.errors import CosimError
    from flexfmu.fmu_build.errors import BuildError, MissingCompilerError, PlatformError, SettingError, StartError
    from flexfmu.model.scene.errors import EquilibriumError, SceneError
    from flexfmu.trajectories.errors import TrajectoryError

    if isinstance(error, MissingCompilerError):
        return FAILURE
    if isinstance(error, SceneError | TrajectoryError | InputError | PlatformError | SettingError | StartError):
        return USAGE
    return FAILURE if isinstance(error, CosimError | BuildError | EquilibriumError | OSError) else None


def load_named(source: str, changes: Mapping[str, Any] | None = None) -> Scene:
    """As `flexfmu.model.scene.file.load_scene`; a note names the code that the scene runs from outside its folder, before it runs.

    A scene may come from a stranger, and what it names from anywhere.
    """
    from flexfmu.model.scene.file import load_scene

    scene, near = load_scene(source, changes), Path(source).resolve().parent
    if named := [text for text, place in _code(scene.model_dump()) if near not in Path(place).resolve().parents]:
        show_note(
            f"note: the scene runs code from outside its folder: {', '.join(named)} (--sandbox of run, sweep and compare confines it)"
        )
    return scene


def _code(value: Any) -> Iterator[tuple[str, str]]:
    """Name and place of each file or module of code that is in a scene's plain data."""
    if not isinstance(value, Mapping):
        for each in value if isinstance(value, list | tuple) else ():
            yield from _code(each)
        return
    match value.get("kind"):
        case "fmu":
            yield value["path"], value["path"]
        case "c-function":
            files = value["source"]
            yield from ((each, each) for each in ([files] if isinstance(files, str) else files))
        case "python":
            # where it is imported from: the file in the folder, or else what Python finds
            folder, module = value["folder"], value["source"].partition(":")[0]
            name, file = module.partition(".")[0], os.path.join(folder, f"{module}.py")
            found = (
                None
                if name in sys.builtin_module_names
                else PathFinder.find_spec(name, [*sys.path, folder, os.getcwd()])
            )
            places = [] if found is None else [*(found.submodule_search_locations or [found.origin or ""])]
            for place in [file] if os.path.isfile(file) else places or [""]:
                yield f"{value['source']} ({place or 'of Python'})", place or sys.prefix
    for each in value.values():
        yield from _code(each)


def load_changed(source: str, settings: Sequence[str] | None) -> Scene:
    """A scene from its file or by its name, changed by ``KEY=VALUE`` of the option --set; a note says if its effects are too poor.

    Raises:
        SceneError: as for `flexfmu.model.scene.file.load_scene`; a setting has another form.
    """
    from flexfmu.model.scene.file import basis_hint
    from flexfmu.model.scene.keys import parse_setting

    scene = load_named(source, dict(map(parse_setting, settings or ())))
    if hint := basis_hint(scene):
        _hints.append(f"{hint} ({source})")
    return scene


def own_model(source: str, settings: Sequence[str] | None) -> SymbolicModel | SymbolicBlock | None:
    """The model ``MODEL.py:NAME`` of a Python file, which is run; None for anything else.

    Raises:
        InputError: the file doesn't exist, fails, or has no model of this name, or there are changes by ``--set``.
    """
    own = re.fullmatch(r"(.+\.py)(?::(\w*))?", source)
    if own is None:
        return None
    from flexfmu.cosim.experiment.user_slaves import from_source
    from flexfmu.model.symbolic import SymbolicBlock, SymbolicModel

    path, name = Path(own[1]), own[2] or ""
    if settings:
        raise InputError(f"--set changes a scene; {path} has a model: change it there, or set the FMU's parameters")
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    known = from_source(f"{path.stem}:__dict__", {}, path.parent)
    found = from_source(f"{path.stem}:{name}", {}, path.parent) if name in known else None
    if isinstance(found, SymbolicModel | SymbolicBlock):
        return found
    models = [f"{path}:{each}" for each, value in known.items() if isinstance(value, SymbolicModel | SymbolicBlock)]
    remedy = f"take {' or '.join(models)}" if models else "make one with flexfmu.ode, second_order, lagrangian or dae"
    raise InputError(f"{source} is no model; {remedy}")


def scene_name(source: str, settings: Sequence[str] | None) -> str:
    """The name of a scene, of which nothing else is used.

    Raises:
        SceneError: as for `load_changed`.
    """
    from flexfmu.model.scene.file import load_scene
    from flexfmu.model.scene.keys import parse_setting

    return load_scene(source, dict(map(parse_setting, settings or ()))).name


def load_resolved(source: str, settings: Sequence[str] | None = None, *, keeps_accuracy: bool = False) -> Scene:
    """The scene of `load_changed`, with effects and learning laws chosen where it leaves them open; a note on standard error names them.

    ``keeps_accuracy`` leaves the settings open that ``[accuracy]`` chooses.

    Raises:
        SceneError: as for `load_changed`.
        TrajectoryError: effects are to be chosen along a motion that isn't feasible.
    """
    scene = load_changed(source, settings)
    if (keeps_accuracy and scene.accuracy) or not (scene.is_open or scene.learners):
        return scene
    from flexfmu.cosim.design.effects.choice import resolved_with_answer
    from flexfmu.model.choice_text import choice_sentence

    with progress() as show:
        chosen, answer = resolved_with_answer(scene, show)
    if scene.is_open:
        show_note(choice_sentence(chosen) if answer is None else answer.lines()[0])
    return chosen


LONGEST = 80
"""Characters of a folder's name that are for changes of the scene."""


def check_scene_file(path: Path | None) -> None:
    """Check that a scene can be written there.

    Raises:
        InputError: see `check_file`.
    """
    check_file(path, ".toml", "a scene file")


def check_file(path: Path | None, ending: str, what: str) -> None:
    """Check that a file can be written there, before anything runs.

    Raises:
        InputError: the name has another ending, or is that of a folder; or its folder can't be written.
    """
    if path is None:
        return
    if path.suffix != ending:
        raise InputError(f"{what} ends in {ending}, got {path}: write {path}{ending}")
    if path.is_dir():
        raise InputError(f"{path} is a folder: name a file in it, {path / f'planned{ending}'} for example")
    made = list[Path]()
    try:
        made = OutputFolder(path.parent).prepare()
    except ResultsError as error:
        raise InputError(f"{what} can't be written: {error}") from error
    finally:
        remove_empty(made)


def write_results(
    folder: OutputFolder, recording: Recording, formats: Sequence[str], about: Mapping[str, str]
) -> list[str]:
    """Write the recording in these formats as ``results.<format>``, remove those of an earlier run in others; return their names.

    Raises:
        ResultsError: a file can't be written, with the system's reason.
    """
    from flexfmu.cosim.engine.results import FORMATS

    for name in FORMATS:
        if name in formats:
            recording.write(folder.path / f"results.{name}", about)
        else:
            folder.remove(f"results.{name}")
    return [f"results.{name}" for name in formats]


def files_sentence(files: Sequence[str], folder: Path) -> str:
    """Return where the files are."""
    return f"{', '.join(files[:-1])} and {files[-1]} are in {folder}"


def usual_folder(name: str, settings: Sequence[str] | None, ending: str = "") -> Path:
    """Return the folder of a scene's results: ``results/<name>``; with changes by ``--set`` one of its own, which has them in its name."""
    if not settings:
        return RESULTS / f"{name}{ending}"
    changes = re.sub(r"[^\w.+=-]+", "_", ",".join(settings)).strip("_")
    if len(changes) > LONGEST:
        changes = f"{changes[:LONGEST]}-{sha256(','.join(settings).encode()).hexdigest()[:8]}"
    return RESULTS / f"{name}{ending}-{changes}"
