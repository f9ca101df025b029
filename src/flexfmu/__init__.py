"""Scene files of a flexible five-bar robot, turned into FMUs, co-simulations and metrics.

    import flexfmu

    scene = flexfmu.load_scene("barnard2012-6kg").replace({"payload.mass": 3.0})
    run = flexfmu.run(scene)
    print(run.metrics.peak_torque_1, run.metrics.peak_torque_1.unit)

Every argument ``scene`` is a `Scene`, the path of a scene file, or the name of a shipped scene. Parts of the loop are in
`flexfmu.control`, `flexfmu.shapers`, `flexfmu.imperfections`, `flexfmu.filters` and `flexfmu.disturbances`, motions from elsewhere
in `flexfmu.motions`. Names are imported at their first use, so that ``import flexfmu`` takes milliseconds. Command line: ``python -m flexfmu --help``.
"""

import os
from importlib import import_module

_NAMES = {
    "api": "build compare frequency_response identify linearize margins modes plan_motion propose_motions reference_motion run start_gains sweep tune",
    "cosim.control.controllers.own_function": "controller",
    "cosim.design.effects.study": "study_effects",
    "cosim.design.response.response": "FrequencyResponse",
    "cosim.engine.errors": "AlgebraicLoopError FmuFileError InputError LoopWarning ResultsError RunWarning SlaveError WiringError",
    "cosim.engine.results": "Selection",
    "cosim.engine.slave": "SlaveVariable",
    "cosim.exchange.slave_export": "export_slaves",
    "cosim.exchange.ssp.export": "export_ssp",
    "cosim.exchange.ssp.loading": "load_ssp",
    "cosim.experiment.metric": "Metric RunMetrics",
    "cosim.experiment.scene_run": "Run",
    "cosim.many.variants": "run_variants",
    "cosim.metrics.metric_table": "display",
    "cosim.metrics.metrics": "measure_run",
    "cosim.metrics.motors": "motor_loads",
    "cosim.metrics.stress": "link_stresses",
    "errors": "Error",
    "fmu_build.errors": "BuildError MissingCompilerError",
    "fmu_build.own_models": "dae event lagrangian ode part second_order variable",
    "model.scene.errors": "EquilibriumError SceneError SceneWarning",
    "model.scene.file": "load_scene",
    "model.scene.motor": "Motor",
    "model.scene.schema": "Scene",
    "systems": "simulate slave",
    "trajectories.errors": "TrajectoryError",
}
"""Module → public names that are imported from it at their first use."""

_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

_FAMILIES = ("control", "disturbances", "filters", "imperfections", "motions", "shapers")
"""Modules with parts of a scene, `flexfmu.control.pd` ..."""

__all__ = sorted((*_FAMILIES, *_HOMES, "__version__"))

# in a wheel the packages are in this folder; in a clone (editable installs) they are in the clone's top folder
if not os.path.isdir(os.path.join(__path__[0], "model")):
    __path__.append(os.path.dirname(os.path.dirname(__path__[0])))


def __getattr__(name: str) -> object:
    """Import a public name at its first use and return its value (PEP 562).

    Raises:
        AttributeError: there is no such public name.
    """
    if name == "__version__":
        value = import_module("importlib.metadata").version("flexfmu")
    elif name in _FAMILIES:
        value = import_module(f"flexfmu.{name}")
    elif name in _HOMES:
        value = getattr(import_module(f"flexfmu.{_HOMES[name]}"), name)
    elif name == "plan":
        import_module("warnings").warn(
            "flexfmu.plan is called flexfmu.reference_motion now", DeprecationWarning, stacklevel=2
        )
        return __getattr__("reference_motion")
    else:
        raise AttributeError(f"module 'flexfmu' has no attribute {name!r}; it has {', '.join(__all__)}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, for completion; most are imported at their first use."""
    return sorted(__all__)
