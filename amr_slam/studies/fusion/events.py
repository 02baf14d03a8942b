"""What wrong fixes, outages and wheels that lie do to the published pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.samples import PoseEstimate, SlamPose, WheelSample
from amr_slam.studies.fusion.product import estimates, localizer
from amr_slam.studies.fusion.simulated import (
    Recording,
    Scenario,
    WheelErrors,
    record,
    start_covariance,
)
from amr_slam.studies.report import Effort, Section, Table

_SCENARIO: Final = Scenario(name="driving", speed_mps=0.3, turn_radps=0.1)
_AT_S: Final = 31.0
_MOVING_S: Final = 38.0
_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Something goes wrong on an ordinary drive, from ``_AT_S`` on."""

    name: str
    change: Callable[[Recording], Recording]
    without: Callable[[Recording], Recording] = lambda drive: drive
    """The drive to compare with."""


def silent(count: int) -> Callable[[Recording], Recording]:
    """So many fixes are missing."""

    def change(drive: Recording) -> Recording:
        span = (_AT_S, _AT_S + 2.0 * count)
        kept = [one for one in drive.fixes if not span[0] <= 1e-9 * one[1].stamp_ns < span[1]]
        return replace(drive, fixes=tuple(kept))

    return change


def outliers(size_m: float, count: int) -> Callable[[Recording], Recording]:
    """So many fixes in a row are off by so much, all the same way."""
    return lambda drive: _moved(drive, size_m, _AT_S, _AT_S + 2.0 * count)


def outage(size_m: float, until_s: float = np.inf) -> Callable[[Recording], Recording]:
    """11 s without a fix; then they are off by so much (until ``until_s``): the robot was moved,
    or the fix is wrong."""

    def change(drive: Recording) -> Recording:
        kept = tuple(
            one for one in drive.fixes if not _AT_S <= 1e-9 * one[1].stamp_ns < _AT_S + 11.0
        )
        return _moved(replace(drive, fixes=kept), size_m, _AT_S + 11.0, until_s)

    return change


def spun(left_m: float, right_m: float) -> Callable[[Recording], Recording]:
    """Within 0.5 s the wheels turn by so much more than the robot goes."""

    def change(drive: Recording) -> Recording:
        def extra(sample: WheelSample) -> WheelSample:
            share = min(max((1e-9 * sample.stamp_ns - _AT_S) / 0.5, 0.0), 1.0)
            return replace(
                sample,
                left_rad=sample.left_rad + share * left_m / 0.1,
                right_rad=sample.right_rad + share * right_m / 0.1,
            )

        return replace(drive, wheels=tuple(extra(sample) for sample in drive.wheels))

    return change


def stuck(seconds: float, begin_s: float = _AT_S) -> Callable[[Recording], Recording]:
    """The left wheel's counts stand still for so long."""

    def change(drive: Recording) -> Recording:
        times = np.array([1e-9 * sample.stamp_ns for sample in drive.wheels])
        left = np.array([sample.left_rad for sample in drive.wheels])
        begin, end = np.interp([begin_s, begin_s + seconds], times, left)
        shown = np.where(
            times < begin_s,
            left,
            np.where(times < begin_s + seconds, begin, left - (end - begin)),
        )
        wheels = tuple(
            replace(sample, left_rad=float(value))
            for sample, value in zip(drive.wheels, shown, strict=True)
        )
        return replace(drive, wheels=wheels)

    return change


CASES: Final = (
    Case(name="two fixes 1 m off", change=outliers(1.0, 2), without=silent(2)),
    Case(name="two fixes 20 m off", change=outliers(20.0, 2), without=silent(2)),
    Case(name="11 s without fixes, the robot then 2 m elsewhere", change=outage(2.0)),
    Case(name="11 s without fixes, then one wrong fix 2 m off", change=outage(2.0, _AT_S + 12.5)),
    Case(name="left wheel spins by 0.2 m", change=spun(0.2, 0.0)),
    Case(name="both wheels spin by 0.2 m", change=spun(0.2, 0.2)),
    Case(name="left wheel's counts stand for 4 s, from a halt on", change=stuck(4.0)),
    Case(name="left wheel's counts stand for 4 s, at full speed", change=stuck(4.0, _MOVING_S)),
)


def study(effort: Effort) -> Section:
    """One row a case, against the same drive with nothing wrong."""
    rng = np.random.default_rng(effort.seed)
    drive = record(_SCENARIO, WheelErrors(), rng, wheel_hz=50.0)
    rows = []
    for case in CASES:
        usual = _published(case.without(drive))
        shown, said = _told(case.change(drive))
        far = np.array(
            [
                one.map_from_base.distance_to(two.map_from_base)
                for one, two in zip(shown, usual, strict=True)
            ]
        )
        after = [k for k, one in enumerate(shown) if 1e-9 * one.stamp_ns >= _AT_S]
        widest = max(shown[k].error95_m for k in after)
        rows.append(
            (
                case.name,
                f"{far.max():.3f}",
                f"{far[-1]:.3f}",
                f"{widest:.2f}",
                str(shown[-1].epoch - usual[-1].epoch),
                "; ".join(said) or "-",
            )
        )
        effort.progress(" | ".join(rows[-1]))
    return Section(
        title="Wrong fixes, outages, lying wheels",
        text=_TEXT,
        tables=(
            Table(
                title="Published pose with the fault, less that without it",
                columns=(
                    "fault",
                    "largest m",
                    "at the end m",
                    "largest `error95_m`",
                    "new epochs",
                    "said in `fault`",
                ),
                rows=tuple(rows),
            ),
        ),
    )


def _published(drive: Recording) -> list[PoseEstimate]:
    robot = localizer(FilterParams(), drive.truth[0], start_covariance())
    return [estimate for estimate, _ in estimates(drive, robot)]


def _told(drive: Recording) -> tuple[list[PoseEstimate], list[str]]:
    shown = _published(drive)
    said = dict.fromkeys(one.fault for one in shown if one.fault)
    return shown, list(said)


def _moved(drive: Recording, size_m: float, begin_s: float, end_s: float) -> Recording:
    def off(fix: SlamPose) -> SlamPose:
        if not begin_s <= 1e-9 * fix.stamp_ns < end_s:
            return fix
        pose = fix.map_from_base
        return replace(fix, map_from_base=Pose2(pose.x_m + size_m, pose.y_m, pose.theta_rad))

    return replace(drive, fixes=tuple((arrives, off(fix)) for arrives, fix in drive.fixes))


_TEXT: Final = """One drive at 0.3 m/s, a fix every 2 s. The fault is compared with the same drive
without it, wrong fixes with the drive that lacks these fixes. *At the end*: 0 where all is as
without the fault; the robot that was carried away during an outage is to be 2 m elsewhere. A fix
that contradicts fresh ones is refused until a second one says the same and the wheels can explain
both by slipping, or a third one says so; meanwhile `error95_m` covers both. After 7 s without a fix
the first one is believed at once, as a new epoch, and taken back when the next one says so."""
