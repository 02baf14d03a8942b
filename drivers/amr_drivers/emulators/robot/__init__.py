"""A whole robot without hardware: a simulated one in real time, behind the ports of real devices.

``python -m amr_drivers.emulators.robot`` is it as a process of its own.
"""

from amr_drivers.emulators.robot.devices import EmulatedRobot, RobotModel
from amr_drivers.emulators.robot.process import RobotProcess

__all__ = ["EmulatedRobot", "RobotModel", "RobotProcess"]
