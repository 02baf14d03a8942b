"""Recorded decisions, and the run that follows from them: the same poses, bit for bit."""

from amr_slam.rerun.decisions import Decision, WitnessedLocalizer
from amr_slam.rerun.running import Rerun, rerun

__all__ = ["Decision", "Rerun", "WitnessedLocalizer", "rerun"]
