"""Compiled integrators of other people on the generated functions of our FMU: Hairer and Wanner's RADAU5 (Fortran), IDA and ARKODE of
SUNDIALS (C), with exact Jacobians, compiled for this processor at -O3.

RADAU5 comes from the sources of the package Assimulo on PyPI, SUNDIALS from Debian's libsundials-dev, the compiler from Debian's
gfortran; nothing of them is part of this project. Sources: Hairer and Wanner, Solving Ordinary Differential Equations II, sec. IV.8;
Hindmarsh et al., SUNDIALS, ACM Trans. Math. Softw. 31 (2005).
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from ctypes import CDLL, Structure, byref, c_double, c_int, c_void_p
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from flexfmu.cosim.engine.master.grid import time_grid
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.engine.trajectory_slave import TrajectorySlave
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.scene_loop import loop_of
from flexfmu.cosim.studies.workprec.trial import RunError, SceneUnderTest, sweep
from flexfmu.fmu_build.cache import cached, content_hash, read_cached, store
from flexfmu.fmu_build.codegen import c_code
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.source_generation import generate_sources
from flexfmu.fmu_build.toolchain import COMMON_FLAGS, find_compiler, native_platform
from flexfmu.model.plants import build_model
from flexfmu.model.scene.controllers import PdSection
from flexfmu.model.scene.schema import Scene
from flexfmu.model.statics import natural_frequencies
from flexfmu.model.symbolic import SymbolicModel

PACKAGE, FILE = "Assimulo==3.0", "radau_decsol.f"
"""Where RADAU5 comes from: a package's sources on PyPI, and a file in them."""

SOURCE = f"peers/{content_hash([PACKAGE.encode(), FILE.encode()])}.f"
"""Its name in the cache."""

FLAGS = ("-O3", "-march=native", "-fPIC", "-w")
"""For everything that is compiled, ours too."""

CALLED = re.compile(
    r"peer|elementary|(inputs|equations|linear_algebra|plant|model_(derive|residual|mass_matrix|outputs))\.c"
)
"""In the names of files that peers call; the others needn't be fast."""

LIBRARIES = ("-lsundials_ida", "-lsundials_arkode", "-lsundials_nvecserial", "-lsundials_sunlinsoldense", "-lm")

PeerSetting = tuple[str, int, float, float]

SETTINGS: Mapping[str, Sequence[PeerSetting]] = {
    "RADAU5": [("explicit, its own settings", 0, 1e-3, 0.0), ("index 1, kept Jacobian", 1, 0.1, 0.1)],
    "SUNDIALS IDA": [("", 2, 0.0, 0.0)],
    "SUNDIALS ARKODE, DIRK5": [("", 3, 0.0, 0.0)],
}
"""Peer → its settings: what they are called, number of the solver in `compiled_peer.c`, and for RADAU5 the contraction above which it
evaluates the Jacobian anew, and the share of the tolerance that iterations may leave, 0 for its own choice. Of those that were tried
the second one is the fastest at every error, by up to a half."""

TOLERANCES = tuple(float(f"1e-{power}") for power in range(1, 13))
"""Tolerances, from which a sweep takes as many as it needs."""

REPEAT = 5
"""Runs of which the fastest counts."""


class PeerMissingError(RunError):
    """A peer or its compiler can't be had here; the message says what to install."""


class _Task(Structure):
    """`peer_task` in ``compiled_peer.c``."""

    _fields_ = (
        ("solver", c_int),
        ("tolerance", c_double),
        ("renewal", c_double),
        ("newton", c_double),
        ("pace", c_double),
        ("n_points", c_int),
        ("n_orders", c_int),
        ("times", c_void_p),
        ("restarts", c_void_p),
        ("recorded", c_void_p),
        ("polynomials", c_void_p),
        ("references", c_void_p),
        ("proportional", c_double * 2),
        ("derivative", c_double * 2),
    )


@dataclass(frozen=True)
class PeerRun:
    """All outputs of a run at its recorded instants: (N,) [s], name → (N,); processor time [s]; steps of the integrator."""

    instants: RealArray
    outputs: Mapping[str, RealArray]
    time: float
    steps: int


class CompiledPeers:
    """The integrators on the equations of a scene: motion-driven, or torque-driven under one PD controller.

    Args:
        scene: the scene.
        step: spacing of the recorded instants [s].

    Raises:
        RunError: the scene has something else, or the peers don't compile.
    """

    def __init__(self, scene: Scene, step: float = 1e-3) -> None:
        loop, model = loop_of(scene), build_model(scene)
        _refuse(scene, model)
        references = TrajectorySlave(loop.motion.joints)
        self.outputs, self._library = [each.name for each in model.outputs], _library(scene)
        self._arrays: dict[str, NDArray[Any]] = {}
        self._gains: tuple[Sequence[float], Sequence[float]] = ((0.0, 0.0), (0.0, 0.0))
        q1, q2 = loop.motion.joints.evaluate(0.0, 0)[0, 0]
        self._pace = 2.0 * np.pi * float(natural_frequencies(scene, (float(q1), float(q2)))[0])
        if scene.controller:
            # a sample at every point, with the references there
            (section,) = scene.controller
            assert isinstance(section, PdSection)
            self._gains = (section.proportional, section.derivative)  # of both joints
            grid = time_grid(0.0, loop.motion.stop_time, section.sample_time)
            references.prepare(grid.times)
            values = references.announced[:, 0, :4].copy()
            self._arrays = {"restarts": np.ones(grid.times.size, np.int32), "references": values}
        else:
            grid = time_grid(0.0, loop.motion.stop_time, step, references.breakpoints)
            references.prepare(grid.times)
            self._arrays = {"restarts": grid.marked.astype(np.int32), "polynomials": references.announced.copy()}
        ratio = grid.times / step
        recorded = abs(ratio - np.rint(ratio)) < 1e-9
        self._arrays |= {"times": grid.times.copy(), "recorded": recorded.astype(np.int32)}
        self.instants = grid.times[recorded]

    def run(self, setting: PeerSetting, tolerance: float, repeat: int = REPEAT) -> PeerRun:
        """One run with one of `SETTINGS`.

        Raises:
            RunError: the integrator fails.
        """
        orders = self._arrays["polynomials"].shape[1] if "polynomials" in self._arrays else 1
        pointers = {name: each.ctypes.data for name, each in self._arrays.items()}
        _, solver, renewal, newton = setting
        numbers = {"solver": solver, "tolerance": tolerance, "renewal": renewal, "newton": newton, "pace": self._pace}
        sizes = {"n_points": self._arrays["times"].size, "n_orders": orders}
        gains = {
            name: (c_double * 2)(*each) for name, each in zip(("proportional", "derivative"), self._gains, strict=True)
        }
        task = _Task(**numbers, **sizes, **pointers, **gains)
        records, figures = np.zeros((self.instants.size, len(self.outputs))), np.zeros(3)
        arguments = (c_void_p(each.ctypes.data) for each in (records, figures))
        failed = self._library.peer_run(byref(task), repeat, *arguments)
        if failed or not np.isfinite(records).all():
            raise RunError("the integrator failed")
        return PeerRun(
            self.instants, dict(zip(self.outputs, records.T, strict=True)), float(figures[0]), int(figures[1])
        )


def _refuse(scene: Scene, model: SymbolicModel) -> None:
    """Refuse what the peers don't have."""
    is_torque, sections = scene.cosimulation.drive == "torque", scene.controller
    pd = sections[0] if len(sections) == 1 and isinstance(sections[0], PdSection) else None
    further = any((scene.filter, scene.imperfection, scene.disturbance, model.frictions))
    is_plain = pd is not None and pd.torque_limit is None and pd.schedule is None
    if further or is_torque != is_plain or bool(sections) != is_torque:
        raise RunError(
            "compiled peers have prescribed joints or one PD controller alone, without limits, filters and friction"
        )
    if not model.degrees_of_freedom:
        raise RunError("compiled peers need something to integrate: the links are rigid")


def _library(scene: Scene) -> CDLL:
    """The compiled library, from the cache where it is there."""
    # the FMU's sources, the exact Jacobian of the residual, and the peers
    model = build_model(scene)
    sources = generate_sources(model, DefaultExperiment())
    residual = model.functions["residual"]
    arguments = [casadi.SX.sym(f"x{i}", residual.sparsity_in(i)) for i in range(residual.n_in())]
    value = residual.call(arguments)[0]
    by_motion = casadi.densify(casadi.cse(casadi.horzcat(*(casadi.jacobian(value, arguments[i]) for i in range(2)))))
    texts = sources.generated | sources.runtime
    texts |= {
        "peer_jacobian.c": c_code(casadi.Function("peer_jacobian", arguments, [by_motion])),
        "compiled_peer.c": Path(__file__).with_name("compiled_peer.c").read_text(encoding="utf-8"),
    }
    radau, defines, libraries = read_cached(SOURCE), [], ["-lm"]
    compiler = find_compiler(native_platform())
    fortran = shutil.which("gfortran")
    if radau and fortran:
        defines.append("-DPEER_RADAU")
    if _has_sundials(compiler.command):
        defines.append("-DPEER_SUNDIALS")
        libraries = [*LIBRARIES]
    parts = (*FLAGS, *defines, compiler.identity(), *(text for file in sorted(texts) for text in (file, texts[file])))
    name = f"peers/{content_hash(part.encode() for part in parts)}.so"
    if (found := cached(name)) is not None:
        return CDLL(str(found))
    with TemporaryDirectory(prefix="flexfmu-peers-") as folder:
        for file, text in texts.items():
            (Path(folder) / file).write_text(text, encoding="utf-8")
        files = sorted(file for file in texts if file.endswith(".c"))
        for optimisation, is_called in (([], True), (["-O0"], False)):
            chosen = [file for file in files if bool(CALLED.search(file)) is is_called]
            flags = [*COMMON_FLAGS, *FLAGS, *defines, "-ffp-contract=fast", *optimisation]
            _call([*compiler.command, *flags, "-c", *chosen], folder)
        objects = [f"{Path(file).stem}.o" for file in files]
        if "-DPEER_RADAU" in defines:
            (Path(folder) / "radau5.f").write_bytes(radau or b"")
            _call([str(fortran), *FLAGS, "-std=legacy", "-c", "radau5.f"], folder)
            objects.append("radau5.o")
            libraries.append("-lgfortran")
        _call([*compiler.command, "-shared", *objects, "-o", "peers.so", *libraries], folder)
        return CDLL(str(store(name, (Path(folder) / "peers.so").read_bytes())))


def _call(command: Sequence[str], folder: str) -> None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line.lower()] or done.stderr.splitlines()
        raise RunError(f"the peers don't compile: {' '.join(lines[:1])}")


def _has_sundials(compiler: Sequence[str]) -> bool:
    """Whether the compiler finds SUNDIALS."""
    text = "#include <ida/ida.h>\n#include <arkode/arkode_arkstep.h>\n"
    done = subprocess.run([*compiler, "-E", "-"], input=text, capture_output=True, text=True, check=False)
    return done.returncode == 0


def fetch() -> None:
    """Bring RADAU5 into the cache, where it isn't there yet.

    Raises:
        PeerMissingError: pip can't download its package.
    """
    if read_cached(SOURCE) is not None:
        return
    with TemporaryDirectory(prefix="flexfmu-peers-") as folder:
        # the package is too old to be prepared for installation: what pip has unpacked is all that is needed
        options = (
            "--no-clean",
            "--no-deps",
            "--no-binary",
            ":all:",
            "--no-build-isolation",
            "--quiet",
            "--dest",
            folder,
        )
        pip = [sys.executable, "-m", "pip"] if find_spec("pip") else [shutil.which("pip") or "pip3"]
        with suppress(FileNotFoundError):
            command = [*pip, "download", *options, PACKAGE]
            subprocess.run(command, env=os.environ | {"TMPDIR": folder}, capture_output=True, check=False)
        for path in Path(folder).rglob(FILE):
            store(SOURCE, path.read_bytes())
            return
    raise PeerMissingError(
        f"RADAU5 can't be had: pip can't download {PACKAGE} from PyPI; its other lines don't need it"
    )


def missing(peer: str) -> str:
    """What to install or to run for a peer; empty where nothing is missing."""
    if peer == "RADAU5":
        if shutil.which("gfortran") is None:
            return "gfortran isn't installed: apt-get install gfortran"
        return (
            ""
            if read_cached(SOURCE)
            else "RADAU5 isn't there: python -m flexfmu.benchmarks.peers.compiled_peer fetches it"
        )
    has_sundials = _has_sundials(find_compiler(native_platform()).command)
    return "" if has_sundials else "SUNDIALS isn't installed: apt-get install libsundials-dev"


def compiled_trials(subject: SceneUnderTest, ours: WorkCurve) -> Iterator[WorkPrecisionTrial]:
    """Trials of all compiled peers with the generated functions of our FMU; a peer that is missing is a failed trial."""
    for line, settings in SETTINGS.items():
        if note := missing(line):
            yield WorkPrecisionTrial("tools", line, "", None, None, note)
            continue
        try:
            peers = CompiledPeers(subject.scene)
        except RunError as failure:
            yield WorkPrecisionTrial("tools", line, "", None, None, str(failure))
            continue
        for setting in settings:
            yield from sweep(TOLERANCES, partial(_trial, subject, peers, line, setting), ours)


def _trial(
    subject: SceneUnderTest, peers: CompiledPeers, line: str, setting: PeerSetting, tolerance: float
) -> WorkPrecisionTrial:
    def measure() -> tuple[float, float, str]:
        run = peers.run(setting, tolerance)
        return subject.error(positions(run)), run.time, f"{run.steps} steps"

    return subject.trial("tools", line, f"{tolerance:.0e} {setting[0]}".strip(), measure)


def positions(run: PeerRun) -> RealArray:
    """(N, 2) positions of the end effector [m] at the instants after the start."""
    return np.stack([run.outputs[f"end_effector.position.{axis}"][1:] for axis in "xy"], axis=1)


if __name__ == "__main__":
    try:
        fetch()
    except PeerMissingError as failure:
        sys.exit(str(failure))
