"""``amr-slam view`` in Chromium, in front of three robots that drive, on real sessions."""

from __future__ import annotations

import hashlib
import json
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import Any

import pytest
import zenoh
from test_publishing import free_endpoint

from amr_slam.map import MapParams, PointMap
from amr_slam.map.file import MAGIC, encode
from amr_slam.serving import Asked
from amr_slam.studies.browsing import View, browser, view_process, wait_for
from amr_slam.studies.fleet.driving import Course, DrivingRobot
from amr_slam.studies.fleet.processes import program
from amr_slam.wire import CommandReply, PoseMessage, SetPose
from amr_slam.wire.commands import FoundPose

DEADLINE_S = 90.0
NAMES = ("amr01", "amr02", "amr03")
REACH_PX = 12
"""Around a robot, in which its glyph is looked for."""


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


def huge() -> tuple[str, bytes]:
    """A map's file, whole by its checksum, whose header promises a thousand times what it has."""
    data, map_id = encode(PointMap(MapParams(), "giant"))
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    begin = len(MAGIC) + 4
    header = json.loads(data[begin : begin + length])
    header["rows"] = dict.fromkeys(header["rows"], 10**8)
    text = json.dumps(header).encode()
    body = MAGIC + struct.pack("<I", len(text)) + text + zlib.compress(bytes(2**26), 6)
    return str(map_id), body + hashlib.sha256(body).digest()


@contextmanager
def stranger_at(endpoint: str) -> Iterator[zenoh.Session]:
    """Somebody who may say anything."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        # What is put before the view's wishes are known here gets lost.
        anything = session.declare_publisher("amr/amr01/status")
        deadline = time.monotonic() + DEADLINE_S
        while not anything.matching_status.matching:  # type: ignore[attr-defined]  # no bool
            assert time.monotonic() < deadline, "in vain: somebody who listens"
            time.sleep(0.01)
        anything.undeclare()  # type: ignore[no-untyped-call]  # as in client
        yield session
