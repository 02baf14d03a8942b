"""What all scenarios have in common."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from amr_drivers.conformance.bench import Figures
from amr_drivers.conformance.rig import MakeRig

Effort = Literal["quick", "full"]
"""quick: seconds a scenario, for tests; full: every byte."""

Scenario = Callable[[MakeRig, Path, Effort], Figures]
"""One fault, or none at all, on a rig that is made for it in an empty folder."""
