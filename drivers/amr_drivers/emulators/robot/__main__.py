"""``python -m amr_drivers.emulators.robot DIRECTORY DBC SEED``: see :mod:`.process`."""

import sys
from pathlib import Path

from amr_drivers.emulators.robot.devices import RobotModel
from amr_drivers.emulators.robot.process import serve

serve(Path(sys.argv[1]), sys.argv[2], RobotModel(seed=int(sys.argv[3])))
