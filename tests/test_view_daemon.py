"""``amr-slam view`` in front of a daemon: bytes of scanners and wheels, a map and what has changed
in it on the robot's disk, Zenoh, and what the page makes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemon_rig import ROBOT, Daemon, Robot
from labs import cloud_at, world_of
from view_rig import DEADLINE_S

from amr_slam.geometry import Array, Pose2
from amr_slam.living import Watcher, WatchParams, changes_path, save_changes
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.simulation import World, laboratory, plan_tour
from amr_slam.simulation.shapes import box, edges
from amr_slam.studies.browsing import browser, chromium_path, read, view_process, wait_for

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [
    pytest.mark.skipif(
        chromium_path() is None, reason="chromium is not installed: apt-get install chromium"
    ),
    pytest.mark.timeout(400),
]

KNOWN = np.diag([1e-4, 1e-4, 1e-5])


def in_map_frame(world: World, world_from_map: Pose2) -> World:
    ends = world.segments_m.reshape(-1, 2)
    return world_of((world_from_map.inverse() @ ends).reshape(-1, 4))


def keep_map_and_changes(folder: Path) -> Array:
    """``hall.amrmap`` of the laboratory that :class:`Robot` turns in, and beside it what two visits
    have seen: a box that stood there has gone, another one has come. Returns their middles."""
    lab = laboratory(3)
    tour = plan_tour(lab)
    world = in_map_frame(lab, tour.world_from_map)
    path_m = tour.world_from_map.inverse() @ np.array(tour.path_m)
    stops = [Pose2(x, y, 0.4 * n) for n, (x, y) in enumerate(path_m[:: len(path_m) // 7])]
    was, now = middles = path_m[[len(path_m) // 3, len(path_m) // 2]]
    square = box(0.5, 0.5)

    def with_box(middle: Array) -> World:
        return world_of(np.concatenate([world.segments_m, edges(square + middle)]))

    stops = [stop for stop in stops if np.hypot(*(middles - stop.translation).T).min() > 0.8]
    rng = np.random.default_rng(0)
    known = PointMap(MapParams(), "hall")
    for stamp, stop in enumerate([Pose2.identity(), *stops]):
        known.insert(cloud_at(with_box(was), stop, rng, sigma_m=0.01, stamp_ns=stamp), stop)
    watcher, utc_s = Watcher(known, WatchParams()), 1.7e9
    for _ in range(2):
        for stop in [*stops, *stops]:
            cloud = cloud_at(with_box(now), stop, rng, sigma_m=0.01)
            watcher.see(cloud, stop, KNOWN, round(1e9 * utc_s))
            utc_s += 8.0
        utc_s += 600.0
    path = folder / "hall.amrmap"
    save_changes(watcher, known, save_map(known, path), changes_path(path))
    return middles


def test_a_daemon_is_seen_with_what_has_changed_and_told_to_extend_its_map(
    tmp_path: Path,
) -> None:
    gone_m, new_m = keep_map_and_changes(tmp_path)
    with (
        Robot(tmp_path),
        Daemon(tmp_path, localize=True) as daemon,
        browser() as chromium,
    ):
        daemon.listen()
        with view_process(daemon.endpoint, ["--allow-commands"]) as view:
            page = chromium.new_page(viewport={"width": 1200, "height": 800})
            page.goto(view.address)
            robot = f"v.store.robots.get('{ROBOT}')"
            wait_for(page, f"v.layer.map && {robot}?.state === 'localized'", DEADLINE_S)
            wait_for(page, "v.changes.drawn.length > 0", DEADLINE_S)
            drawn = read(page, "v.changes.drawn")
            for what, middle in (("gone", gone_m), ("new", new_m)):
                near = [one for one in drawn if one["what"] == what and is_in(one["box"], middle)]
                assert near, (what, middle, drawn)
                assert near[0]["since"] == pytest.approx(1.7e9, abs=1000.0)
                assert colours(page, near[0]["box"], what) > 20
            page.keyboard.press("c")
            assert read(page, "v.changes.drawn") == []
            page.wait_for_timeout(300.0)  # drawn since
            assert colours(page, near[0]["box"], "new") == 0

            page.locator(f"[data-robot={ROBOT}]").click()
            page.locator("[data-action=extend_map]").click()
            page.locator("dialog .primary").click()
            page.locator("dialog .reply.ok").wait_for(timeout=1000.0 * DEADLINE_S)
            wait_for(page, f"{robot}.state === 'mapping'", DEADLINE_S)
            page.keyboard.press("Escape")
            wait_for(page, "document.getElementById('changes').hidden", DEADLINE_S)
        assert daemon.stop() == 0
    assert (tmp_path / "hall.amrmap.1").exists()  # the version before


def is_in(box_m: list[float], middle_m: Array) -> bool:
    x, y = middle_m.tolist()
    return bool(box_m[0] - 0.4 <= x <= box_m[2] + 0.4 and box_m[1] - 0.4 <= y <= box_m[3] + 0.4)


def colours(page: Any, box_m: list[float], what: str) -> int:
    """Pixels of a change's colour on its box and around it."""
    return int(page.evaluate(COLOURS, [box_m, what]))


COLOURS = """([[x0, y0, x1, y1], what]) => {
    const { camera } = window.amrSlam;
    const hex = getComputedStyle(document.documentElement).getPropertyValue(`--${what}`).trim();
    const wanted = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
    const [left, bottom] = camera.toScreen(x0, y0);
    const [right, top] = camera.toScreen(x1, y1);
    const ctx = document.getElementById("canvas").getContext("2d");
    const { data } = ctx.getImageData(left - 8, top - 8, right - left + 16, bottom - top + 16);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) {
        if (wanted.every((value, k) => Math.abs(value - data[i + k]) < 30)) count += 1;
    }
    return count;
}"""
