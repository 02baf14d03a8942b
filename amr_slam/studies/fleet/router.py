"""A Zenoh router, as ``zenohd`` is one: ``router ENDPOINT``."""

from __future__ import annotations

import json
import sys

import zenoh

from amr_slam.studies.fleet.programs import ready, wait_for_end


def main() -> int:
    """Route until standard input ends."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        ready()
        wait_for_end().wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
