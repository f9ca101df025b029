"""Builds the disturbances of a scene from its sections `[[disturbance]]`."""

from __future__ import annotations

from pathlib import Path

from flexfmu.cosim.control.disturbances import band_noise, sine, steps, table
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
from flexfmu.cosim.engine.formats.csv_table import read_csv
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.model.scene.disturbances import (
    PAYLOAD,
    BandNoiseSection,
    CsvSection,
    PayloadChangeSection,
    PulseSection,
    SineSection,
    StepSection,
)
from flexfmu.model.symbolic import SymbolicBlock


def _column(section: CsvSection) -> tuple[RealArray, RealArray]:
    """Times [s] and scaled values of a section's file.

    Raises:
        ResultsError: the file can't be read.
        InputError: it has no such column.
    """
    times, columns = read_csv(Path(section.file))
    wanted = section.column or section.signal
    if wanted not in columns:
        raise InputError(f"{section.file} has no column {wanted!r}: give `column`; columns: {', '.join(columns)}")
    return times, section.scale * columns[wanted].values


@builds(PulseSection)
def _pulse(section: PulseSection, context: LoopContext) -> SymbolicBlock:
    instants = [section.start, section.start + section.duration]
    return steps(section.signal, instants, [section.amplitude, 0.0], context.name)


@builds(StepSection)
def _step(section: StepSection, context: LoopContext) -> SymbolicBlock:
    ends = [] if section.duration is None else [section.start + section.duration]
    return steps(section.signal, [section.start, *ends], [section.amplitude, 0.0][: 1 + len(ends)], context.name)


@builds(SineSection)
def _sine(section: SineSection, context: LoopContext) -> SymbolicBlock:
    return sine(
        section.signal,
        section.amplitude,
        section.frequency,
        phase=section.phase,
        sample_time=section.sample_time or context.sample_time,
        start=section.start,
        duration=section.duration,
        name=context.name,
    )


@builds(BandNoiseSection)
def _noise(section: BandNoiseSection, context: LoopContext) -> SymbolicBlock:
    return band_noise(
        section.signal,
        section.standard_deviation,
        section.band,
        section.seed,
        components=section.components,
        sample_time=section.sample_time or context.sample_time,
        start=section.start,
        duration=section.duration,
        name=context.name,
    )


@builds(CsvSection)
def _csv(section: CsvSection, context: LoopContext) -> SymbolicBlock:
    times, values = _column(section)
    return table(
        section.signal,
        times,
        values,
        sample_time=section.sample_time or context.sample_time,
        start=section.start,
        duration=section.duration,
        name=context.name,
    )


@builds(PayloadChangeSection)
def _payload(section: PayloadChangeSection, context: LoopContext) -> SymbolicBlock:
    if section.picked_up is None:
        mass = section.mass or context.scene.payload.mass
        return steps(PAYLOAD, [section.dropped or 0.0], [-mass], context.name)
    ends = [] if section.dropped is None else [section.dropped]
    return steps(PAYLOAD, [section.picked_up, *ends], [section.mass or 0.0, 0.0][: 1 + len(ends)], context.name)
