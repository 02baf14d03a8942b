"""A seeded world, a robot in it, and what its devices measure: the product without hardware."""

from amr_slam.simulation.casting import cast
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.laboratory import laboratory
from amr_slam.simulation.people import PERSON_RADIUS_M
from amr_slam.simulation.pilot import DRIVABLE, MAX_POSE_AGE_S, CautiousPilot
from amr_slam.simulation.robot import WHEEL_PERIOD_NS, SimulatedRobot, Vehicle
from amr_slam.simulation.scanner import ScannerModel, opposite_scanners, take_scan
from amr_slam.simulation.tour import PathFollower, Tour, plan_tour
from amr_slam.simulation.world import World

__all__ = [
    "DRIVABLE",
    "MAX_POSE_AGE_S",
    "PERSON_RADIUS_M",
    "WHEEL_PERIOD_NS",
    "CautiousPilot",
    "ClearanceGrid",
    "PathFollower",
    "ScannerModel",
    "SimulatedRobot",
    "Tour",
    "Vehicle",
    "World",
    "cast",
    "laboratory",
    "opposite_scanners",
    "plan_tour",
    "take_scan",
]
