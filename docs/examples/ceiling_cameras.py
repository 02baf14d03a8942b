"""Stand in for ceiling cameras: python ceiling_cameras.py tcp/127.0.0.1:7447 amr7 [FOLDER]

Sees the robot where it says it is, with a noise of 1 cm and 0.5 degrees, turned and shifted into
another frame, and stamps it 80 ms late, on cameras/<robot>/pose. FOLDER:
what 'amr-slam keys camera NAME' wrote, where the site has keys.
"""

import json
import math
import random
import sys
import time
from contextlib import closing
from pathlib import Path

import zenoh

from amr_slam.keys import read_credentials

SHIFT_X, SHIFT_Y, TURN = 12.3, -4.5, math.radians(40.0)


def main(endpoint: str, robot: str, keys: str | None = None) -> None:
    """Until Ctrl-C."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    for key, value in read_credentials(Path(keys)).options().items() if keys else ():
        config.insert_json5(key, json.dumps(value))
    with closing(zenoh.open(config)) as session:  # callbacks may still put

        def seen(sample: zenoh.Sample) -> None:
            pose = json.loads(sample.payload.to_bytes())
            c, s = math.cos(TURN), math.sin(TURN)
            x = SHIFT_X + c * pose["x"] - s * pose["y"] + random.gauss(0.0, 0.01)
            y = SHIFT_Y + s * pose["x"] + c * pose["y"] + random.gauss(0.0, 0.01)
            theta = pose["theta"] + TURN + random.gauss(0.0, math.radians(0.5))
            said = {"x": x, "y": y, "theta": theta, "stamp": pose["stamp"] + 0.08}
            session.put(f"cameras/{robot}/pose", json.dumps(said).encode())

        session.declare_subscriber(f"amr/{robot}/pose", seen)
        while True:
            time.sleep(1.0)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except KeyboardInterrupt:
        sys.exit(130)
