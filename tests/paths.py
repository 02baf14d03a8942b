"""Where tests find data that is not part of the repository."""

from __future__ import annotations

import os
from pathlib import Path

REPO = Path(__file__).resolve().parent.parent
SHARED = Path(os.environ.get("AMR_SLAM_SHARED", REPO.parent / "shared"))
