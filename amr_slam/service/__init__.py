"""The composition root: devices, SLAM process, fusion and Zenoh put together and kept running."""

from amr_slam.service.daemon import run
from amr_slam.service.probe import check

__all__ = ["check", "run"]
