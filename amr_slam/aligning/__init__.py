"""A map's frame and the frame that people know: what brings one onto the other, and how sure."""

from amr_slam.aligning.clocks import TimedFit, fit_tracks
from amr_slam.aligning.fit import AlignError, Fit, FitParams, fit_pairs
from amr_slam.aligning.matching import PlanFit, PlanParams, fit_plan
from amr_slam.aligning.pairs import PosePairs, Track
from amr_slam.aligning.plan import FloorPlan, read_plan
from amr_slam.aligning.tables import read_camera, read_landmarks, read_pairs, write_residuals

__all__ = [
    "AlignError",
    "Fit",
    "FitParams",
    "FloorPlan",
    "PlanFit",
    "PlanParams",
    "PosePairs",
    "TimedFit",
    "Track",
    "fit_pairs",
    "fit_plan",
    "fit_tracks",
    "read_camera",
    "read_landmarks",
    "read_pairs",
    "read_plan",
    "write_residuals",
]
