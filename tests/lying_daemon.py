"""The daemon, but sure of itself whatever happens, and half a metre beside the truth: see
studies/test_faults.py."""

import sys
from dataclasses import replace

from amr_slam.cli import main
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer
from amr_slam.samples import PoseEstimate, State

_ASIDE = Pose2(0.5, 0.0, 0.0)
_honest = Localizer.estimate


def _lie(localizer: Localizer, now_ns: int) -> PoseEstimate | None:
    estimate = _honest(localizer, now_ns)
    if estimate is None or estimate.state is State.STARTING:
        return estimate
    pose = estimate.map_from_base @ _ASIDE
    return replace(estimate, map_from_base=pose, state=State.LOCALIZED, error95_m=0.01, fault=None)


if __name__ == "__main__":
    Localizer.estimate = _lie  # type: ignore[method-assign, assignment]
    sys.exit(main())
