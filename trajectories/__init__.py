"""Planned motion: paths, blends, motion profiles, trajectories, and input shapers. Depends on numpy and scipy only."""

from flexfmu.trajectories.blends import Blend, ClothoidPair, LameBlend, PolarPolynomial
from flexfmu.trajectories.cam_profiles import (
    Cycloidal,
    FifthDegreePolynomial,
    Harmonic,
    ModifiedSine,
    ModifiedTrapezoid,
)
from flexfmu.trajectories.curves import PiecewiseCurve, PlaneJets, Point, Side
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.joint import InverseKinematics, JointTrajectory, Margin
from flexfmu.trajectories.own import OwnMotion, SplineTrajectory, as_trajectory
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.piecewise import PiecewisePolynomial, spline
from flexfmu.trajectories.polynomial_profile import PolynomialProfile
from flexfmu.trajectories.profile_pieces import ProfilePiece, SinePiece, SmoothPiece
from flexfmu.trajectories.profiles import (
    BangBang,
    DoubleS,
    Profile,
    SeventhDegreePolynomial,
    Trapezoidal,
    evaluate_profile,
)
from flexfmu.trajectories.sources import from_ruckig, from_scipy, from_toppra
from flexfmu.trajectories.table import MotionTable, read_table, write_table
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

__all__ = [
    "BangBang",
    "Blend",
    "ClothoidPair",
    "Cycloidal",
    "DoubleS",
    "FifthDegreePolynomial",
    "Harmonic",
    "InverseKinematics",
    "Jet",
    "JointTrajectory",
    "LameBlend",
    "Margin",
    "ModifiedSine",
    "ModifiedTrapezoid",
    "MotionTable",
    "OwnMotion",
    "PickAndPlacePath",
    "PiecewiseCurve",
    "PiecewisePolynomial",
    "PlaneJets",
    "Point",
    "PolarPolynomial",
    "PolynomialProfile",
    "Profile",
    "ProfilePiece",
    "SeventhDegreePolynomial",
    "Side",
    "SinePiece",
    "SmoothPiece",
    "SplineTrajectory",
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
