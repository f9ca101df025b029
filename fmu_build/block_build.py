"""Builds the FMU of a discrete-time block, with its model description: variables, structure, sampling."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from flexfmu.fmu_build.block_codegen import check_block, generate_block, generate_block_description
from flexfmu.fmu_build.build import BuildProgress, BuiltFmu, build_from_sources
from flexfmu.fmu_build.codegen import DESCRIPTION_FILE, MAX_INPUT_ORDER
from flexfmu.fmu_build.description import Description
from flexfmu.fmu_build.documentation import documentation_files
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import Interface, Unknown, check_names, counter_variable, feedthrough, real_variable
from flexfmu.fmu_build.naming import Naming, named_block
from flexfmu.fmu_build.picture import FINE_PEN, ICON_SIZE, PAGE_SIZE, block_picture, png
from flexfmu.fmu_build.regular_sampling import regular
from flexfmu.fmu_build.sources import Sources, assemble_sources
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
    progress: BuildProgress = lambda message: None,
) -> BuiltFmu:
    """Build an FMU 2.0 for co-simulation of a controller, shaper or imperfection, unless an equal one is in the cache.

    The FMU samples at start time + offset + k * sample time, independently of the communication step, which may contain
    many sample instants or none. At an instant within a step it evaluates the input polynomials (constant unless
    derivatives are set). After a step the outputs are those of the last sample instant.

    If the step ends on a sample instant, outputs with direct feedthrough keep the previous sample until an input is set;
    from then on they follow the inputs. The next step completes this sample with the latest inputs. So importers that set
    inputs before they read outputs get the new sample at once, others one communication step later; new states are never
    combined with old inputs. Before the first instant, the outputs follow from the start states and the initial inputs.

    Args:
        block: the block.
        output: file to write; None leaves the FMU in the cache.
        stop_time: stop time of the default experiment [s]; None for that of a thousand samples.
        step: step of the default experiment [s]; None for the sample time.
        platforms: as for `flexfmu.fmu_build.build.build_fmu`.
        naming: as for `flexfmu.fmu_build.build.build_fmu`.
        cache: as for `flexfmu.fmu_build.build.build_fmu`.
        progress: as for `flexfmu.fmu_build.build.build_fmu`.

    Raises:
        BuildError: the block violates its contract, there is no compiler, compilation fails, or a file can't be written.
    """

    def make_sources() -> Sources:
        return generate_block_sources(block, experiment, progress, naming)

    check_block(block)
    block = regular(block)
    # default experiment: a thousand samples in steps of the sample time
    step = block.sample_time if step is None else step
    end = float(f"{DEFAULT_SAMPLES * block.sample_time:.12g}") if stop_time is None else stop_time
    experiment = DefaultExperiment(stop_time=end, step=step)
    return build_from_sources(
        make_sources, experiment, output=output, platforms=platforms, cache=cache, progress=progress
    )


def generate_block_sources(
    block: SymbolicBlock,
    experiment: DefaultExperiment,
    progress: BuildProgress = lambda message: None,
    naming: Naming = "structured",
) -> Sources:
    """Generate all text files of the FMU.

    Raises:
        ModelError: the block violates its contract.
    """
    progress("generating C")
    block = with_starts(block)
    # C code with the block's names, variables with names by the convention
    functions, facts = generate_block(block)
    named = named_block(block, naming)

    def code(guid: str) -> dict[str, str]:
        return functions | {DESCRIPTION_FILE: generate_block_description(named, facts, guid)}

    description = block_description(block).named(naming)
    picture = block_picture(*PAGE_SIZE, FINE_PEN)
    pages = documentation_files("block.html.j2", description, experiment, picture=picture, model=block)
    icon = png(block_picture(ICON_SIZE, ICON_SIZE))
    sources = assemble_sources("block", description, experiment, code, pages, icon, block.c_files)
    return replace(sources, libraries=block.libraries)


SAMPLES = "statistics.samples"
"""Name of the sample counter, the only Integer variable."""


def with_starts(block: SymbolicBlock) -> SymbolicBlock:
    """The block with start values for all inputs, zero by default."""
    return replace(
        block, inputs=tuple(replace(each, start=0.0) if each.start is None else each for each in block.inputs)
    )


def block_description(block: SymbolicBlock) -> Description:
    """The content of a block's model description.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    return Description(
        name=block.name,
        text=f"{block.description.rstrip('.')}. Samples every {block.sample_time!r} s, first {block.offset!r} s after the "
        "start, and holds its outputs in between.",
        interface=block_interface(block),
        max_input_order=MAX_INPUT_ORDER,
        annotations={"Sampling": {"sampleTime": repr(block.sample_time), "offset": repr(block.offset)}},
    )


def block_interface(block: SymbolicBlock) -> Interface:
    """Number the variables of a block: inputs, parameters, discrete outputs, and the sample counter.

    Raises:
        ModelError: a name is repeated or unknown, or a start value is missing or out of range.
    """
    # inputs, parameters, outputs, then the counter
    scalars = (*block.inputs, *block.parameters, *block.outputs)
    check_names([*(variable.name for variable in scalars), SAMPLES])
    index_of = {variable.name: index for index, variable in enumerate(scalars, start=1)}
    reals = tuple(real_variable(variable, index_of, output_variability="discrete") for variable in scalars)
    counter = counter_variable(SAMPLES, "Samples completed since initialisation", len(reals) + 1, 0)
    # outputs depend on inputs by direct feedthrough; initially on all inputs and parameters
    known = tuple(variable.index for variable in reals if variable.causality != "output")
    everything = [variable.name for variable in block.inputs]
    declared = {output.name: block.feedthrough.get(output.name, everything) for output in block.outputs}
    direct = feedthrough(block.outputs, block.inputs, declared, index_of)
    outputs = tuple(Unknown(index, inputs) for index, inputs in direct.items())
    return Interface(
        variables=(*reals, counter),
        outputs=outputs,
        derivatives=(),
        initial_unknowns=tuple(Unknown(output.index, known) for output in outputs),
    )
