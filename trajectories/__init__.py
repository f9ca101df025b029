"""Planned motion: paths, blends, motion profiles, trajectories, and input shapers. Depends on numpy and scipy only."""

from importlib import import_module
from typing import TYPE_CHECKING

from flexfmu.trajectories.blends import Blend, ClothoidPair, LameBlend, PolarPolynomial
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.joint import JointTrajectory, Margin
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.polynomial_profile import PolynomialProfile
from flexfmu.trajectories.profiles import (
    BangBang,
    Cycloidal,
    DoubleS,
    FifthDegreePolynomial,
    Harmonic,
    ModifiedSine,
    ModifiedTrapezoid,
    Profile,
    SeventhDegreePolynomial,
    Trapezoidal,
    evaluate_profile,
)
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

if TYPE_CHECKING:
    from flexfmu.trajectories.own import as_trajectory
    from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
    from flexfmu.trajectories.sources import from_ruckig, from_scipy, from_toppra
    from flexfmu.trajectories.table import write_table
    from flexfmu.trajectories.table_file import read_table

__all__ = [
    "BangBang",
    "Blend",
    "ClothoidPair",
    "Cycloidal",
    "DoubleS",
    "FifthDegreePolynomial",
    "Harmonic",
    "Jet",
    "JointTrajectory",
    "LameBlend",
    "Margin",
    "ModifiedSine",
    "ModifiedTrapezoid",
    "PickAndPlacePath",
    "PiecewisePolynomial",
    "PolarPolynomial",
    "PolynomialProfile",
    "Profile",
    "SeventhDegreePolynomial",
    "TaskTrajectory",
    "Trajectory",
    "TrajectoryError",
    "Trapezoidal",
    "as_trajectory",
    "evaluate_profile",
    "from_ruckig",
    "from_scipy",
    "from_toppra",
    "read_table",
    "spline",
    "write_table",
]

_SELDOM = {
    "as_trajectory": "flexfmu.trajectories.own",
    **dict.fromkeys(("PiecewisePolynomial", "spline"), "flexfmu.trajectories.piecewise"),
    **dict.fromkeys(("from_ruckig", "from_scipy", "from_toppra"), "flexfmu.trajectories.sources"),
    "write_table": "flexfmu.trajectories.table",
    "read_table": "flexfmu.trajectories.table_file",
}
"""Names that scenes don't need → module that they are imported from at their first use."""

# hidden from type checkers, which would otherwise accept every misspelt name
if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        """Import a name at its first use and return its value (PEP 562).

        Raises:
            AttributeError: there is no such name.
        """
        if name not in _SELDOM:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(_SELDOM[name]), name)
        return value
