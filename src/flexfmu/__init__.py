"""Scene files of a flexible five-bar robot, turned into FMUs, co-simulations and metrics.

    import flexfmu

    scene = flexfmu.load_scene("barnard2012-6kg").replace({"payload.mass": 3.0})
    run = flexfmu.run(scene)
    print(run.metrics.peak_torque_1, run.metrics.peak_torque_1.unit)

Every argument ``scene`` is a `Scene`, the path of a scene file, or the name of a shipped scene. Further functions and classes
are in `flexfmu.trajectories`, `flexfmu.model`, `flexfmu.fmu_build` and `flexfmu.cosim`. Names are imported at their first use,
so that ``import flexfmu`` takes milliseconds. Command line: ``python -m flexfmu --help``.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flexfmu.api import build, compare, linearize, margins, modes, plan, plan_motion, run, start_gains, sweep, tune
    from flexfmu.cosim.control.controllers.own_function import controller
    from flexfmu.cosim.metrics.metric_table import display
    from flexfmu.cosim.metrics.metrics import measure_run
    from flexfmu.cosim.metrics.motors import motor_loads
    from flexfmu.cosim.metrics.run_metrics import RunMetrics
    from flexfmu.cosim.metrics.stress import link_stresses
    from flexfmu.model.scene.file import load_scene
    from flexfmu.model.scene.motor import Motor
    from flexfmu.model.scene.schema import Scene

    __version__: str

__all__ = [
    "Motor",
    "RunMetrics",
    "Scene",
    "__version__",
    "build",
    "compare",
    "controller",
    "display",
    "linearize",
    "link_stresses",
    "load_scene",
    "margins",
    "measure_run",
    "modes",
    "motor_loads",
    "plan",
    "plan_motion",
    "run",
    "start_gains",
    "sweep",
    "tune",
]

_HOMES = dict.fromkeys(__all__, "flexfmu.api") | {
    "Motor": "flexfmu.model.scene.motor",
    "RunMetrics": "flexfmu.cosim.metrics.run_metrics",
    "Scene": "flexfmu.model.scene.schema",
    "controller": "flexfmu.cosim.control.controllers.own_function",
    "display": "flexfmu.cosim.metrics.metric_table",
    "link_stresses": "flexfmu.cosim.metrics.stress",
    "load_scene": "flexfmu.model.scene.file",
    "measure_run": "flexfmu.cosim.metrics.metrics",
    "motor_loads": "flexfmu.cosim.metrics.motors",
}
"""Public name → module that it is imported from at its first use."""

# in a wheel the packages are in this folder; in a clone (editable installs) they are in the clone's top folder
if not os.path.isdir(os.path.join(__path__[0], "model")):
    __path__.append(os.path.dirname(os.path.dirname(__path__[0])))

# hidden from type checkers, which would otherwise accept every misspelt name
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a public name at its first use and return its value (PEP 562).

        Raises:
            AttributeError: there is no such public name.
        """
        if name == "__version__":
            value = import_module("importlib.metadata").version("flexfmu")
        elif name in _HOMES:
            value = getattr(import_module(_HOMES[name]), name)
        else:
            raise AttributeError(f"module 'flexfmu' has no attribute {name!r}; it has {', '.join(__all__)}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """Names for completion, including public names that have not been imported yet."""
        return sorted({*globals(), *__all__})
