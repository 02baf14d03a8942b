"""Commands and poses under attack, end to end: a router with the written rules, a robot that drives
and answers, controllers through ``amr_slam.client``, and those who are none of them."""

from __future__ import annotations

import asyncio
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from messages import pose_of, status_of
from test_keys import free_port, member, router, session, until

from amr_slam.client import AskingError, CommandRefusedError, Fleet, FleetListener, SessionError
from amr_slam.keys import create, read_credentials
from amr_slam.keys.authority import KeyPair, issue
from amr_slam.keys.rules import access_control
from amr_slam.keys.site import Site
from amr_slam.publishing import RobotPublisher
from amr_slam.serving import Asked
from amr_slam.wire import (
    MAX_COMMAND_BYTES,
    MAX_MESSAGE_BYTES,
    CommandReply,
    PoseMessage,
    Relocalize,
    SaveMap,
    ZenohSettings,
)

DEADLINE_S = 20.0
REFUSED_S = 1.5
"""What the router drops is not answered at all: a short wait tells as much."""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = create(tmp_path / "keys", "hall3", ["127.0.0.1"])
    for robot in ("amr7", "amr8"):
        made.add_robot(robot, 30)
    made.add_controller("main", 30, commands=True)
    made.add_controller("board", 30, commands=False)
    return made


class Driving:
    """``amr7`` behind the router: 50 poses a second, status, and a loop that answers commands."""

    def __init__(self, endpoint: str, keys: Path) -> None:
        self.asked: list[Asked] = []
        self.longest_s = 0.0
        """Of one turn: what an attack may not prolong."""
        self._stop = threading.Event()
        settings = ZenohSettings(listen=(), connect=(endpoint,), keys=keys / "robots/amr7")
        self.robot = RobotPublisher(settings, "amr7")
        self.robot.serve(self._do)
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def _do(self, asked: Asked) -> None:
        self.asked.append(asked)
        if isinstance(asked.request, Relocalize):
            asked.done(CommandReply(ok=True))
        else:
            asked.not_done("the disk is full")

    def _drive(self) -> None:
        seq = 0
        while not self._stop.wait(0.02):
            begun_s = time.monotonic()
            self.robot.publish_pose(pose_of(seq=seq))
            counts = dict(self.robot.command_counts())
            self.robot.publish_status(status_of(seq=seq, commands=counts))
            self.longest_s = max(self.longest_s, time.monotonic() - begun_s)
            seq += 1

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.robot.close()


@contextmanager
def rig(site: Site, keys: Path) -> Iterator[tuple[str, Driving, FleetListener]]:
    """The router's endpoint, the robot, and a board that watches it from its first pose on."""
    with router(site, "tls") as endpoint:
        driving = Driving(endpoint, keys)
        try:
            with FleetListener(endpoint, ["amr7"], keys=keys / "fleet/board") as board:
                assert board.wait_for(lambda views: views["amr7"].pose is not None, DEADLINE_S)
                yield endpoint, driving, board
        finally:
            driving.close()


@contextmanager
def undisturbed(driving: Driving, board: FleetListener) -> Iterator[None]:
    """Not one pose is lost meanwhile, none is refused, and no turn of the robot's takes long."""
    before = board.views()["amr7"]
    driving.longest_s = 0.0
    yield
    first = board.views()["amr7"].poses
    assert board.wait_for(lambda views: views["amr7"].poses >= first + 10, DEADLINE_S)
    after = board.views()["amr7"]
    assert (after.lost, after.restarts, after.refused) == (
        before.lost,
        before.restarts,
        before.refused,
    )
    assert after.alive
    assert driving.longest_s < 1.0


def told(keys: Path, endpoint: str, who: str, command: Relocalize | SaveMap) -> CommandReply:
    """What becomes of a command by the client that controllers use."""

    async def work() -> CommandReply:
        async with Fleet(endpoint, ["amr7"], keys=keys / who) as fleet:
            return await fleet.robot("amr7").call(command, REFUSED_S)

    return asyncio.run(work())


def test_named_controllers_command_and_nobody_else(tmp_path: Path, site: Site) -> None:
    keys = tmp_path / "keys"
    with rig(site, keys) as (endpoint, driving, board), undisturbed(driving, board):
        assert told(keys, endpoint, "fleet/main", Relocalize()).ok
        with pytest.raises(CommandRefusedError, match="the disk is full"):
            told(keys, endpoint, "fleet/main", SaveMap(name="hall"))
        assert len(driving.asked) == 2
        for who in ("fleet/board", "robots/amr8"):
            with pytest.raises(AskingError, match="amr/amr7/cmd/relocalize: no answer"):
                told(keys, endpoint, who, Relocalize())
        assert len(driving.asked) == 2


def test_who_has_no_certificate_of_the_site_is_not_let_in(tmp_path: Path, site: Site) -> None:
    keys = tmp_path / "keys"
    other = create(tmp_path / "other", "hall3", ["127.0.0.1"])  # of the same names
    other.add_controller("main", 30, commands=True)
    with rig(site, keys) as (endpoint, driving, board), undisturbed(driving, board):
        for folder in (tmp_path / "other/fleet/main", swapped(tmp_path, keys), ended(keys), None):
            with pytest.raises(SessionError):
                FleetListener(endpoint, keys=folder, connect_timeout_s=REFUSED_S)
        plain = endpoint.replace("tls/", "tcp/")
        with pytest.raises(SessionError):
            FleetListener(plain, connect_timeout_s=REFUSED_S)
        assert not driving.asked


def swapped(tmp_path: Path, keys: Path) -> Path:
    """A controller's certificate, as everybody sees it, with a key that is not its."""
    folder = tmp_path / "swapped"
    folder.mkdir()
    for name, source in (("ca.pem", "main"), ("cert.pem", "main"), ("key.pem", "board")):
        (folder / name).write_bytes((keys / "fleet" / source / name).read_bytes())
    return folder


def ended(keys: Path) -> Path:
    """A controller whose certificate has ended a moment ago."""
    folder = keys / "fleet/main"
    authority = KeyPair(
        key=(keys / "authority/key.pem").read_bytes(),
        certificate=(keys / "authority/ca.pem").read_bytes(),
    )
    pair = issue(authority, "fleet-main", ["localhost"], days=0)
    (folder / "cert.pem").write_bytes(pair.certificate)
    (folder / "key.pem").write_bytes(pair.key)
    return folder


@pytest.mark.parametrize("who", ["robots/amr8", "fleet/main", "fleet/board", "fleet/amr7"])
def test_nobody_but_the_robot_speaks_and_answers_for_it(
    tmp_path: Path, site: Site, who: str
) -> None:
    keys = tmp_path / "keys"
    site.add_controller("amr7", 30, commands=False)  # of the robot's name
    read: list[str] = []

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, CommandReply(ok=True, file="forged").encode())

    with (
        rig(site, keys) as (endpoint, driving, board),
        session(member(read_credentials(keys / who), endpoint)) as forger,
        FleetListener(endpoint, keys=keys / "fleet/board") as everything,
        undisturbed(driving, board),
    ):
        for key in ("amr/amr7/cmd/*", "amr/amr7/pose", "amr/amr7/map"):
            forger.declare_queryable(key, answer, complete=True)
        token = forger.liveliness().declare_token("amr/amr9/alive")
        if who.startswith("robots/"):
            forger.declare_subscriber(
                "amr/**",
                lambda sample: read.append(str(sample.key_expr)),
                allowed_origin=zenoh.Locality.REMOTE,
            )
        heard: list[int] = []

        def true_poses_come() -> bool:
            for key in ("amr/amr7/pose", "amr/amr7/fleet_pose"):
                forger.put(key, pose_of(seq=10**6).encode())
            pose = everything.next_pose(0.05)
            heard.extend([] if pose is None else [pose.seq])
            return len(heard) >= 30

        until(true_poses_come)
        assert max(heard) < 10**6
        assert set(everything.views()) == {"amr7"}
        assert not read
        assert told(keys, endpoint, "fleet/main", Relocalize()).file is None
        with session(member(read_credentials(keys / "fleet/main"), endpoint)) as asker:
            replies = [reply.ok for reply in asker.get("amr/amr7/pose", timeout=REFUSED_S)]
            (pose,) = [PoseMessage.decode(one.payload.to_bytes()) for one in replies if one]
            assert pose.seq < 10**6
            assert not [r for r in asker.get("amr/amr7/map", timeout=REFUSED_S) if r.ok]
        token.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stub leaves the result open


def test_the_rules_are_these_and_no_more() -> None:
    """Where two rules stand behind each other, no message shows that one of them has gone."""
    rules = access_control("amr", ["amr7"], ["main"], ["board"], by="cert_common_names")
    by_id = {rule["id"]: rule for rule in rules["rules"]}
    members = {one["id"]: one["cert_common_names"] for one in rules["subjects"]}
    allowed = {
        (name, flow, message): set(by_id[rule]["key_exprs"])
        for policy in rules["policies"]
        for subject in policy["subjects"]
        for name in members[subject]
        for rule in policy["rules"]
        for flow in by_id[rule]["flows"]
        for message in by_id[rule]["messages"]
        if rule != "controllers command"
    }
    said = ("put", "delete", "declare_queryable", "reply", "liveliness_token")
    interest = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
    leaves = ("pose", "fleet_pose", "status", "scan", "map", "map/**", "vda5050/**")
    read = {f"amr/*/{leaf}" for leaf in leaves}
    expected: dict[tuple[str, str, str], set[str]] = {
        **{("robot-amr7", "ingress", one): {"amr/amr7/**"} for one in said},
        ("robot-amr7", "egress", "query"): {"amr/amr7/**"},
        **{("robot-amr7", "egress", one): {"**"} for one in interest},
    }
    for name in ("fleet-main", "fleet-board"):
        expected |= {(name, "egress", one): {"amr/**"} for one in said}
        expected |= {(name, "ingress", one): {"amr/**"} for one in interest}
        expected[name, "ingress", "query"] = read
    for flow in ("ingress", "egress"):
        expected |= {("router", flow, one): {"**"} for one in (*said, *interest, "query")}
    assert allowed == expected
    assert {rule["permission"] for rule in rules["rules"]} == {"allow"}
    assert (rules["enabled"], rules["default_permission"]) == (True, "deny")
    (commanders,) = [p for p in rules["policies"] if "controllers command" in p["rules"]]
    assert [members[subject] for subject in commanders["subjects"]] == [["fleet-main"]]
    assert by_id["controllers command"]["key_exprs"] == ["amr/*/cmd/*"]


def test_payloads_that_are_no_commands_are_refused_counted_and_cost_no_pose(
    tmp_path: Path, site: Site
) -> None:
    keys = tmp_path / "keys"
    answered = [b"{", b"\xff\x00", b"[" * 4000, b'{"a": 1}', b" " * (MAX_COMMAND_BYTES + 1)]
    dropped = [b" " * (MAX_MESSAGE_BYTES + 1), b" " * 200_000, b" " * 20_000_000]
    with (
        rig(site, keys) as (endpoint, driving, board),
        session(member(read_credentials(keys / "fleet/main"), endpoint)) as main,
        undisturbed(driving, board),
    ):
        for payload in answered:
            (reply,) = main.get("amr/amr7/cmd/relocalize", payload=payload, timeout=DEADLINE_S)
            assert reply.ok is not None
            assert CommandReply.decode(reply.ok.payload.to_bytes()).error
        for payload in dropped:
            replies = main.get("amr/amr7/cmd/relocalize", payload=payload, timeout=REFUSED_S)
            assert not [reply for reply in replies if reply.ok]
        assert told(keys, endpoint, "fleet/main", Relocalize()).ok
        with pytest.raises(CommandRefusedError):
            told(keys, endpoint, "fleet/main", SaveMap(name="hall"))
        counts = {"invalid": len(answered), "done": 1, "refused": 1}
        assert board.wait_for(
            lambda views: getattr(views["amr7"].status, "commands", {}) == counts, DEADLINE_S
        )


def test_a_flood_of_commands_is_refused_counted_and_costs_no_pose(
    tmp_path: Path, site: Site
) -> None:
    keys = tmp_path / "keys"
    with (
        rig(site, keys) as (endpoint, driving, board),
        session(member(read_credentials(keys / "fleet/main"), endpoint)) as main,
        undisturbed(driving, board),
    ):
        for _ in range(300):
            main.get("amr/amr7/cmd/relocalize", lambda _: None, timeout=REFUSED_S)

        def heard() -> bool:
            return sum(driving.robot.command_counts().values()) == 300

        until(heard)
        assert driving.robot.command_counts()["busy"] > 200
        assert len(driving.asked) == driving.robot.command_counts()["done"]


def test_the_router_passes_no_large_message_and_every_map(tmp_path: Path, site: Site) -> None:
    keys = tmp_path / "keys"
    size = {"amr/amr7/map": 3_000_000, "amr/amr7/status": MAX_MESSAGE_BYTES + 1}

    def answer(query: zenoh.Query) -> None:
        with query:
            key = str(query.key_expr)
            query.reply(key, bytes(size[key]))

    with (
        router(site, "tls") as endpoint,
        session(member(read_credentials(keys / "robots/amr7"), endpoint)) as robot,
        session(member(read_credentials(keys / "fleet/main"), endpoint)) as main,
    ):
        heard: list[int] = []
        main.declare_subscriber("amr/**", lambda sample: heard.append(len(sample.payload)))
        for key in size:
            robot.declare_queryable(key, answer)

        def small_ones_come() -> bool:
            robot.put("amr/amr7/pose", bytes(MAX_MESSAGE_BYTES + 1))
            robot.put("amr/amr7/pose", bytes(MAX_MESSAGE_BYTES))
            return len(heard) >= 5

        until(small_ones_come)
        assert set(heard) == {MAX_MESSAGE_BYTES}
        (reply,) = [one.ok for one in main.get("amr/amr7/map", timeout=DEADLINE_S) if one.ok]
        assert len(reply.payload) == 3_000_000
        assert not [one for one in main.get("amr/amr7/status", timeout=REFUSED_S) if one.ok]


def test_linked_routers_pass_poses_and_commands_on_by_the_same_rules(
    tmp_path: Path, site: Site
) -> None:
    keys = tmp_path / "keys"
    settings = json.loads((site.router_folder / "router.json5").read_text())
    site_endpoint = f"tls/127.0.0.1:{free_port()}"
    settings["listen"]["endpoints"] = [site_endpoint]
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):
        hall_endpoint = f"tls/127.0.0.1:{free_port()}"
        settings["listen"]["endpoints"] = [hall_endpoint]
        settings["connect"] = {"endpoints": [site_endpoint]}
        with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):
            driving = Driving(hall_endpoint, keys)
            try:
                with FleetListener(site_endpoint, ["amr7"], keys=keys / "fleet/board") as board:
                    assert board.wait_for(
                        lambda views: views["amr7"].alive and views["amr7"].poses > 10, DEADLINE_S
                    )
                    assert told(keys, site_endpoint, "fleet/main", Relocalize()).ok
                    with pytest.raises(AskingError, match="no answer"):
                        told(keys, site_endpoint, "fleet/board", Relocalize())
                    assert len(driving.asked) == 1
            finally:
                driving.close()


def test_the_router_without_its_key_does_not_come_up(tmp_path: Path, site: Site) -> None:
    """Rather no router than one that lets everybody in."""
    settings = json.loads((site.router_folder / "router.json5").read_text())
    settings["listen"]["endpoints"] = [f"tls/127.0.0.1:{free_port()}"]
    (site.router_folder / "key.pem").unlink()
    with pytest.raises(zenoh.ZError):
        zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
