"""What ``amr-slam view`` shows of three robots that drive, and what can be done with it."""

from __future__ import annotations

import json
import math
import os
import signal
import uuid

import pytest
import zenoh
from messages import pose_of, status_of
from view_rig import DEADLINE_S, NAMES, Rig, glyph, huge, notices, rig, stranger_at, until

from amr_slam.studies.browsing import chromium_path, read, wait_for
from amr_slam.wire import MAX_MAP_BYTES, MapPart, SetPose

__all__ = ["rig"]

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [
    pytest.mark.skipif(
        chromium_path() is None, reason="chromium is not installed: apt-get install chromium"
    ),
    pytest.mark.timeout(400),
]

STALE_S = 1.5
PLACES_M = (2.0, 16.0, 30.0)
"""Along the round."""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_robots_are_drawn_where_their_poses_say(rig: Rig, scheme: str) -> None:
    with rig.page(color_scheme=scheme) as page:
        assert read(page, "v.layer.map.layers[0].name") == "pallets"
        told = {name: read(page, f"v.store.robots.get('{name}').pose") for name in NAMES}
        for name, pose in told.items():
            sent = rig.convoy.sent(name, pose["seq"])
            assert (pose["x"], pose["y"], pose["theta"]) == (sent.x, sent.y, sent.theta)
            assert pose["map"] == sent.map
        moved = "v.store.robots.get('amr01').pose"
        until(
            page,
            lambda: math.dist([read(page, f"{moved}.{k}") for k in "xy"],
                              [told["amr01"][k] for k in "xy"]) > 0.3,
            "the robot moves on the page",
        )  # fmt: skip
        for number, robot in enumerate(rig.convoy.robots.values()):
            robot.speed_mps = 0.0
            robot.way_m = PLACES_M[number]  # apart: no name lies on another's glyph
        wait_for(page, "v.store.robots.get('amr03').pose.vx === 0", DEADLINE_S)
        page.wait_for_timeout(300.0)  # drawn since
        for name in NAMES:
            sent = rig.convoy.robots[name].poses[-1]
            found = glyph(page, name)
            assert math.dist(found["centre"], found["expected"]) < 3.0, (name, found)
            assert (found["ahead"], found["behind"]) == (True, False), (name, found)
            x, y = read(page, f"v.camera.toMap(...{json.dumps(found['expected'])})")
            assert math.dist((x, y), (sent.x, sent.y)) < 1e-6
        for robot in rig.convoy.robots.values():
            robot.speed_mps = 0.6


def test_a_pose_is_set_by_dragging_and_the_reply_is_shown(rig: Rig) -> None:
    with rig.page() as page:
        page.locator("[data-robot=amr02]").click()
        page.locator("[data-action=set_pose]").click()
        box = page.locator("#canvas").bounding_box()
        start, end = (400.0, 300.0), (400.0, 220.0)  # towards +y
        wanted = read(page, f"v.camera.toMap({start[0]}, {start[1]})")
        page.mouse.move(box["x"] + start[0], box["y"] + start[1])
        page.mouse.down()
        page.mouse.move(box["x"] + end[0], box["y"] + end[1], steps=3)
        page.mouse.up()
        before = len(rig.convoy.asked)
        page.locator("dialog input[name=radius]").fill("3")
        page.locator("dialog .primary").click()
        page.locator("dialog .reply.ok").wait_for(timeout=1000.0 * DEADLINE_S)
        (asked,) = [one.request for one in rig.convoy.asked[before:]]
        assert isinstance(asked, SetPose)
        assert (asked.x, asked.y) == pytest.approx(wanted, abs=1e-3)
        assert asked.theta == pytest.approx(math.pi / 2, abs=1e-3)
        assert asked.radius == 3.0
        assert "1.250, -3.500 m, 28.6°" in page.locator("dialog .reply").inner_text()
        page.keyboard.press("Escape")
        page.locator("[data-action=relocalize]").click()  # what the robot refuses, is shown, too
        page.locator("dialog .primary").click()
        page.locator("dialog .reply.alarm").wait_for(timeout=1000.0 * DEADLINE_S)
        assert "Not done: relocalize: nothing fits" in page.locator("dialog").inner_text()


def test_without_the_right_nothing_is_commanded(rig: Rig) -> None:
    address = rig.view.address.partition("#")[0]
    with rig.page(address) as page:
        page.locator("[data-robot=amr01]").click()
        assert page.locator("[data-action=relocalize]").is_disabled()
        assert "token" in page.locator(".why").inner_text()
        before = len(rig.convoy.asked)
        status, text = page.evaluate(
            """async () => {
                const response = await fetch("/api/command", {
                    method: "POST",
                    headers: { Authorization: "Bearer guessed-by-somebody" },
                    body: JSON.stringify({ robot: "amr01", command: "relocalize" }),
                });
                return [response.status, await response.text()];
            }"""
        )
        assert status == 403
        assert not json.loads(text)["ok"]
        assert len(rig.convoy.asked) == before


def test_the_past_is_there_for_who_opens_the_page_after_it(rig: Rig) -> None:
    with rig.page() as page:
        wait_for(page, "v.store.history.rings.get('amr03')?.count > 12", DEADLINE_S)
        # Scans are kept by the page, from when it was opened.
        wait_for(page, "v.store.scans.at('amr03', v.store.map, v.store.now() - 3.5)", DEADLINE_S)
        page.locator("#time").focus()
        for _ in range(3):
            page.keyboard.press("ArrowLeft")
        shown = read(
            page,
            "({time: v.store.now() - v.store.past, "
            "pose: v.store.shown().find(({ name }) => name === 'amr03').pose})",
        )
        then = min(
            rig.convoy.robots["amr03"].poses,
            key=lambda pose: math.dist((pose.x, pose.y), (shown["pose"]["x"], shown["pose"]["y"])),
        )
        # As it was told, half a second apart, never where it may have been.
        assert (shown["pose"]["x"], shown["pose"]["y"]) == pytest.approx((then.x, then.y), abs=1e-4)
        assert -0.2 < shown["time"] - then.stamp < 3.0
        assert "ago" in page.locator("#when").inner_text()
        assert page.evaluate(SHARE_OF_SCAN) > 0.5
        page.keyboard.press("l")  # the slider has the keys: it is no shortcut there
        page.locator("#canvas").focus()
        page.keyboard.press("l")
        assert read(page, "v.store.past") is None


SHARE_OF_SCAN = """() => {
    const { store, camera } = window.amrSlam;
    const points = store.scans.at("amr03", store.map, store.now() - store.past);
    const ctx = document.getElementById("canvas").getContext("2d");
    let blue = 0;
    for (let i = 0; i < points.length; i += 2) {
        const at = camera.toScreen(points[i], points[i + 1]);
        const [red, , deep] = ctx.getImageData(...at, 1, 1).data;
        blue += deep - red > 100;
    }
    return blue / (points.length / 2);
}"""
"""Of the scan that belongs to the instant: points that are drawn in its colour."""


def test_distances_are_measured_with_the_keys_alone(rig: Rig) -> None:
    with rig.page() as page:
        page.locator("#canvas").focus()
        page.keyboard.press("m")
        page.keyboard.press("Enter")
        page.keyboard.press("ArrowRight")
        page.keyboard.press("Enter")
        expected = 60.0 / read(page, "v.camera.scale")
        assert read(page, "v.mode().text").startswith(f"{expected:.3f} m   0.0°")
        page.keyboard.press("Escape")
        assert read(page, "v.mode()") is None


SINCE_POSE_S = "(({ turned, posed }) => (turned - posed) / 1000)(v.store.robots.get('amr02'))"
"""On the page's own clock: from the last pose that came in to the state that it shows."""


def test_a_frozen_robot_is_stale_soon(rig: Rig) -> None:
    with rig.page() as page:
        row = page.locator("[data-robot=amr02]")
        until(page, lambda: "Localized" in row.inner_text(), "amr02 is well")
        seen_s: list[float] = []
        # A busy computer adds to the time, and takes nothing from it: the shortest of a few counts.
        while not seen_s or (min(seen_s) > STALE_S and len(seen_s) < 4):
            rig.convoy.frozen.add("amr02")
            wait_for(page, "v.store.robots.get('amr02').state === 'stale'", DEADLINE_S)
            seen_s.append(read(page, SINCE_POSE_S))
            until(page, lambda: "Stale" in row.inner_text(), "the list says so")
            rig.convoy.frozen.clear()
            until(page, lambda: "Localized" in row.inner_text(), "amr02 is well again")
        assert 0.0 < min(seen_s) <= STALE_S
        assert "Localized" in page.locator("[data-robot=amr01]").inner_text()


def test_what_makes_no_sense_leaves_the_page_alive_and_is_told(rig: Rig) -> None:
    with rig.page() as page, stranger_at(rig.convoy.endpoint) as stranger:
        evil = '<img src=x onerror="window.owned=1">'

        def told() -> bool:
            """Said again and again: what the view's wishes do not reach in time gets lost."""
            for key, payload in (
                ("amr/amr01/fleet_pose", b"{"),
                ("amr/amr01/status", b"\xff" * 70_000),
                (f"amr/{evil}/status", b'{"v": 1}'),
                ("amr/amr01/scan", b"[[[[" * 2000),
            ):
                stranger.put(key, payload)
            return "amr01" in notices(page) and evil in page.locator("#robots").inner_text()

        until(page, told, "the notice, and the stranger's name")
        assert "made no sense" in notices(page)
        assert page.evaluate("window.owned") is None
        answer = page.evaluate(
            "async () => { const r = await fetch('/api/map?robot=nobody'); "
            "return [r.status, await r.text()]; }"
        )
        assert answer == [404, "no robot nobody is known here\n"]
        page.evaluate("window.amrSlam.link.send({ scans: ['nobody'] })")
        until(page, lambda: "no robot nobody is known here" in notices(page), "its notice")
        seq = read(page, "v.store.robots.get('amr01').pose.seq")
        wait_for(page, f"v.store.robots.get('amr01').pose.seq > {seq}", DEADLINE_S)


@pytest.mark.parametrize("what", ["claimed", "real"])
def test_a_huge_map_is_told_and_costs_neither_the_page_nor_its_other_map(
    rig: Rig, what: str
) -> None:
    """``claimed``: a few hundred kilobytes that would be gigabytes; ``real``: more bytes than a
    map may have on the network."""
    map_id, data = huge() if what == "claimed" else (str(uuid.uuid4()), bytes(MAX_MAP_BYTES + 1))
    name = f"giant-{what}"

    def give(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, data)

    with rig.page() as page, stranger_at(rig.convoy.endpoint) as stranger:
        shown = read(page, "v.store.map")
        stranger.declare_queryable(f"amr/{name}/map", give)
        token = stranger.liveliness().declare_token(f"amr/{name}/alive")
        about = MapPart(id=map_id, name="giant", version=1)
        stranger.put(f"amr/{name}/status", status_of(name, map=about).encode())
        stranger.put(f"amr/{name}/fleet_pose", pose_of(name, map=map_id).encode())
        page.locator(f"[data-robot={name}]").click(timeout=1000.0 * DEADLINE_S)
        until(page, lambda: "No map: " in notices(page), "the notice")
        complaint = {"claimed": "its map cannot be drawn: ", "real": "more than 67108864 bytes"}
        assert complaint[what] in notices(page)
        assert name in notices(page)
        page.locator("[data-robot=amr01]").click()
        wait_for(page, f"v.store.map === '{shown}' && v.layer.map", DEADLINE_S)
        token.undeclare()  # type: ignore[no-untyped-call]  # as in client
        until(page, lambda: "No map: " not in notices(page), "the end of the notice")
        seq = read(page, "v.store.robots.get('amr01').pose.seq")
        wait_for(page, f"v.store.robots.get('amr01').pose.seq > {seq}", DEADLINE_S)


def test_two_fingers_zoom_and_what_is_between_them_stays(rig: Rig) -> None:
    with rig.page(has_touch=True) as page:
        box = page.locator("#canvas").bounding_box()
        tools = page.context.new_cdp_session(page)

        def touch(kind: str, *fingers: tuple[float, float]) -> None:
            points = [{"x": box["x"] + x, "y": box["y"] + y, "id": n}
                      for n, (x, y) in enumerate(fingers)]  # fmt: skip
            tools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        scale = read(page, "v.camera.scale")
        middle = read(page, "v.camera.toMap(400, 300)")
        touch("touchStart", (350.0, 300.0))
        touch("touchStart", (350.0, 300.0), (450.0, 300.0))
        for step in range(1, 11):
            touch("touchMove", (350.0 - 10 * step, 300.0), (450.0 + 10 * step, 300.0))
        wait_for(page, f"v.camera.scale > {2.9 * scale}", DEADLINE_S)
        touch("touchEnd")
        assert read(page, "v.camera.scale") == pytest.approx(3.0 * scale, rel=0.01)
        assert read(page, "v.camera.toMap(400, 300)") == pytest.approx(middle, abs=3.0 / scale)
        assert read(page, "v.store.selected") is None  # no finger chose a robot
        # One finger moves the map.
        touch("touchStart", (400.0, 300.0))
        touch("touchMove", (430.0, 300.0))
        touch("touchMove", (460.0, 300.0))
        touch("touchEnd")
        x, _ = read(page, "v.camera.toMap(460, 300)")
        assert x == pytest.approx(middle[0], abs=3.0 / scale)


def test_a_router_that_goes_and_comes_back_is_shown(rig: Rig) -> None:
    with rig.page() as page:
        rig.stop_router()
        until(page, lambda: "is gone" in notices(page), "the loss")
        wait_for(page, "v.store.shown().every(({ state }) => "
                 "state === 'stale' || state === 'absent')", DEADLINE_S)  # fmt: skip
        rig.restart_router()
        until(page, lambda: "is gone" not in notices(page), "the return")
        wait_for(page, "v.store.robots.get('amr01').state === 'localized'", DEADLINE_S)


def test_a_server_that_hangs_makes_nothing_look_alive(rig: Rig) -> None:
    with rig.page() as page:
        os.kill(rig.view.process.pid, signal.SIGSTOP)
        try:
            until(page, lambda: "Nothing here is live" in notices(page), "the alarm")
            assert read(page, "v.store.shown().find(({ name }) => name === 'amr01').state") == (
                "stale"
            )
        finally:
            os.kill(rig.view.process.pid, signal.SIGCONT)
        until(page, lambda: "Nothing here is live" not in notices(page), "the return")
