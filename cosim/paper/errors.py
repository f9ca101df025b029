"""What can go wrong while the paper's experiment is run."""

from __future__ import annotations

from flexfmu.cosim.errors import CosimError


class PaperError(CosimError):
    """A simulation of the paper's experiment failed."""
