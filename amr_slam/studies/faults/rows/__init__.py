"""All rows, in the order of the catalogue."""

from __future__ import annotations

from typing import Final

from amr_slam.studies.faults.row import Case, Row
from amr_slam.studies.faults.rows.files import FILES
from amr_slam.studies.faults.rows.network import NETWORK
from amr_slam.studies.faults.rows.places import PLACES
from amr_slam.studies.faults.rows.processes import PROCESSES
from amr_slam.studies.faults.rows.scanners import SCANNERS
from amr_slam.studies.faults.rows.wheels import WHEELS


def _order(row: Row | Case) -> tuple[int, str]:
    return int(row.number.rstrip("abcd")), row.number


ROWS: Final[tuple[Row | Case, ...]] = tuple(
    sorted((*SCANNERS, *WHEELS, *PLACES, *PROCESSES, *NETWORK, *FILES), key=_order)
)
