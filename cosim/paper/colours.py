"""Colours of the paper's figures: one for each motion profile and each curve."""

from __future__ import annotations

from collections.abc import Mapping

PROFILE_COLOURS: Mapping[str, str] = {
    "7th order polynomial": "#0b5fa5",
    "Bang-bang": "#d1495b",
    "1/4 Trapezoidal": "#2a9d6f",
    "1/8 Trapezoidal": "#e09f1f",
}
"""Label of a motion profile → colour; distinct for colour-blind readers in lightness too."""

CURVE_COLOURS: Mapping[str, str] = {"Lamé": "#0b5fa5", "Clothoid": "#d1495b", "Polar": "#2a9d6f"}
"""Label of a curve → colour."""

SEQUENCE = ("#0b5fa5", "#d1495b", "#2a9d6f")
"""Colours of lines that are told apart by a number (cycle times, blend lengths)."""
