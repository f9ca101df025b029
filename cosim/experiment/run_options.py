"""The options of a run, each said once: the functions that run scenes take them as keywords, the command line shows their help."""

# no annotations from __future__: the command line reads them, and loads none of the types in quotes
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypedDict

if TYPE_CHECKING:
    from flexfmu.cosim.engine.results import Selection


class Option(NamedTuple):
    """What an option is for, with its default, and its unit or what it takes."""

    help: str
    takes: str = ""


class SceneOptions(TypedDict, total=False):
    """How a scene is prepared for its runs; what is left out, or None, is as the scene says."""

    communication_step: Annotated[
        float | None,
        Option("Communication step. Default: what the scene or file says.", "SECONDS"),
    ]
    tolerance: Annotated[float | None, Option("Relative tolerance of the FMU's integrator.")]
    input_order: Annotated[
        int | None,
        Option("Degree of the input polynomials, 0 (values only) to 9. Default: the highest that the FMU supports."),
    ]
    fmu_path: Annotated[
        Path | None,
        Option(
            "FMU of a scene with the same effects, instead of building one; its parameters are set from this scene."
        ),
    ]
    initial: Annotated[str | None, Option("`static` or `undeformed`.")]
    record: Annotated["Selection | None", Option("Which signals are recorded, how often, with how many derivatives.")]
    isolate: Annotated[
        bool | None,
        Option(
            "Simulate in a child process, so that a slave that crashes, exits or hangs ends only the run. Default: what the "
            "scene says, or where other tools' FMUs or Python slaves take part."
        ),
    ]
    """Linux only. Python slaves passed as objects aren't isolated unless asked for: their changes would be lost in the child process."""
    call_limit: Annotated[float | None, Option("Time limit of one call of a slave in an isolated run.", "SECONDS")]


class RunOptions(SceneOptions, total=False):
    """Options of one run: how the scene is prepared, and what is this run's own."""

    parameters: Annotated[
        Mapping[str, float] | None, Option('FMU parameters that differ from the scene\'s: {"payload.mass": 0.1}.')
    ]
    progress: Annotated[
        Callable[[float], None] | None, Option("Called repeatedly with the simulated fraction, 0 to 1.")
    ]
    accept_size: Annotated[
        bool, Option("Run however large the results are. Default: refuse more than 2 GB, companion included.")
    ]


RUN_OPTIONS: Mapping[str, Option] = {name: kind.__metadata__[0] for name, kind in RunOptions.__annotations__.items()}
"""What is said of each option of a run."""
