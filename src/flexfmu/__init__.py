"""A flexible five-bar robot from its scene file to FMUs, co-simulation and metrics.

    import flexfmu

    scene = flexfmu.load_scene("barnard2012-6kg").replace({"payload.mass": 3.0})
    run = flexfmu.run(scene)
    print(flexfmu.measure_run(run)["peak_torque_1"].value, "N.m")

Everything is imported when it is first used, so that ``import flexfmu`` takes milliseconds. Where a function takes a scene, it
takes a `Scene`, the path of a scene file, or the name of a shipped scene. What is not here is in `flexfmu.trajectories`,
`flexfmu.model`, `flexfmu.fmu_build` and `flexfmu.cosim`. The command line: ``python -m flexfmu --help``.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flexfmu.api import build, linearize, modes, plan, run
    from flexfmu.cosim.metrics.metric_table import display
    from flexfmu.cosim.metrics.metrics import measure_run
    from flexfmu.model.scene.file import load_scene
    from flexfmu.model.scene.schema import Scene

    __version__: str

__all__ = ["Scene", "__version__", "build", "display", "linearize", "load_scene", "measure_run", "modes", "plan", "run"]

_HOMES = {
    "Scene": "flexfmu.model.scene.schema",
    "build": "flexfmu.api",
    "display": "flexfmu.cosim.metrics.metric_table",
    "linearize": "flexfmu.api",
    "load_scene": "flexfmu.model.scene.file",
    "measure_run": "flexfmu.cosim.metrics.metrics",
    "modes": "flexfmu.api",
    "plan": "flexfmu.api",
    "run": "flexfmu.api",
}
"""The module that each public name is imported from when it is first used."""

# a wheel holds the packages in this folder; in a clone, which editable installs import from, they are folders at its top
if not os.path.isdir(os.path.join(__path__[0], "model")):
    __path__.append(os.path.dirname(os.path.dirname(__path__[0])))

# hidden from type checkers, which would take any misspelt name for an attribute
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """A public name, imported now (PEP 562).

        Raises:
            AttributeError: it isn't one.
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
        """For completion: the public names too that haven't been used yet."""
        return sorted({*globals(), *__all__})
