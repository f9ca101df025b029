"""The rooms of the house: what each may know, no circles, and imports at the top."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from runpy import run_path

import pytest

ROOT = Path(__file__).parents[1]

ROOMS = (
    "trajectories",
    "model.scene",
    "model",
    "model.selection",
    "model.reference_design",
    "model.finite_elements",
    "fmu_build",
    "fmu_build.validation",
    "cosim.engine",
    "cosim.control",
    "cosim.experiment",
    "cosim.metrics",
    "cosim.many",
    "cosim.reports",
    "cosim.design",
    "cosim.exchange",
    "cosim.studies",
    "cosim.cli",
)
"""From the bottom up; a room in cosim may know all before it, but for what `UNKNOWN` says."""

BESIDE = ("model.scene", "model.selection", "model.reference_design", "model.finite_elements")
UNKNOWN: Mapping[str, tuple[str, ...]] = {
    "trajectories": (),
    "model.finite_elements": ("model.selection", "model.reference_design"),
    "fmu_build": BESIDE,
    "fmu_build.validation": ("trajectories", "model", *BESIDE),
    "cosim.engine": ("model", *BESIDE),
}
"""Room → rooms below it that it must not know."""

TYPES = ("model.symbolic", "model.contract", "model.time_derivatives")
"""All that `fmu_build` knows of the model: the types of what it is given, and the functions of any model from its equations."""

OPTIONAL = ("distributed", "exudyn", "mcap", "pandas", "pyarrow", "ruckig", "toppra", "xarray")
"""Libraries that a user may not have or seldom needs: they may be imported within functions."""

HEAVY = (*OPTIONAL, "casadi", "control", "matplotlib", "fmpy", "lief")
"""What a light module may put off loading, by an import within a function of what needs it."""

SLOW = ("scipy", "threadpoolctl", "concurrent", "html", "jinja2")
"""What takes as long to load as a scene takes to read, or loads `logging`: functions that runs don't need may import it."""

SELDOM = (
    "trajectories.shapers",
    "cosim.control",
    "cosim.experiment.cycles",
    "cosim.experiment.table_motion",
    "cosim.metrics.metrics",
    "trajectories.sources",
    "trajectories.table",
    "model.reference_design",
    "model.symbolic",
)
"""What a run whose metrics aren't asked for, without shapers, controllers, imperfections, cycles, references for the flexible robot, own
motions and tables doesn't load: functions that need it may
import it."""


PLUG_INS = ("cosim.cli", "cosim.control.controllers", "fmu_build.validation")
"""Folders of which a module is one command, kind of controller, file format, or check: one place lists them all."""

ALONE = {
    "cosim.control": "the front door names what is in it",
    "cosim.control.disturbances": "blocks of disturbances, and sums for the loop",
    "cosim.design.gains.search": "the optimiser",
    "cosim.design.identification.spectra": "experiments about an equilibrium",
    "cosim.design.margins.measured_loop": "a loop around a measured plant",
    "cosim.design.margins.pictures": "drawing",
    "cosim.design.plans.search": "a method of the planner",
    "cosim.design.response.modal_fit": "modes of a response",
    "cosim.design.shapers.figure": "drawing",
    "cosim.engine.master.program_image": "a run for a WebAssembly module",
    "cosim.engine.fmu.transfers": "values in and out of FMUs",
    "cosim.exchange.wrap": "an integrator around FMUs for model exchange",
    "cosim.experiment.table_motion": "motions from files",
    "cosim.studies.paper.figures": "drawing",
    "cosim.studies.paper.report": "a command",
    "cosim.studies.sweep.picture": "drawing",
    "cosim.studies.workprec.figures": "drawing",
    "cosim.studies.workprec.solver_trials": "other solvers and equations for them, which hard cases use too",
    "fmu_build.own_assembly": "the contract from checked equations",
    "fmu_build.source_generation": "generates an FMU's sources, with CasADi",
    "fmu_build.twins": "pairs of lanes in C",
    "model.finite_elements.motion": "time integration",
    "model.multipliers": "the second form of the equations",
    "model.reference_design.quadratic_programme": "a solver that knows no robot",
}
"""Modules with one importer that are an idea of their own, and which."""


@dataclass(frozen=True)
class Module:
    """A module below `flexfmu`, with the modules and packages that it imports: at the top, within functions, for types alone."""

    name: str
    top: set[str] = field(default_factory=set)
    late: set[str] = field(default_factory=set)
    types: set[str] = field(default_factory=set)

    @property
    def known(self) -> set[str]:
        """Modules of flexfmu that it imports anywhere."""
        return {each for each in self.top | self.late | self.types if not each.startswith("!")}


def _imported(node: ast.AST, names: set[str]) -> Iterator[str]:
    """Modules of flexfmu that a statement imports, below `flexfmu`; others with "!" before the name of the library."""
    if isinstance(node, ast.Import):
        yield from (f"!{each.name.partition('.')[0]}" for each in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module is not None:
        top, _, base = node.module.partition(".")
        if top != "flexfmu":
            yield f"!{top}"
            return
        for each in node.names:
            full = f"{base}.{each.name}".lstrip(".")
            yield full if full in names else base


def _read(path: Path, name: str, names: set[str]) -> Module:
    """The imports of one file."""
    module = Module(name)

    def visit(node: ast.AST, kind: set[str]) -> None:
        kind.update(_imported(node, names))
        for child in ast.iter_child_nodes(node):
            inside = isinstance(node, ast.FunctionDef | ast.Lambda)
            for_types = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
            visit(child, module.late if inside else module.types if for_types else kind)

    visit(ast.parse(path.read_text(encoding="utf-8")), module.top)
    return module


@pytest.fixture(scope="module")
def modules() -> Mapping[str, Module]:
    """All modules by name, packages by that of their folder."""
    paths = [path for top in ("trajectories", "model", "fmu_build", "cosim") for path in (ROOT / top).rglob("*.py")]
    named = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}
    return {name: _read(path, name, set(named)) for name, path in named.items()}


def _room(module: str) -> str | None:
    """The innermost room of a module; None for the package `cosim` itself."""
    return max((room for room in ROOMS if f"{module}.".startswith(f"{room}.")), key=len, default=None)


def test_every_module_has_a_room(modules: Mapping[str, Module]) -> None:
    """A new folder needs a place in the order."""
    assert [name for name in modules if _room(name) is None] == ["cosim"]


def test_every_room_says_what_it_is_for() -> None:
    """The docstring of its `__init__.py` is its charter."""
    for folder in {
        path.parent for top in ("trajectories", "model", "fmu_build", "cosim") for path in (ROOT / top).rglob("*.py")
    }:
        charter = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
        assert len(charter or "") > 20, folder


def test_imports_run_one_way(modules: Mapping[str, Module]) -> None:
    """From room to room, whoever needs something from above gets it passed in."""
    wrong = []
    for module in modules.values():
        room = _room(module.name)
        if room is None:
            continue
        for known in module.known:
            other = _room(known)
            if other is None or other == room or (room == "fmu_build" and known in TYPES):
                continue
            may_not = UNKNOWN.get(room, ())
            if ROOMS.index(other) > ROOMS.index(room) or other in may_not or (room == "fmu_build" and other == "model"):
                wrong.append(f"{module.name} imports {known}")
    assert wrong == []


def test_nothing_uses_the_front_door(modules: Mapping[str, Module]) -> None:
    """It is above all rooms: whoever needs something from above gets it passed in."""
    doors = {"!flexfmu", "", "api"}
    assert [each.name for each in modules.values() if doors & (each.top | each.late | each.types)] == []


def test_no_circles_between_files(modules: Mapping[str, Module]) -> None:
    """Neither at the top nor within functions nor for types."""
    try:
        TopologicalSorter({name: module.known - {name} for name, module in modules.items()}).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_imports_stand_at_the_top(modules: Mapping[str, Module]) -> None:
    """But for the command line's, and for what a heavy library is kept out by: a run of a cached FMU needs no CasADi."""

    def needs(libraries: tuple[str, ...], name: str, seen: set[str]) -> bool:
        """Whether the import of a module, or a library with "!" before its name, loads one of these."""
        if name.startswith("!"):
            return name[1:] in libraries
        if name in seen or name not in modules:
            return False
        seen.add(name)
        return any(needs(libraries, each, seen) for each in modules[name].top)

    def may_wait(late: str, module: Module) -> bool:
        # a heavy library that the top of the module does without
        loaded = {heavy for heavy in HEAVY if any(needs((heavy,), each, {module.name}) for each in module.top)}
        light = any(needs((heavy,), late, set()) for heavy in set(HEAVY) - loaded)
        seldom = any(f"{late}.".startswith(f"{each}.") for each in SELDOM)
        return light or seldom or needs((*OPTIONAL, *SLOW), late, set())

    wrong = [
        f"{module.name} imports {late} within a function"
        for module in modules.values()
        for late in module.late
        if _room(module.name) != "cosim.cli" and not may_wait(late, module)
    ]
    assert wrong == []


@pytest.fixture(scope="module")
def shared_names() -> tuple[list[str], dict[str, list[str]]]:
    """Modules with one importer, and class names with several homes, as `make lint` counts them."""
    module = run_path(str(ROOT / "generators" / "size.py"))
    names: tuple[list[str], dict[str, list[str]]] = module["shared_names"](module["parse"]()[2])
    return names


def test_a_class_name_means_one_thing(shared_names: tuple[list[str], dict[str, list[str]]]) -> None:
    """No two public classes have one name: rename one, or let one replace the other."""
    assert shared_names[1] == {}


def test_a_module_serves_several(shared_names: tuple[list[str], dict[str, list[str]]]) -> None:
    """A module with one importer is a plug-in, or is listed with its reason: else it joins its importer; the front door's are its parts."""
    names = [each.removeprefix("flexfmu.") for each in shared_names[0]]
    single = {each for each in names if "." in each and not each.startswith(tuple(f"{folder}." for folder in PLUG_INS))}
    assert single == ALONE.keys()
