"""ROS 2's keys behind a site's router: who speaks, who hears, whose initial pose arrives."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
import zenoh.ext
from messages import pose_of, status_of
from ros2_bytes import loop_that_draws, ros_pose, serialized
from test_keys import DEADLINE_S, member, router, session, until

from amr_slam.cli import main
from amr_slam.encodings.ros2 import Ros2Encoder, Ros2Settings
from amr_slam.encodings.ros2.keys import GRID, POSE
from amr_slam.keys import create, read_credentials
from amr_slam.keys.site import Site
from amr_slam.publishing import RobotPublisher
from amr_slam.serving import Asked, ImageWanted
from amr_slam.wire import CommandReply, ZenohSettings

SETTINGS = Ros2Settings(plain=True, rmw_zenoh=True, initialpose=True)
START = f"0/amr7/{{}}/{POSE.dds_name}/RIHS01_{POSE.hash}"
KEYS = {
    "plain": ("amr7/pose", "amr7/initialpose"),
    "rmw": (START.format("pose"), START.format("initialpose")),
}
MAPS = {"plain": "amr7/map", "rmw": f"0/amr7/map/{GRID.dds_name}/RIHS01_{GRID.hash}"}


class Site7:
    """A router with a site's rules, robot amr7 behind it, and whoever else is wanted."""

    def __init__(self, folder: Path, site: Site, stack: ExitStack) -> None:
        self._folder = folder
        self._stack = stack
        self.asked: list[Asked] = []
        self.endpoint = stack.enter_context(router(site, "tls"))
        network = ZenohSettings(
            listen=(), connect=(self.endpoint,), keys=folder / "robots/amr7"
        )  # fmt: skip
        encoder = Ros2Encoder(SETTINGS, "amr7", b"run")
        self.robot = stack.enter_context(RobotPublisher(network, "amr7", [encoder]))
        self.robot.serve(self._loop)

    def _loop(self, asked: Asked) -> None:
        if isinstance(asked.request, ImageWanted):
            loop_that_draws([])(asked)
            return
        self.asked.append(asked)
        asked.done(CommandReply(ok=True))

    def who(self, name: str) -> zenoh.Session:
        credentials = read_credentials(self._folder / name)
        return self._stack.enter_context(session(member(credentials, self.endpoint)))


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def made(folder: Path) -> Site:
    site = create(folder, "hall3", ["127.0.0.1"])
    for robot in ("amr7", "amr8"):
        site.add_robot(robot, 30)
    site.add_controller("rviz", 30, commands=True)
    site.add_controller("board", 30, commands=False)
    return site


@pytest.mark.parametrize("kind", KEYS)
def test_robots_speak_for_themselves_and_commanders_place_them(
    tmp_path: Path, stack: ExitStack, kind: str
) -> None:
    site = made(tmp_path / "keys")
    site.allow_ros2(0)
    here = Site7(tmp_path / "keys", site, stack)
    pose_key, initialpose_key = KEYS[kind]
    heard: list[bytes] = []
    board, rviz, forger = (here.who(n) for n in ("fleet/board", "fleet/rviz", "robots/amr8"))
    board.declare_subscriber(pose_key, lambda s: heard.append(s.payload.to_bytes()))

    def true_pose_comes() -> bool:
        forger.put(pose_key, b"forged")
        here.robot.publish_pose(pose_of())
        time.sleep(0.01)
        return len(heard) >= 20

    until(true_pose_comes)
    assert b"forged" not in heard

    def tokens() -> set[str]:
        replies = board.liveliness().get("@ros2_lv/0/**", timeout=DEADLINE_S)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok}

    true = tokens()
    assert len(true) == 8
    forged = "@ros2_lv/0/abc/0/0/NN/%/%amr7/amr_slam"
    own = forged.replace("amr7", "amr8")
    held = [forger.liveliness().declare_token(key) for key in (forged, own)]
    until(lambda: tokens() == true | {own})
    assert len(held) == 2

    here.robot.publish_status(status_of())
    maps: list[bytes] = []
    late = zenoh.ext.declare_advanced_subscriber(
        board,
        MAPS[kind],
        lambda s: maps.append(s.payload.to_bytes()),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    until(lambda: len(maps) == 1)
    late.undeclare()  # type: ignore[no-untyped-call]
    again = zenoh.ext.declare_advanced_subscriber(
        board,
        MAPS[kind],
        lambda s: maps.append(s.payload.to_bytes()),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    until(lambda: len(maps) == 2)
    again.undeclare()  # type: ignore[no-untyped-call]

    place = serialized(POSE, ros_pose(5, "map", pose_of()))
    for stranger in (board, forger):
        stranger.put(initialpose_key, serialized(POSE, ros_pose(5, "map", pose_of(x=99.0))))

    def placed() -> bool:
        rviz.put(initialpose_key, place)
        time.sleep(0.05)
        return len(here.asked) >= 3

    until(placed)
    assert {one.request.x for one in here.asked} == {1.5}  # type: ignore[union-attr]
    assert here.robot.refused == 0


def test_where_the_site_has_no_ros2_nothing_of_it_passes(tmp_path: Path, stack: ExitStack) -> None:
    here = Site7(tmp_path / "keys", made(tmp_path / "keys"), stack)
    heard: list[str] = []
    rviz = here.who("fleet/rviz")
    for key in ("amr7/pose", START.format("pose"), "amr/amr7/pose"):
        rviz.declare_subscriber(key, lambda s: heard.append(str(s.key_expr)))

    def json_comes() -> bool:
        rviz.put("amr7/initialpose", serialized(POSE, ros_pose(5, "map", pose_of())))
        here.robot.publish_pose(pose_of())
        time.sleep(0.01)
        return len(heard) >= 20

    until(json_comes)
    assert set(heard) == {"amr/amr7/pose"}
    assert not [r for r in rviz.liveliness().get("@ros2_lv/0/**", timeout=1.0) if r.ok]
    assert here.asked == []


def test_the_command_switches_it_on_and_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    made(keys)

    def rules() -> str:
        settings = json.loads((keys / "router/router.json5").read_text())
        return json.dumps(settings["access_control"]["rules"])

    before = rules()
    assert "initialpose" not in before
    assert main(["keys", "ros2", "3", "--dir", str(keys)]) == 0
    assert "robots may speak domain 3 of ROS 2" in capsys.readouterr().out
    assert f"3/amr7/initialpose/{POSE.dds_name}/*" in rules()
    assert main(["keys", "ros2", "off", "--dir", str(keys)]) == 0
    assert rules() == before
    for wrong in ("233", "-1", "on"):
        with pytest.raises(SystemExit) as ended:
            main(["keys", "ros2", "--dir", str(keys), "--", wrong])
        assert ended.value.code == 2
