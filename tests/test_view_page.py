"""``amr-slam view`` in Chromium, in front of three robots that drive, on real sessions."""

from __future__ import annotations

import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
import zenoh
from test_publishing import free_endpoint

from amr_slam.serving import Asked
from amr_slam.studies.browsing import (
    View,
    browser,
    chromium_path,
    read,
    view_process,
    wait_for,
)
from amr_slam.studies.fleet.driving import Course, DrivingRobot
from amr_slam.studies.fleet.processes import program
from amr_slam.wire import CommandReply, PoseMessage, SetPose
from amr_slam.wire.commands import FoundPose

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytestmark = [
    pytest.mark.skipif(
        chromium_path() is None, reason="chromium is not installed: apt-get install chromium"
    ),
    pytest.mark.timeout(400),
]

DEADLINE_S = 90.0
NAMES = ("amr01", "amr02", "amr03")
REACH_PX = 12
"""Around a robot, in which its glyph is looked for."""
PLACES_M = (2.0, 16.0, 30.0)
"""Along the round."""


@dataclass
class Convoy:
    """Three robots, published ten times a second by one thread."""

    endpoint: str
    robots: dict[str, DrivingRobot]
    asked: list[Asked] = field(default_factory=list)
    frozen: set[str] = field(default_factory=set)
    stop: threading.Event = field(default_factory=threading.Event)

    def run(self) -> None:
        while not self.stop.wait(0.1):
            for name, robot in self.robots.items():
                if name not in self.frozen:
                    robot.publish()

    def sent(self, name: str, seq: int) -> PoseMessage:
        return next(pose for pose in self.robots[name].poses if pose.seq == seq)

    def answer(self, asked: Asked) -> None:
        self.asked.append(asked)
        if isinstance(asked.request, SetPose):
            asked.done(CommandReply(ok=True, pose=FoundPose(x=1.25, y=-3.5, theta=0.5)))
        else:
            asked.not_done("nothing fits")


@dataclass(frozen=True)
class Rig:
    convoy: Convoy
    view: View
    browser: Any
    restart_router: Callable[[], None]
    stop_router: Callable[[], None]

    @contextmanager
    def page(self, address: str | None = None, **options: Any) -> Iterator[Any]:
        """A page that shows the map and all robots."""
        with self.browser.new_context(viewport={"width": 1200, "height": 800}, **options) as opened:
            page = opened.new_page()
            complaints: list[str] = []
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.goto(self.view.address if address is None else address)
            wait_for(page, "v.layer.map && v.store.robots.size >= 3", DEADLINE_S)
            yield page
            assert complaints == []


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    endpoint = free_endpoint()
    course = Course.laid(tmp_path_factory.mktemp("view"))
    convoy = Convoy(endpoint, {})
    with ExitStack() as opened:
        routers = [opened.enter_context(ExitStack())]
        routers[0].enter_context(program("router", endpoint))
        for number, name in enumerate(NAMES):
            convoy.robots[name] = opened.enter_context(
                DrivingRobot(
                    name,
                    course,
                    start_m=0.33 * course.length_m * number,
                    connect=(endpoint,),
                    answer=convoy.answer,
                )
            )
        thread = threading.Thread(target=convoy.run)
        thread.start()
        opened.callback(thread.join)
        opened.callback(convoy.stop.set)
        view = opened.enter_context(view_process(endpoint, ["--allow-commands"]))
        chromium = opened.enter_context(browser())

        def stop_router() -> None:
            routers[-1].close()

        def restart_router() -> None:
            routers.append(opened.enter_context(ExitStack()))
            routers[-1].enter_context(program("router", endpoint))

        yield Rig(convoy, view, chromium, restart_router, stop_router)


def notices(page: Any) -> str:
    return str(page.locator("#notices").inner_text())


def until(page: Any, condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"in vain: {what}"
        page.wait_for_timeout(30.0)


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


def glyph(page: Any, name: str) -> dict[str, Any]:
    """What is drawn around a robot; a stale one, as on a busy computer, is hollow."""
    found: dict[str, Any] = {}

    def is_filled() -> bool:
        found.update(page.evaluate(GLYPH, [name, REACH_PX]))
        return found["state"] == "localized" and bool(found["count"] > 100)

    until(page, is_filled, f"{name} is drawn as localized: {found}")
    return found


GLYPH = """([name, reach]) => {
    const { store, camera } = window.amrSlam;
    const { pose, state } = store.robots.get(name);
    const style = getComputedStyle(document.documentElement);
    const hex = style.getPropertyValue(`--state-${state}`).trim();
    const wanted = [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16));
    const [px, py] = camera.toScreen(pose.x, pose.y);
    const ctx = document.getElementById("canvas").getContext("2d");
    const is = (x, y) => {
        const data = ctx.getImageData(Math.floor(x), Math.floor(y), 1, 1).data;
        return wanted.every((value, i) => Math.abs(value - data[i]) < 12);
    };
    let [count, sx, sy] = [0, 0, 0];
    for (let y = Math.floor(py) - reach; y <= py + reach; y += 1) {
        for (let x = Math.floor(px) - reach; x <= px + reach; x += 1) {
            if (is(x, y)) { count += 1; sx += x + 0.5; sy += y + 0.5; }
        }
    }
    const at = (k) => [px + 11 * k * Math.cos(pose.theta), py - 11 * k * Math.sin(pose.theta)];
    return {
        state, count, centre: [sx / count, sy / count], expected: [px, py],
        ahead: is(...at(0.6)), behind: is(...at(-0.7)),
    };
}"""


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
        page.keyboard.press("l")  # the slider has the keys: it is no shortcut there
        page.locator("#canvas").focus()
        page.keyboard.press("l")
        assert read(page, "v.store.past") is None


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


def test_a_frozen_robot_is_stale_soon(rig: Rig) -> None:
    with rig.page() as page:
        row = page.locator("[data-robot=amr02]")
        until(page, lambda: "Localized" in row.inner_text(), "amr02 is well")
        rig.convoy.frozen.add("amr02")
        begun_s = time.monotonic()
        wait_for(page, "v.store.robots.get('amr02').state === 'stale'", DEADLINE_S)
        # Contract: 1.5 s (benchmarks/view.py measures it); tests share their processors.
        assert time.monotonic() - begun_s < 6.0
        until(page, lambda: "Stale" in row.inner_text(), "the list says so")
        assert "Localized" in page.locator("[data-robot=amr01]").inner_text()
        rig.convoy.frozen.clear()
        until(page, lambda: "Localized" in row.inner_text(), "amr02 is well again")


def test_what_makes_no_sense_leaves_the_page_alive_and_is_told(rig: Rig) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([rig.convoy.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with rig.page() as page, zenoh.open(config) as stranger:
        evil = '<img src=x onerror="window.owned=1">'
        for key, payload in (
            ("amr/amr01/fleet_pose", b"{"),
            ("amr/amr01/status", b"\xff" * 70_000),
            (f"amr/{evil}/status", b'{"v": 1}'),
            ("amr/amr01/scan", b"[[[[" * 2000),
        ):
            stranger.put(key, payload)
        until(page, lambda: "amr01" in notices(page), "the notice")
        assert "made no sense" in notices(page)
        until(page, lambda: evil in page.locator("#robots").inner_text(), "the stranger's name")
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
