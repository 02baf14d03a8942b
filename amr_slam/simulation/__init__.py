"""A seeded world, a robot in it, and what its devices measure: the product without hardware."""

from amr_slam.simulation.buildings import offices
from amr_slam.simulation.cameras import CeilingCameras
from amr_slam.simulation.casting import cast
from amr_slam.simulation.devices import SCANNERS
from amr_slam.simulation.disturbances import blocked, moved_furniture
from amr_slam.simulation.grid import ClearanceGrid
from amr_slam.simulation.halls import hall
from amr_slam.simulation.laboratories import laboratory
from amr_slam.simulation.look_alikes import symmetric
from amr_slam.simulation.oblique import odd
from amr_slam.simulation.passages import corridors
from amr_slam.simulation.people import PERSON_RADIUS_M
from amr_slam.simulation.pilot import DRIVABLE, MAX_POSE_AGE_S, CautiousPilot
from amr_slam.simulation.robot import WHEEL_PERIOD_NS, SimulatedRobot, Vehicle
from amr_slam.simulation.sampling import COVERED, Coverage, free_poses, mapping_poses
from amr_slam.simulation.scanner import ScannerModel, opposite_scanners, take_scan
from amr_slam.simulation.tour import PathFollower, Tour, plan_tour
from amr_slam.simulation.world import World

__all__ = [
    "COVERED",
    "DRIVABLE",
    "MAX_POSE_AGE_S",
    "PERSON_RADIUS_M",
    "SCANNERS",
    "WHEEL_PERIOD_NS",
    "CautiousPilot",
    "CeilingCameras",
    "ClearanceGrid",
    "Coverage",
    "PathFollower",
    "ScannerModel",
    "SimulatedRobot",
    "Tour",
    "Vehicle",
    "World",
    "blocked",
    "cast",
    "corridors",
    "free_poses",
    "hall",
    "laboratory",
    "mapping_poses",
    "moved_furniture",
    "odd",
    "offices",
    "opposite_scanners",
    "plan_tour",
    "symmetric",
    "take_scan",
]
