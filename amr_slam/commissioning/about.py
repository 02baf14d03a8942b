"""Where a report comes from: so that nobody takes it for that of another map."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class About:
    """Map, program and date, as texts."""

    map_id: str
    file_name: str
    file_sha256: str
    map_format: int
    software: str
    made_at: str
    """UTC, to the minute."""
    robot: str
    """Whose scanners were looked with."""
