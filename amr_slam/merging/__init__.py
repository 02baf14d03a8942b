"""Two maps of one place, made in frames of their own: found in each other, and made one."""

from amr_slam.merging.finding import Found, MergeError, MergeParams, find
from amr_slam.merging.joining import Merger, join

__all__ = ["Found", "MergeError", "MergeParams", "Merger", "find", "join"]
