"""Small models with known solutions, so that building is tested without the robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import casadi
import pytest

from flexfmu.model import time_derivatives
from flexfmu.model.symbolic import EffectNote, SymbolicModel, Variable

MakeModel = Callable[..., SymbolicModel]

MASS, STIFFNESS, COUPLING, DAMPING, FORCE = 2.0, 800.0, 150.0, 0.0, 3.0


@pytest.fixture(scope="session")
def object_folder(shared_cache: Path) -> Path:
    """Object files that all tests share, so that the runtime is compiled once."""
    folder = shared_cache / "objects"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@pytest.fixture(autouse=True)
def cache_folder(tmp_path: Path, object_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Every test has a cache of its own, but for the object files."""
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    (folder / "objects").symlink_to(object_folder, target_is_directory=True)
    monkeypatch.setenv("FLEXFMU_CACHE", str(folder))
    return folder


@pytest.fixture(scope="session")
def make_oscillators() -> MakeModel:
    """Function that makes `oscillators`, with other names and values on request."""
    return oscillators


@pytest.fixture(scope="session")
def make_lever() -> MakeModel:
    """Function that makes `lever`."""
    return lever


def oscillators(name: str = "oscillators", mass: float = MASS, static_start: bool = True) -> SymbolicModel:
    """Two equal masses on springs, coupled by a third spring, a force on the first.

    M y'' + C y' + K y = B u with M = m I, K = [[k + c, -c], [-c, k + c]], C = t K, B = [1, 0].
    """
    p = casadi.SX.sym("p", 5)
    y, v, a = (casadi.SX.sym(symbol, 2) for symbol in "yva")
    u, d = casadi.SX.sym("u", 1), casadi.SX.sym("d", 4)
    K = casadi.vertcat(casadi.horzcat(d[1] + d[2], -d[2]), casadi.horzcat(-d[2], d[1] + d[2]))
    residual = d[0] * a + d[3] * K @ v + K @ y - casadi.vertcat(u, 0)
    outputs = casadi.vertcat(y[0], v[0], a[0], y[1], v[1], a[1], -d[1] * y[0], u * v[0])
    motion = time_derivatives.MotionSymbols(y, v, a, u)
    results = {
        "derive": ([p], p[:4]),
        "initial_inputs": ([p], p[4]),
        "initial_coordinates": ([p], casadi.SX.zeros(2)),
        "start_forward": time_derivatives.forward([p], casadi.vertcat(p[:4], casadi.SX.zeros(2))),
        "residual": ([y, v, a, u, d], residual),
        "mass_matrix": ([y, u, d], d[0] * casadi.SX.eye(2)),
        "outputs": ([y, v, a, u, d], outputs),
        "motion_forward": time_derivatives.motion_forward(motion, residual, outputs, d),
        "motion_rate1": time_derivatives.motion_rate1(motion, residual, outputs, d),
        "motion_rate2": time_derivatives.motion_rate2(motion, residual, outputs, d),
        "singularity": ([y, u, d], casadi.SX(1)),
        "error_scale": ([d], casadi.vertcat(d[1], d[1], d[0], d[0], 1e-6)),
    }
    return SymbolicModel(
        name=name,
        description='Two coupled oscillators, "linear" & undamped',
        unknowns=("first.position", "second.position"),
        inputs=(Variable("force", "N", "Force on the first mass", "input", start=FORCE, minimum=-1e6, maximum=1e6),),
        parameters=(
            Variable("mass", "kg", "Mass of each", "parameter", start=mass, minimum=1e-6),
            Variable("stiffness", "N/m", "Stiffness of the outer springs", "parameter", start=STIFFNESS, minimum=0.0),
            Variable("coupling", "N/m", "Stiffness between the masses", "parameter", start=COUPLING, minimum=0.0),
            Variable("damping.time", "s", "Damping is this times stiffness", "parameter", start=DAMPING, tunable=True),
            Variable("start.force", "N", "Force that holds where none is set", "parameter", start=FORCE),
        ),
        outputs=(
            *_motion("first"),
            *_motion("second"),
            Variable("first.spring_force", "N", "Force of the first spring", "output", nominal=10.0),
            Variable("power", "W", "Power of the force", "output"),
        ),
        functions={key: _function(key, *result) for key, result in results.items()},
        acceleration_terms=time_derivatives.acceleration_terms(motion, outputs),
        feedthrough=dict.fromkeys((f"{name}.position" for name in ("first", "second")), ())
        | dict.fromkeys(("der(first.position)", "der(second.position)", "der(second.position,2)"), ())
        | {"der(first.position,2)": ("force",), "first.spring_force": (), "power": ("force",)},
        static_start=static_start,
        margin_name="distance to nothing",
        minimum_margin=0.5,
        effects=(EffectNote("springs", "Three linear springs."),),
    )


def lever(name: str = "lever") -> SymbolicModel:
    """A rigid lever: no unknowns, the output is the input times the ratio."""
    empty = [casadi.SX.sym(symbol, 0) for symbol in "yva"]
    p, u, d = (casadi.SX.sym(symbol, 1) for symbol in "pud")
    none, motion = casadi.SX(0, 1), time_derivatives.MotionSymbols(*empty, u)
    results = {
        "derive": ([p], p),
        "initial_inputs": ([p], casadi.SX(0)),
        "initial_coordinates": ([p], none),
        "start_forward": time_derivatives.forward([p], p),
        "residual": ([*empty, u, d], none),
        "mass_matrix": ([empty[0], u, d], casadi.SX(0, 0)),
        "outputs": ([*empty, u, d], d * u),
        "motion_forward": time_derivatives.motion_forward(motion, none, d * u, d),
        "motion_rate1": time_derivatives.motion_rate1(motion, none, d * u, d),
        "motion_rate2": time_derivatives.motion_rate2(motion, none, d * u, d),
        "singularity": ([empty[0], u, d], casadi.SX(1)),
        "error_scale": ([d], casadi.SX(1)),
    }
    return SymbolicModel(
        name=name,
        description="A rigid lever",
        unknowns=(),
        inputs=(Variable("angle", "rad", "Angle in", "input", start=0.0),),
        parameters=(Variable("ratio", "1", "Transmission", "parameter", start=2.0),),
        outputs=(Variable("angle_out", "rad", "Angle out", "output"),),
        functions={key: _function(key, *result) for key, result in results.items()},
        acceleration_terms=(),
        feedthrough={"angle_out": ("angle",)},
        static_start=True,
        margin_name="distance to nothing",
        minimum_margin=0.0,
    )


def _motion(which: str) -> tuple[Variable, ...]:
    name = f"{which}.position"
    return (
        Variable(name, "m", f"Position of the {which} mass", "output"),
        Variable(f"der({name})", "m/s", f"Velocity of the {which} mass", "output", derivative_of=name),
        Variable(f"der({name},2)", "m/s2", f"Acceleration of the {which} mass", "output", derivative_of=f"der({name})"),
    )


def _function(name: str, arguments: list[casadi.SX], result: casadi.SX) -> casadi.Function:
    return casadi.Function(name, arguments, [casadi.densify(result)])
