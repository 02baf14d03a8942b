"""What a robot that runs says of itself, in its status and its poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from amr_slam.client import RobotView
from amr_slam.service.doctor.findings import Finding, advice
from amr_slam.states import State
from amr_slam.wire import HealthPart, StatusMessage

_STALE_S: Final = 1.0
_STATES: Final = {
    State.STARTING: "no scan has been registered yet: look at scanners, wheels and map below",
    State.ODOMETRY_ONLY: "the wheels alone carry the pose: scanners blocked or missing (below)? "
    "Drive slowly to a place that has not changed",
    State.AMBIGUOUS: "several places look alike: drive a few metres with care, or set the pose: "
    'amr-slam call ROBOT set_pose \'{"x": 0, "y": 0, "theta": 0, "radius": 3}\'',
    State.LOST: "drive to a place that has not changed and stop for three scans, or set the pose: "
    'amr-slam call ROBOT set_pose \'{"x": 0, "y": 0, "theta": 0, "radius": 3}\'. If that never '
    "helps, the map is not for this place (map below)",
}


def look_at_robot(view: RobotView) -> Iterator[Finding]:
    """``view``: with a status."""
    status = view.status
    assert status is not None
    if view.pose is None or view.pose_age_s() > _STALE_S:
        yield Finding(
            part="poses",
            what="none come",
            do="wheels and scanners below; then the service's log",
        )
    yield _state(status)
    yield _map(status)
    for name, part in status.scanners.items():
        yield _device(name, part, "cable, power and address of this scanner")
    yield _device("wheels", status.wheels, "CAN wiring, power of the drives, the DBC file")
    yield _device("slam", status.slam, "the log says why: journalctl -u 'amr-slam@*' -n 100")
    if status.clock_steps:
        yield Finding(
            part="clock",
            what=f"was set {status.clock_steps} times since the start",
            do="one time server for all, and set before the start: stamps jump with the clock",
        )
    if status.advice is not None:
        yield Finding(part="wheels", what=status.advice, do="docs/calibration.md")
    yield from _rest_of_fault(status)


def _state(status: StatusMessage) -> Finding:
    do = _STATES.get(status.state)
    what = f"{status.state}, {status.mode}"
    return Finding(part="state", what=what, do=do and do.replace("ROBOT", status.robot))


def _map(status: StatusMessage) -> Finding:
    if status.map is None and status.mode == "mapping":
        do = "it begins with the first scan that is registered: slam, scanners and wheels below"
        return Finding(part="map", what="none yet: it is to be made", do=do)
    if status.map is None:
        do = "look whether map.path is there and whole: amr-slam map info FILE; copy it anew"
        return Finding(part="map", what="none is loaded", do=do)
    what = f"{status.map.name}, {status.map.version} scans"
    if status.state in {State.LOST, State.AMBIGUOUS} and status.explained is not None:
        what += f"; {status.explained:.0%} of the last scan lies on its walls"
        if status.explained < 0.3:
            return Finding(
                part="map",
                what=f"{what}: not for this place?",
                do="the wrong hall's map, or the hall was rebuilt: load another one "
                "(amr-slam call ROBOT load_map ...) or map anew (docs/commissioning.md, 5)".replace(
                    "ROBOT", status.robot
                ),
            )
    return Finding(part="map", what=what)


def _device(name: str, part: HealthPart, otherwise: str) -> Finding:
    what = f"{part.link}, {part.rate_hz:.1f} Hz, {part.errors} errors"
    if part.link == "OK" and part.detail is None:
        return Finding(part=name, what=what)
    detail = part.detail or "nothing received"
    return Finding(part=name, what=f"{what}; {detail}", do=advice(detail, otherwise))


def _rest_of_fault(status: StatusMessage) -> Iterator[Finding]:
    """What is told beside the parts that were looked at."""
    known = [part.detail for part in status.health().values() if part.detail]
    for text in (status.fault or "").split("; "):
        if text and not any(text in detail or detail in text for detail in known):
            do = advice(text, "docs/operations.md: what the robot says, and what to do")
            yield Finding(part="fault", what=text, do=do)
