"""Ours and the peers that are installed, on a tiny run."""

from __future__ import annotations

import math

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.studies import peer_methods, peers
from amr_slam.studies.peer_methods import GLOBAL, LOCAL, Find, Found, Method, Query
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.scenes import laboratory_scene

NAMES = [method.name for method in (*LOCAL, *GLOBAL)]


def version_of_few(package: str) -> str | None:
    return peer_methods.version(package) if package in ("amr_slam", "pycpd") else None


@pytest.fixture(scope="module")
def section() -> Section:
    """One world, no noise, five scans; every peer but pycpd taken for absent."""
    patch = pytest.MonkeyPatch()
    patch.setattr(peers, "SCANS", 5)
    patch.setattr(peers, "SIGMAS_M", (0.0,))
    patch.setattr(peers, "_NOISES", ("0",))
    patch.setattr(peers, "version", version_of_few)
    try:
        return peers.run(Effort(scale=0.0, progress=lambda _: None))
    finally:
        patch.undo()


@pytest.fixture(scope="module")
def exercise() -> tuple[PointMap, list[Query]]:
    """A map and scans to find in it, without noise."""
    return peers._exercise(laboratory_scene(7500), 0.0)


def cells(table: Table, name: str) -> dict[str, str]:
    (row,) = [row for row in table.rows if row[0] == name]
    return dict(zip(table.columns, row, strict=True))


def test_every_method_has_a_row_and_absent_ones_say_so(section: Section) -> None:
    local, anywhere = section.tables
    assert [row[0] for row in (*local.rows, *anywhere.rows)] == NAMES
    absent = [row for row in (*local.rows, *anywhere.rows) if row[1] == "not installed"]
    assert len(absent) == len(NAMES) - 5
    assert all(set(row[2:]) == {"-"} for row in absent)
    assert cells(local, "pycpd rigid")["version"] == peer_methods.version("pycpd")


def test_ours_and_cpd_find_exact_scans(section: Section) -> None:
    local, anywhere = section.tables
    icp = cells(local, "ours: ICP alone")
    assert icp["right, 0"] == "5 of 5"
    assert float(icp["median error mm, noise 0"]) < 10.0
    assert cells(local, "ours: whole relative update")["right, 0"] == "5 of 5"
    # Every fifth scan; it has no normals and 400 points of each: far better than the start, not
    # exact.
    cpd = cells(local, "pycpd rigid")
    assert cpd["right, 0"] == "1 of 1"
    assert float(cpd["median error mm, noise 0"]) < 100.0
    absolute = cells(anywhere, "ours: absolute strategy")
    assert absolute["right, noise 0"] == "5 of 5"
    assert absolute["wrong claims of all, 0"] == "0 of 5"


@pytest.mark.parametrize(("claimed", "counted"), [(True, 2), (False, 0)])
def test_a_wrong_answer_counts_where_it_was_claimed(
    exercise: tuple[PointMap, list[Query]], claimed: bool, counted: int
) -> None:
    def prepare(known: PointMap) -> Find:
        return lambda _: Found(Pose2(1e3, 0.0, 0.0), claimed)

    known, queries = exercise
    tally = peers.Tally()
    method = Method(name="", package="", setting="", prepare=prepare, every=2)
    peers._measure(method, known, queries[:3], tally)
    assert (tally.right, tally.false_claims) == ([False, False], counted)


@pytest.mark.parametrize("method", [m for m in (*LOCAL, *GLOBAL) if m.package != "amr_slam"])
def test_a_peer_that_is_installed_answers_in_the_frame_of_the_map(
    method: Method, exercise: tuple[PointMap, list[Query]]
) -> None:
    if peer_methods.version(method.package) is None:
        pytest.skip(f"{method.package} is not installed (dependency group peers)")
    known, queries = exercise
    find = method.prepare(known)
    if method in LOCAL:
        found = find(queries[0])
        assert found.pose.distance_to(queries[0].truth) < 0.1
        assert abs((found.pose.inverse() @ queries[0].truth).theta_rad) < math.radians(2.0)
    else:
        assert find(queries[0]).pose.is_finite()


def test_starts_are_as_far_off_as_the_study_says(exercise: tuple[PointMap, list[Query]]) -> None:
    _, queries = exercise
    assert len(queries) == peers.SCANS
    offsets = [_offset(query) for query in queries]
    np.testing.assert_allclose(offsets, [[0.15, math.radians(5.0)]] * len(queries))
    turns = [(query.truth.inverse() @ query.start).theta_rad for query in queries]
    assert min(turns) < 0.0 < max(turns)


def _offset(query: Query) -> tuple[float, float]:
    turn = (query.truth.inverse() @ query.start).theta_rad
    return query.start.distance_to(query.truth), abs(turn)
