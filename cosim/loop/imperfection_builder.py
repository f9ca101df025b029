"""From the sections of imperfections in a scene file to their blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypedDict

from flexfmu.cosim.imperfections import delay_filter
from flexfmu.cosim.imperfections.channels import Channel, joint_channels
from flexfmu.cosim.imperfections.delay import delay
from flexfmu.cosim.imperfections.jitter import jitter
from flexfmu.cosim.imperfections.lag import Lag, lag
from flexfmu.cosim.imperfections.noise import gaussian_noise, uniform_noise
from flexfmu.cosim.imperfections.quantisation import encoder, quantisation
from flexfmu.cosim.imperfections.rate_limit import rate_limit
from flexfmu.cosim.imperfections.saturation import saturation
from flexfmu.model import imperfection_sections as sections
from flexfmu.model.block import SymbolicBlock


class Sampling(TypedDict):
    """When a block samples [s]."""

    sample_time: float
    offset: float


def imperfection_block(
    section: Any, name: str, sample_time: float, before: Callable[[str], Sequence[float]]
) -> SymbolicBlock | Lag:
    """The block of an imperfection's section; a slave for a lag without a sample time.

    Args:
        section: one of `flexfmu.model.imperfection_sections`, but for slaves of the user's own and payload errors.
        name: name of the slave; random numbers follow from it.
        sample_time: [s] of a section that has none of its own.
        before: kind of signal (``position``, ``torque`` ...) → values of both joints before the first sample; none for
            those of the first sample.

    Raises:
        InputError: it can't be made.
    """
    sampling = Sampling(sample_time=section.sample_time or sample_time, offset=section.offset)
    if isinstance(section, sections.EncoderSection):
        return encoder(section.counts_per_turn, window=section.window, **sampling)
    channels = _channels(section, before)
    match section:
        case sections.SaturationSection(bounds=(lower, upper)):
            return saturation(channels, lower, upper, **sampling)
        case sections.RateLimitSection():
            return rate_limit(channels, section.rate, section.falling_rate, **sampling)
        case sections.DelaySection():
            return delay(channels, section.time, interpolation=_interpolation(section.interpolation), **sampling)
        case sections.QuantisationSection():
            return quantisation(channels, section.resolution, **sampling)
        case sections.NoiseSection(half_width=None):
            return gaussian_noise(channels, section.standard_deviation or 0.0, section.seed, name=name, **sampling)
        case sections.NoiseSection():
            return uniform_noise(channels, section.half_width or 0.0, section.seed, name=name, **sampling)
        case sections.JitterSection():
            return jitter(channels, section.time, section.seed, name=name, **sampling)
    if section.sample_time is None:
        return Lag(channels, section.time_constant, name)
    return lag(channels, section.time_constant, **sampling)


def _interpolation(section: sections.Interpolation) -> delay_filter.Interpolation:
    """How a signal is found between its samples."""
    match section:
        case sections.Lagrange():
            return delay_filter.Lagrange(section.order)
        case sections.Thiran():
            return delay_filter.Thiran(section.order)
    return delay_filter.LINEAR


def _channels(section: Any, before: Callable[[str], Sequence[float]]) -> tuple[Channel, ...]:
    """The signals of a section, with their values before the start."""
    if section.signal != "reference":
        return joint_channels(section.signal, before(section.signal))
    names = ("joint1.reference", "joint2.reference")
    delays = isinstance(section, (sections.DelaySection, sections.JitterSection, sections.LagSection))
    kinds = ("position", "velocity", "acceleration") if delays else ("position",)
    return tuple(channel for kind in kinds for channel in joint_channels(kind, before(kind), names))
