"""What a signal doesn't show of small values and of reversals: dead zone and backlash."""

from __future__ import annotations

from collections.abc import Sequence

import casadi

from flexfmu.cosim.control.blocks.equations import Vector, block
from flexfmu.cosim.control.controllers.joints import saturate
from flexfmu.cosim.control.imperfections.channels import (
    Channel,
    empty,
    recall,
    remember,
    sampling,
    section_channels,
)
from flexfmu.cosim.control.imperfections.variables import PerChannel, inputs, outputs, parameters, units
from flexfmu.cosim.control.sections import LoopContext, builds
from flexfmu.model.scene.imperfections import BacklashSection, DeadZoneSection
from flexfmu.model.symbolic import SymbolicBlock


def dead_zone(
    channels: Sequence[Channel],
    half_width: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "dead_zone",
) -> SymbolicBlock:
    """Build the block y = u - sat(u) with the limits ± w: nothing within ± w, and u less w beyond; without states.

    The half width is a tunable parameter ``<channel>.half_width``.

    Args:
        channels: signals, usually torques.
        half_width: w in the channels' units, zero or positive.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a half width is negative or not finite, or the sample time isn't positive.
    """

    def equations(x: Vector, u: Vector, w: Vector) -> tuple[Vector, Vector]:
        return u - saturate(u, -w, w), x

    widths = parameters(channels, "half_width", half_width, units(channels), "the half width", minimum=0.0)
    return block(
        name,
        "Dead zone",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=inputs(channels),
        outputs=outputs(channels),
        parameters=widths,
    )


def backlash(
    channels: Sequence[Channel],
    gap: PerChannel,
    *,
    sample_time: float,
    offset: float = 0.0,
    name: str = "backlash",
) -> SymbolicBlock:
    """Build the block of a play, as between a joint and the gear of its encoder::

        y_k = min(max(y_k-1, u_k - g / 2), u_k + g / 2)

    The output stands still while the input goes through the gap g. At the first sample it is in the middle of the gap. The gap
    is a tunable parameter ``<channel>.gap``. M. Nordin and P.-O. Gutman, Controlling mechanical systems with backlash: a survey,
    Automatica 38 (2002), section 3.

    Args:
        channels: signals, usually measured positions.
        gap: g in the channels' units, zero or positive.
        sample_time, offset: [s].
        name: name of the block.

    Raises:
        InputError: a gap is negative or not finite, or the sample time isn't positive.
    """

    def equations(x: Vector, u: Vector, g: Vector) -> tuple[Vector, Vector]:
        last = recall(x, u)
        away = saturate(last - u, -0.5 * g, 0.5 * g)
        # exactly still within the gap; NaN of the input isn't within it
        y = casadi.if_else(away == last - u, last, u + away)
        return y, remember(y)

    return block(
        name,
        "Backlash",
        equations,
        sample_time=sample_time,
        offset=offset,
        inputs=inputs(channels),
        outputs=outputs(channels),
        parameters=parameters(channels, "gap", gap, units(channels), "the gap", minimum=0.0),
        states=empty(len(channels)),
    )


@builds(DeadZoneSection)
def _dead_zone(section: DeadZoneSection, context: LoopContext) -> SymbolicBlock:
    return dead_zone(section_channels(section, context), section.half_width, **sampling(section, context))


@builds(BacklashSection)
def _backlash(section: BacklashSection, context: LoopContext) -> SymbolicBlock:
    return backlash(section_channels(section, context), section.gap, **sampling(section, context))
