"""Compiled or not, cached or not: the same answers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, world_of

from amr_slam import compiled
from amr_slam.compiled import ENABLED, Loop, jit
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.params import SlamParams
from amr_slam.registration.icp import Prior
from amr_slam.slam import Verdict, slam_absolute, slam_relative

TESTS = Path(__file__).resolve().parent
needs_numba = pytest.mark.skipif(not compiled.INSTALLED, reason="numba is not installed")

WORLD = world_of(
    np.array(
        [
            [0.0, 0.0, 8.0, 0.0],
            [8.0, 0.0, 8.0, 6.0],
            [8.0, 6.0, 0.0, 6.0],
            [0.0, 6.0, 0.0, 0.0],
            [5.0, 0.0, 5.0, 1.5],
            [2.0, 6.0, 2.0, 4.2],
            [2.0, 4.2, 3.1, 4.2],
        ]
    )
)
"""A room with nooks: no place in it looks like another."""
TRUTH = Pose2(3.3, 2.4, 0.7)


def answers() -> dict[str, list[float]]:
    """Verdicts and poses of one absolute and one relative localization."""
    params, rng = SlamParams(), np.random.default_rng(0)
    grown = PointMap(MapParams())
    for pose in (Pose2(2, 2, 0.3), Pose2(4, 4, -1.0), Pose2(6, 3, 2.0), Pose2(3.5, 3, 1.0)):
        grown.insert(cloud_at(WORLD, pose, rng, sigma_m=0.01), pose)
    cloud = cloud_at(WORLD, TRUTH, rng, sigma_m=0.01)
    prior = Prior(target_from_source=TRUTH @ Pose2(0.1, -0.1, 0.05), information=100.0 * np.eye(3))
    found = {
        "absolute": slam_absolute(cloud, grown, params),
        "relative": next(slam_relative(cloud, grown, prior, params)),
    }
    result = {"enabled": [float(ENABLED)]}
    for name, answer in found.items():
        assert answer.verdict is Verdict.ACCEPTED
        assert answer.best is not None
        result[name] = [*answer.best.pose.as_array(), answer.best.score, answer.margin]
    return result


def elsewhere(code: str, **environment: str) -> str:
    """What a Python process of its own prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(TESTS), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


CHOSEN = "import json, test_compiled; print(json.dumps(test_compiled.answers()))"
ABSENT = f"import sys; sys.modules['numba'] = None; {CHOSEN}"


@needs_numba
@pytest.mark.parametrize(
    ("code", "wanted"), [(CHOSEN, "0"), (ABSENT, "1")], ids=["chosen", "numba is absent"]
)
def test_numpy_gives_the_same_answers(code: str, wanted: str) -> None:
    mine = answers()
    theirs = json.loads(elsewhere(code, AMR_SLAM_COMPILED=wanted))
    assert theirs.pop("enabled") == [0.0]
    for name in ("absolute", "relative"):
        np.testing.assert_allclose(theirs[name], mine[name], atol=1e-6)
        assert Pose2.from_array(np.array(mine[name][:3])).distance_to(TRUTH) < 0.02


@needs_numba
def test_a_function_without_a_file_is_compiled_without_a_cache() -> None:
    """Numba refuses to keep what it cannot find again; that must not stop the program."""
    scope: dict[str, object] = {}
    exec("def half(x):\n    return 0.5 * x", scope)  # no file to keep the code beside
    half = scope["half"]
    assert callable(half)
    made = jit(half)
    assert made(3.0) == 1.5
    assert isinstance(made, Loop)
    assert made.machine.signatures  # it is compiled, not passed through


@needs_numba
def test_without_any_place_for_the_cache_it_compiles_all_the_same(tmp_path: Path) -> None:
    """A read-only installation without a home, as in a container: each place is a file here,
    which stops the superuser as well."""
    (tmp_path / "no_folder").touch()
    (tmp_path / "__pycache__").touch()
    loop = "from amr_slam.compiled import jit\n\n\n@jit\ndef twice(x):\n    return 2.0 * x\n"
    (tmp_path / "lonely.py").write_text(loop)
    nowhere = str(tmp_path / "no_folder" / "cache")
    printed = elsewhere(
        f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import lonely; "
        "print(lonely.twice(4.0), len(lonely.twice.machine.signatures))",
        NUMBA_CACHE_DIR=nowhere,
        XDG_CACHE_HOME=nowhere,
        HOME=nowhere,
    )
    assert printed.split() == ["8.0", "1"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "__pycache__",
        "lonely.py",
        "no_folder",
    ]


@needs_numba
def test_numbers_that_are_none_mean_what_they_mean_in_numpy() -> None:
    """No fast-math, and a division by zero is no exception."""
    made = jit(_ratio_is_finite)
    assert not made(1.0, 0.0)
    assert not made(0.0, 0.0)
    assert not made(float("nan"), 1.0)
    assert made(1.0, 2.0)


def _ratio_is_finite(a: float, b: float) -> bool:
    ratio = a / b
    return bool(ratio - ratio == 0.0)
