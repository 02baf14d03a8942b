"""Before the first scan everything is compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, lab, tour_poses

from amr_slam import warming
from amr_slam.compiled import ENABLED, Loop
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap
from amr_slam.params import SlamParams, preset
from amr_slam.slam_request import SlamRequest

TESTS = Path(__file__).resolve().parent

COUNT = """
import test_warming
print(test_warming.compiled_after_the_first_scans())
"""


def signatures() -> dict[str, int]:
    """How many kinds of arguments each compiled loop of the program has been compiled for."""
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith(("amr_slam.registration", "amr_slam.map")):
            for key, value in vars(module).items():
                if isinstance(value, Loop):
                    found[f"{name}.{key}"] = len(value.machine.signatures)
    return found


def compiled_after_the_first_scans() -> list[str]:
    """What real scans still had to have compiled after the warming-up."""
    params = SlamParams()
    warming.warm_up(params)
    before = signatures()
    assert len(before) > 8
    rng = np.random.default_rng(0)
    poses = tour_poses(0)
    for sigma in (0.01, 0.1):
        grown = PointMap(params.map)
        mapping = SlamEngine(params, grown, "mapping")
        for pose in poses[20:24]:
            mapping.update(request(pose, rng, sigma))
        finding = SlamEngine(params, grown, "localization")
        finding.update(request(poses[22], rng, sigma))
        lost = request(poses[21] @ Pose2(0.1, 0.0, 2.0), rng, sigma)
        finding.update(SlamRequest(cloud=lost.cloud, map_from_base=None, covariance=None))
    after = signatures()
    return sorted(name for name in after if after[name] != before.get(name))


def request(pose: Pose2, rng: np.random.Generator, sigma_m: float) -> SlamRequest:
    cloud = cloud_at(lab(0), pose, rng, sigma_m=sigma_m)
    return SlamRequest(
        cloud=cloud, map_from_base=pose, covariance=np.diag([0.05**2, 0.05**2, 0.03**2])
    )


@pytest.mark.skipif(not ENABLED, reason="nothing is compiled")
def test_nothing_is_left_to_compile_for_the_first_scan() -> None:
    """In a process of its own: other tests have compiled everything here."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT],
        env={**os.environ, "PYTHONPATH": str(TESTS)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["default", "paper"])
def test_the_room_of_the_warming_up_is_localized_in(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every rung is climbed, else its loops stayed cold: the lost scan and the expected one."""
    results = []
    update = SlamEngine.update

    def kept(engine: SlamEngine, asked: SlamRequest) -> object:
        result = update(engine, asked)
        results.append((engine.mode, asked.map_from_base is None, result))
        return result

    monkeypatch.setattr(SlamEngine, "update", kept)
    monkeypatch.setattr(warming, "ENABLED", True)
    warming.warm_up(preset("paper" if name == "paper" else "default"))
    assert [mode for mode, _, _ in results].count("mapping") == 9
    lost = [result for mode, blind, result in results if mode == "localization" and blind]
    assert len(lost) == 3
    assert all(result.answer.best is not None for result in lost)


def test_without_compiled_loops_there_is_nothing_to_warm(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("an engine was started")

    monkeypatch.setattr(warming, "ENABLED", False)
    monkeypatch.setattr(warming, "SlamEngine", refuse)
    warming.warm_up(SlamParams())
