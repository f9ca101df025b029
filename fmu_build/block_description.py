"""What the FMU of a discrete-time block says of itself: variables, structure, sampling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from flexfmu.fmu_build.codegen import MAX_INPUT_ORDER
from flexfmu.fmu_build.description import Description
from flexfmu.fmu_build.documentation_files import documentation_files
from flexfmu.fmu_build.errors import ModelError
from flexfmu.fmu_build.experiment import DefaultExperiment
from flexfmu.fmu_build.interface import FmiVariable, Interface, Unknown, check_names, real_variable
from flexfmu.fmu_build.picture import FINE_PEN, PAGE_SIZE, block_picture
from flexfmu.model.symbolic import SymbolicBlock

SAMPLES = "statistics.samples"
"""Name of the counter, the only Integer variable."""


def with_starts(block: SymbolicBlock) -> SymbolicBlock:
    """The block with a start value for every input: zero where it has none."""
    return replace(
        block, inputs=tuple(replace(each, start=0.0) if each.start is None else each for each in block.inputs)
    )


def block_description(block: SymbolicBlock) -> Description:
    """What the model description says.

    Raises:
        ModelError: the block's variables contradict each other.
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
    """Number the variables of a block: inputs, parameters, outputs, and the counter of samples.

    Outputs are discrete: they change at sample instants only.

    Raises:
        ModelError: a name is given twice or unknown, or a start value is missing or out of range.
    """
    scalars = (*block.inputs, *block.parameters, *block.outputs)
    check_names([*(variable.name for variable in scalars), SAMPLES])
    index_of = {variable.name: index for index, variable in enumerate(scalars, start=1)}
    reals = tuple(real_variable(variable, index_of, output_variability="discrete") for variable in scalars)
    counter = FmiVariable(
        index=len(reals) + 1,
        value_reference=0,
        kind="Integer",
        name=SAMPLES,
        description="Samples completed since initialisation",
        causality="local",
        variability="discrete",
        initial="calculated",
    )
    known = tuple(variable.index for variable in reals if variable.causality != "output")
    outputs = tuple(
        Unknown(index_of[output.name], _feedthrough(block, output.name, index_of)) for output in block.outputs
    )
    return Interface(
        variables=(*reals, counter),
        outputs=outputs,
        derivatives=(),
        initial_unknowns=tuple(Unknown(output.index, known) for output in outputs),
    )


def block_documentation(
    block: SymbolicBlock, description: Description, experiment: DefaultExperiment
) -> dict[str, str]:
    """Files of the folder ``documentation/``: path below the FMU's root → text."""
    picture = block_picture(*PAGE_SIZE, FINE_PEN)
    return documentation_files("block.html.j2", description, experiment, picture=picture, model=block)


def _feedthrough(block: SymbolicBlock, output: str, index_of: Mapping[str, int]) -> tuple[int, ...]:
    """Indices of the inputs that an output depends on; an output without a statement depends on all."""
    inputs = [variable.name for variable in block.inputs]
    names = block.feedthrough.get(output, inputs)
    unknown = sorted(set(names) - set(inputs))
    if unknown:
        raise ModelError(f"feedthrough of output '{output}' names '{unknown[0]}', which is no input")
    return tuple(sorted(index_of[name] for name in names))
