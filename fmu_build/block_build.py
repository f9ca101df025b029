"""From a discrete-time block to an FMU file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from flexfmu.fmu_build.build import BuiltFmu, Progress, build_from_sources
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.icon import ICON_SIZE, png
from flexfmu.fmu_build.naming import named_block
from flexfmu.fmu_build.picture import block_picture

if TYPE_CHECKING:
    from flexfmu.fmu_build.naming import Naming
    from flexfmu.fmu_build.sources import Sources
    from flexfmu.model.symbolic import SymbolicBlock

DEFAULT_SAMPLES = 1000
"""Length of the default experiment in samples."""


def build_block_fmu(
    block: SymbolicBlock,
    output: Path | None = None,
    *,
    stop_time: float | None = None,
    step: float | None = None,
    platforms: Iterable[str] | None = None,
    naming: Naming = "structured",
    cache: bool = True,
    progress: Progress = lambda message: None,
) -> BuiltFmu:
    """Build an FMU 2.0 for co-simulation of a controller, shaper or imperfection, unless an equal one is in the cache.

    It samples at start time + offset + k * sample time, whatever the communication step: a step may hold many sample
    instants or none. At an instant within a step it reads its inputs as their polynomials have them there (held, unless
    derivatives were set). After a step the outputs are those of the last instant up to its end. Where the end is an
    instant itself, outputs with direct feedthrough hold the sample before until an input is set there, and follow the
    inputs from then on; the sample is completed with the last of them when the next step begins. So importers that set
    inputs before they read outputs get this sample, all others get it a communication step later, and none gets new
    states with old inputs. Before the first instant the outputs are those of the start states and the inputs at
    initialisation.

    Args:
        block: what to export.
        output: file to write; None leaves the FMU in the cache.
        stop_time, step: default experiment [s]; None for a thousand samples in steps of the sample time.
        platforms, naming, cache, progress: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        BuildError: in one line what is wrong and what to do: a block that contradicts its contract, no compiler, a
            compiler's error, or a file that cannot be written.
    """
    from flexfmu.fmu_build.block_codegen import check_block

    def make_sources() -> Sources:
        return generate_block_sources(block, experiment, progress, naming)

    check_block(block)
    step = block.sample_time if step is None else step
    end = float(f"{DEFAULT_SAMPLES * block.sample_time:.12g}") if stop_time is None else stop_time
    experiment = DefaultExperiment(stop_time=end, step=step)
    return build_from_sources(
        make_sources, experiment, output=output, platforms=platforms, cache=cache, progress=progress
    )


def generate_block_sources(
    block: SymbolicBlock,
    experiment: DefaultExperiment,
    progress: Progress = lambda message: None,
    naming: Naming = "structured",
) -> Sources:
    """Everything of the FMU that is text.

    Raises:
        ModelError: the block contradicts its contract.
    """
    from flexfmu.fmu_build.block_codegen import generate_block, generate_block_description
    from flexfmu.fmu_build.block_description import block_description, block_documentation, with_starts
    from flexfmu.fmu_build.codegen import DESCRIPTION_FILE
    from flexfmu.fmu_build.sources import assemble_sources

    progress("generating C")
    block = with_starts(block)
    functions, facts = generate_block(block)
    named = named_block(block, naming)

    def code(guid: str) -> dict[str, str]:
        return functions | {DESCRIPTION_FILE: generate_block_description(named, facts, guid)}

    description = block_description(block).named(naming)
    pages = block_documentation(block, description, experiment)
    return assemble_sources("block", description, experiment, code, pages, png(block_picture(ICON_SIZE, ICON_SIZE)))
