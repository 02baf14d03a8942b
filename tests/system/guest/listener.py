"""A fleet controller in the test's machine: notes each pose and status as it arrives.

A line for each in the file that is named: CLOCK_MONOTONIC in s, the last part of the key, and the
message as it came.
"""

from __future__ import annotations

import sys
import time

import zenoh


def main(path: str) -> None:
    """Listen until the end."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", '["tcp/127.0.0.1:7447"]')
    config.insert_json5("connect/timeout_ms", "-1")
    config.insert_json5("scouting/multicast/enabled", "false")
    with open(path, "w", encoding="utf-8", buffering=1) as file:

        def note(sample: zenoh.Sample) -> None:
            kind = str(sample.key_expr).rsplit("/", 1)[1]
            file.write(f"{time.monotonic():.4f} {kind} {sample.payload.to_string()}\n")

        with zenoh.open(config) as session:
            for kind in ("pose", "status"):
                session.declare_subscriber(f"amr/robot/{kind}", note)
            while True:
                time.sleep(3600.0)


if __name__ == "__main__":
    main(sys.argv[1])
