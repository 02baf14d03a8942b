"""What a map is said to weigh."""

from __future__ import annotations

import numpy as np

from amr_slam.map import PointMap
from amr_slam.params import preset
from amr_slam.studies.scaling import held_bytes, measure
from amr_slam.studies.scenes import S300, laboratory_scene


def test_held_bytes_counts_each_buffer_once_with_all_that_views_keep() -> None:
    known = PointMap(preset("default").map)
    empty = held_bytes(known)
    buffer = np.zeros((1000, 2))
    known.walls.sums = buffer
    known.space.sums = buffer[:10]
    assert held_bytes(known) == empty - held_bytes_of_empty_sums() + buffer.nbytes


def held_bytes_of_empty_sums() -> int:
    known = PointMap(preset("default").map)
    return int(known.walls.sums.nbytes + known.space.sums.nbytes)


def test_a_laboratory_is_measured() -> None:
    row = measure(laboratory_scene(11), S300, 3)
    assert len(row.cells()) == 13
    assert all(trial.right for trial in row.trials)
    assert 150.0 < row.area_m2 < 210.0
    assert 1e5 < row.file_bytes < row.memory_bytes < 2e7
