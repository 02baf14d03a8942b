"""Recordings: cutting them into passes, what counts as covered, and one recording in full."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from paths import SHARED

from amr_slam.clouds import CloudParams
from amr_slam.geometry import Pose2
from amr_slam.params import SlamParams
from amr_slam.recording import Log, Trajectory
from amr_slam.samples import OdometrySample, Scan
from amr_slam.studies.real import run
from amr_slam.studies.real_driving import first_claim
from amr_slam.studies.real_passes import (
    APART_M,
    APART_S,
    COVERED,
    Recording,
    Visit,
    cut,
    passes,
)
from amr_slam.studies.real_queries import ask, choose, evidence
from amr_slam.studies.report import Effort
from amr_slam.studies.scenes import S300, laboratory_scene

LOGS = SHARED / "data/logs"
SECOND_NS = 1_000_000_000
ROUNDS = 2


@functools.cache
def recording() -> Recording:
    """Two rounds of a simulated laboratory, a scan and a wheel sample every 2.5 s."""
    scene = laboratory_scene(5)
    rng = np.random.default_rng(1)
    samples: list[Scan | OdometrySample] = []
    poses = list(scene.mapping) * ROUNDS
    stamps_ns = [2_500_000_000 * (k + 1) for k in range(len(poses))]
    for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
        samples.append(replace(scene.scan(S300, pose, rng), stamp_ns=stamp_ns))
        # The wheels' frame is not the map's.
        samples.append(
            OdometrySample(stamp_ns=stamp_ns, odom_from_base=Pose2(3.0, -1.0, 2.0) @ pose)
        )
    reference = Trajectory(
        stamps_ns=np.array(stamps_ns), poses=np.array([pose.as_array() for pose in poses])
    )
    return Recording.of("simulated", Log(samples=tuple(samples)), reference, CloudParams())


def visits_on_a_line(stops: dict[int, int]) -> list[Visit]:
    """A robot that goes 1 m in 2 s for 400 m and stands for ``stops`` {at m: s}."""
    cloud = recording().visits[0].cloud
    found: list[Visit] = []
    now_ns = 0
    for metre in range(400):
        for _ in range(1 + stops.get(metre, 0) // 2):
            found.append(
                Visit(cloud=replace(cloud, stamp_ns=now_ns), pose=Pose2(float(metre), 0.0, 0.0))
            )
            now_ns += 2 * SECOND_NS
    return found


def test_no_mapping_scan_is_of_the_pass_that_is_sought() -> None:
    visits = visits_on_a_line(stops={99: 600, 310: 90})
    parts = cut(visits, 4)
    asked = np.concatenate([rows for rows, _ in parts])
    assert sorted(asked) == list(range(len(visits)))
    for rows, mapping in parts:
        assert len(mapping) > 0
        for part, other in itertools.product(rows[[0, -1]], mapping):
            apart_ns = abs(visits[part].stamp_ns - visits[other].stamp_ns)
            assert apart_ns >= APART_S * SECOND_NS
            # On a line, the way is the distance: ten minutes' rest is no other pass.
            assert visits[part].pose.distance_to(visits[other].pose) >= APART_M
            assert other not in rows


def test_a_recording_shorter_than_the_gap_has_no_passes() -> None:
    assert passes(visits_on_a_line({})[:20]) == []


def test_places_of_other_rounds_are_covered_and_others_are_not() -> None:
    parts = passes(recording().visits, 4)
    assert np.mean(np.concatenate([part.covered for part in parts]) >= COVERED) > 0.95
    lost = [replace(visit, pose=Pose2(50.0, 0.0, 0.0) @ visit.pose) for visit in parts[0].asked]
    shifted = passes([*lost, *parts[1].asked, *parts[2].asked, *parts[3].asked], 4)
    assert np.mean(shifted[0].covered) < 0.1


def test_scans_without_a_reference_pose_and_standing_ones_are_left_out() -> None:
    whole = recording()
    scans = [sample for sample in whole.samples if isinstance(sample, Scan)]
    late = replace(scans[0], stamp_ns=scans[0].stamp_ns + SECOND_NS)
    stands = replace(scans[0], stamp_ns=scans[0].stamp_ns + 2 * SECOND_NS)
    reference = Trajectory(
        stamps_ns=np.array([scans[0].stamp_ns, stands.stamp_ns]),
        poses=np.array([whole.visits[0].pose.as_array()] * 2),
    )
    some = Recording.of("x", Log(samples=(scans[0], late, stands)), reference, CloudParams())
    assert [visit.stamp_ns for visit in some.visits] == [scans[0].stamp_ns]
    assert late.stamp_ns not in [sample.stamp_ns for sample in some.samples]


def test_fewer_scans_are_some_of_more() -> None:
    parts = passes(recording().visits, 4)
    few, many = choose(parts, 10, seed=3), choose(parts, 40, seed=3)
    assert sum(map(len, few)) == 10
    assert all(set(a) <= set(b) for a, b in zip(few, many, strict=True))
    assert sum(map(len, choose(parts, 10, 0, (0.0, 0.1)))) == 0


def test_evidence_knows_right_from_wrong() -> None:
    queries = list(evidence(recording(), SlamParams(), (0.5,), count=3))
    assert len(queries) == 3
    assert all(query.right and query.rank == 1 and query.findable for query in queries)
    assert max(query.trial.error_m for query in queries) < 0.05


def test_answers_are_judged_by_the_reference() -> None:
    """Against a reference that is half a metre off, right answers are wrong."""
    part = passes(recording().visits, 4)[1]
    off = Pose2(0.5, 0.0, 0.0)
    bent = replace(part, asked=tuple(replace(visit, pose=visit.pose @ off) for visit in part.asked))
    params = SlamParams()
    queries = list(ask("simulated", 1, bent, [5, 20], part.map(params), params, (0.5,)))
    assert len(queries) == 2
    assert not any(query.right or query.rank == 1 or query.findable for query in queries)
    assert all(query.trial.error_m == pytest.approx(0.5, abs=0.05) for query in queries)


def test_driving_on_ends_with_a_right_claim_or_none() -> None:
    whole = recording()
    part = passes(whole.visits, 4)[1]
    known = part.map(SlamParams())
    claim = first_claim(whole, known, SlamParams(), part.asked[4].stamp_ns, part.end_ns)
    assert claim.located
    assert not claim.wrong
    assert not claim.cut_short
    assert 1 <= claim.scans <= 4
    none = first_claim(whole, known, SlamParams(), part.end_ns + 1, part.end_ns + 2)
    assert none.cut_short
    assert not none.located
    # The claim is judged at the scan's own stamp, against the reference.
    off = replace(
        whole,
        reference=Trajectory(
            stamps_ns=whole.reference.stamps_ns,
            poses=whole.reference.poses + np.array([0.0, 0.0, math.radians(6.0)]),
        ),
    )
    assert first_claim(off, known, SlamParams(), part.asked[4].stamp_ns, part.end_ns).wrong


@pytest.mark.skipif(not LOGS.is_dir(), reason="public robot logs are not here")
def test_one_recording_in_full(tmp_path: Path) -> None:
    for name in ("seattle.log.gz", "seattle.corrected.tum"):
        (tmp_path / name).symlink_to(LOGS / name)
    section = run(Effort(scale=0.05, progress=lambda _: None), tmp_path)
    tables = {table.title: table for table in section.tables}
    (kind,) = tables["By kind, g = 0.5 m"].rows
    assert kind[0] == "corridors"
    assert float(kind[2].removesuffix(" %")) >= 75.0
    rows = tables["Absolute localization from one scan"].rows
    assert [row[1] for row in rows] == ["0.2", "0.5", "0.8"]
    (drives,) = tables["Driving on until the answer is unique, g = 0.5 m"].rows
    assert drives[-1] == "0"


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no recording"):
        run(Effort(), tmp_path)
