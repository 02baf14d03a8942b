from __future__ import annotations

import io
import json
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from messages import WELL, pose_of, status_of
from rich.console import Console

from amr_slam.client import RobotView, SessionError
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.watching import Sort, json_line, line, row_of, table, watch
from amr_slam.watching.rows import Rates
from amr_slam.wire import UNKNOWN, CandidatePart, ZenohSettings

DEADLINE_S = 20.0


def view_of(**changes: object) -> RobotView:
    fields: dict[str, object] = {
        "robot": "amr7",
        "alive": True,
        "pose": pose_of(),
        "status": status_of(),
        "pose_received_s": time.monotonic(),
    }
    return RobotView(**(fields | changes))  # type: ignore[arg-type]  # a field's name and value


def printed(*views: RobotView) -> str:
    console = Console(file=io.StringIO(), width=200, force_terminal=True, color_system="standard")
    console.print(table([row_of(view) for view in views], "tcp/here:1"))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_a_line_says_where_the_robot_is_and_what_that_is_worth() -> None:
    shown = line(row_of(view_of()))
    assert re.match(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00 amr7 ", shown)
    assert "state=localized x_m=1.500 y_m=-2.250 theta_deg=28.65 error95_m=0.050 age_s=0.0" in shown
    assert shown.endswith("health=OK")


def test_the_age_is_counted_from_the_pose_on() -> None:
    old = view_of(pose_received_s=time.monotonic() - 100.0)
    age = re.search(r"age_s=([\d.]+)", line(row_of(old)))
    assert age is not None
    assert 100.0 <= float(age[1]) < 100.0 + DEADLINE_S


@pytest.mark.parametrize(
    ("changes", "state"),
    [
        ({}, "localized"),
        ({"alive": False}, "absent"),
        ({"alive": False, "pose": None}, "absent"),
        ({"pose": None}, "silent"),
        ({"pose": pose_of(state=State.LOST)}, "lost"),
        ({"pose_received_s": 0.0}, "stale"),
        ({"alive": False, "pose_received_s": 0.0}, "absent"),
    ],
)
def test_who_is_not_there_or_says_nothing_is_told_apart(
    changes: dict[str, object], state: str
) -> None:
    assert f" state={state} " in line(row_of(view_of(**changes)))


def test_a_line_names_the_map_its_epoch_and_the_time_since_the_last_fix() -> None:
    assert " fix_s=1.5 rate_Hz=- map=hall epoch=2 health=OK" in line(row_of(view_of()))
    unknown = view_of(pose=pose_of(since_fix_s=UNKNOWN, map=None))
    assert " fix_s=unknown rate_Hz=- map=- epoch=2 " in line(row_of(unknown))
    other = view_of(pose=pose_of(map="a" * 36))  # the status still speaks of the one before
    assert " map=aaaaaaaa " in line(row_of(other))


def test_the_rate_is_what_came_in_over_a_second_at_least() -> None:
    rates = Rates()
    shown = []
    for now_s, poses in ((0.0, 100), (0.5, 125), (1.0, 150), (1.5, 150), (2.0, 150)):
        (row,) = rates.rows({"amr7": view_of(poses=poses)}, "name", now_s)
        shown.append(row.rate_hz)
    assert shown == [None, None, 50.0, 50.0, 0.0]


@pytest.mark.parametrize(
    ("sort", "order"),
    [
        ("name", "abcdef"),
        ("state", "facdeb"),  # absent, stale, lost, silent, odometry_only, localized
        ("error", "dfeacb"),
        ("age", "dabcef"),
    ],
)
def test_robots_stand_in_the_order_asked_for(sort: Sort, order: str) -> None:
    now_s = time.monotonic()
    views = [
        view_of(robot="b"),
        view_of(robot="d", pose=None),
        view_of(robot="a", pose_received_s=now_s - 900.0, pose=pose_of(error95_m=0.2)),
        view_of(robot="c", pose_received_s=now_s, pose=pose_of(state=State.LOST, error95_m=0.1)),
        view_of(robot="e", pose=pose_of(state=State.ODOMETRY_ONLY, error95_m=0.4)),
        view_of(robot="f", alive=False, pose=pose_of(error95_m=1.0)),
    ]
    rows = Rates().rows({view.robot: view for view in views}, sort, now_s)
    names = "".join(row.view.robot for row in rows)
    if sort == "age":  # the others are as good as of the same age
        assert names[:2] == order[:2]
    else:
        assert names == order


def test_json_has_all_that_is_known_and_nothing_infinite() -> None:
    told = json.loads(json_line(row_of(view_of(lost=3))))
    assert told["pose"] == json.loads(pose_of().encode())
    assert told["status"] == json.loads(status_of().encode())
    assert (told["robot"], told["state"], told["alive"], told["lost"]) == (
        "amr7",
        "localized",
        True,
        3,
    )
    nothing = json.loads(json_line(row_of(RobotView(robot="amr7"))))
    assert (nothing["state"], nothing["age_s"], nothing["pose"]) == ("absent", None, None)


def test_states_differ_in_shape_too_and_in_ascii_where_there_is_no_more() -> None:
    views = [view_of(pose=pose_of(state=state)) for state in State]
    views += [view_of(alive=False), view_of(pose=None), view_of(pose_received_s=0.0)]
    rows = [row_of(view) for view in views]
    for ascii_only in (False, True):
        console = Console(file=io.StringIO(), width=200)
        console.print(table(rows, "tcp/here:1", ascii_only=ascii_only))
        assert isinstance(console.file, io.StringIO)
        shown = console.file.getvalue()
        shapes = {row.state: re.search(rf"(\S) {row.state} ", shown) for row in rows}
        assert all(shapes.values())
        if ascii_only:
            assert all(match is not None and match[1].isascii() for match in shapes.values())


def test_an_unknown_error_is_no_number() -> None:
    assert "error95_m=unknown" in line(row_of(view_of(pose=pose_of(error95_m=UNKNOWN))))


def test_health_names_what_is_wrong_and_nothing_else() -> None:
    lost = WELL.model_copy(update={"link": "LOST", "detail": "no data for 3 s"})
    standby = WELL.model_copy(update={"detail": "standby"})
    status = status_of(scanners={"front": lost, "rear": standby})
    shown = line(row_of(view_of(pose=pose_of(fault="wheels silent"), status=status, refused=2)))
    assert shown.endswith(
        "health=wheels silent; front LOST (no data for 3 s); rear OK (standby); 2 bad messages"
    )
    assert line(row_of(view_of(status=None))).endswith("health=-")


def test_an_ambiguous_robot_says_where_it_may_be() -> None:
    places = (
        CandidatePart(x=1.0, y=2.0, theta=math.pi / 2, odds=0.7),
        CandidatePart(x=-8.25, y=2.0, theta=0.0, odds=0.25),
    )
    shown = line(row_of(view_of(status=status_of(state=State.AMBIGUOUS, candidates=places))))
    assert shown.endswith("health=70% at (1.00, 2.00, 90 deg); 25% at (-8.25, 2.00, 0 deg)")


def test_names_from_the_network_do_not_steer_the_terminal() -> None:
    evil = view_of(robot="\x1b[2J[red]x", pose=pose_of(fault="\x1b]0;owned\x07\n"))
    for shown in (line(row_of(evil)), printed(evil)):
        assert "\x1b[2J" not in shown
        assert "\x1b]0" not in shown
        assert "?[2J[red]x" in shown  # nor are they read as markup
    assert "\n" not in line(row_of(evil))


@pytest.mark.parametrize(
    ("view", "red"),
    [
        (view_of(), False),
        (view_of(alive=False), True),
        (view_of(pose=pose_of(state=State.LOST)), True),
        (view_of(pose=pose_of(state=State.AMBIGUOUS)), True),
        (view_of(pose_received_s=0.0), True),
        (RobotView(robot="amr7", alive=True), True),
    ],
)
def test_what_is_not_to_be_driven_by_is_red(view: RobotView, red: bool) -> None:
    live = view if view.pose_received_s <= 0.0 else view_of(alive=view.alive, pose=view.pose)
    assert ("31m" in printed(live)) is red


@contextmanager
def publishing() -> Iterator[str]:
    """A robot at 50 Hz; yields its endpoint."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    stop = threading.Event()
    with RobotPublisher(ZenohSettings(listen=(endpoint,)), "amr7") as robot:

        def publish() -> None:
            while not stop.wait(0.02):
                robot.publish_pose(pose_of())
                robot.publish_status(status_of())

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            yield endpoint
        finally:
            stop.set()
            thread.join()


class Seen(io.StringIO):
    """Sets ``stop`` once ``enough`` of what was written holds."""

    def __init__(self, enough: Callable[[str], bool]) -> None:
        super().__init__()
        self.stop = threading.Event()
        self._enough = enough

    def write(self, text: str) -> int:
        written = super().write(text)
        if self._enough(self.getvalue()):
            self.stop.set()
        return written


@pytest.mark.parametrize("terminal", [False, True], ids=["lines", "table"])
def test_watch_shows_a_robot_on_the_network(terminal: bool) -> None:
    seen = Seen(lambda text: all(word in text for word in ("amr7", "localized", "OK", "absent")))
    console = Console(file=seen, width=120, force_terminal=terminal)
    timer = threading.Timer(DEADLINE_S, seen.stop.set)
    timer.start()
    try:
        with publishing() as endpoint:
            watch(endpoint, ["amr7", "amr8"], console=console, stop=seen.stop)
    finally:
        timer.cancel()
    shown = seen.getvalue()
    assert "1.500" in shown
    assert "absent" in shown  # amr8, asked for and not there
    if not terminal:
        assert "\x1b" not in shown
        assert all(re.search(r" (amr7|amr8) state=", text) for text in shown.splitlines())


def test_watch_without_anybody_there_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    monkeypatch.setattr("amr_slam.watching._CONNECT_TIMEOUT_S", 0.3)
    with pytest.raises(SessionError, match=endpoint):
        watch(endpoint)
