"""Builds the disturbances of a scene from its sections `[[disturbance]]`."""

from __future__ import annotations

from flexfmu.cosim.control.disturbances import band_noise, sine, steps, table
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.cosim.engine.errors import InputError
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
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.table_file import read_signal


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
    # scaled values may be in any unit
    unit = ("N" if section.signal.startswith("force.") else "N.m") if section.scale == 1.0 else ""
    try:
        times, values = read_signal(section.file, section.column or section.signal, unit)
    except TrajectoryError as error:
        raise InputError(f"[[disturbance]] csv: {error}") from None
    return table(
        section.signal,
        times,
        section.scale * values,
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
