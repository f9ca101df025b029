"""Planned motion: paths, blends, motion profiles, trajectories, and input shapers. Depends on numpy and scipy only."""

from flexfmu.trajectories.blends import Blend, ClothoidPair, LameBlend, PolarPolynomial
from flexfmu.trajectories.curves import PiecewiseCurve, PlaneJets, Point, Side
from flexfmu.trajectories.errors import TrajectoryError
from flexfmu.trajectories.jets import Jet
from flexfmu.trajectories.joint import InverseKinematics, JointTrajectory, Margin
from flexfmu.trajectories.path import PickAndPlacePath
from flexfmu.trajectories.profiles import (
    BangBang,
    Profile,
    ProfilePiece,
    SeventhDegreePolynomial,
    SmoothPiece,
    Trapezoidal,
    evaluate_profile,
)
from flexfmu.trajectories.trajectory import TaskTrajectory, Trajectory

__all__ = [
    "BangBang",
    "Blend",
    "ClothoidPair",
    "InverseKinematics",
    "Jet",
    "JointTrajectory",
    "LameBlend",
    "Margin",
    "PickAndPlacePath",
    "PiecewiseCurve",
    "PlaneJets",
    "Point",
    "PolarPolynomial",
    "Profile",
    "ProfilePiece",
    "SeventhDegreePolynomial",
    "Side",
    "SmoothPiece",
    "TaskTrajectory",
    "Trajectory",
    "TrajectoryError",
    "Trapezoidal",
    "evaluate_profile",
]
