"""A site's keys on real sessions: who is let in, what passes the router, what does not."""

from __future__ import annotations

import json
import socket
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Literal

import pytest
import zenoh
from messages import MAP_ID, pose_of

from amr_slam.cli import main
from amr_slam.client import FleetListener, SessionError
from amr_slam.encodings import vda5050
from amr_slam.encodings.vda5050 import Vda5050Settings
from amr_slam.keys import Credentials, KeysError, create, load, read_credentials
from amr_slam.keys.site import Auth, Site, expires_soon
from amr_slam.publishing import RobotPublisher
from amr_slam.serving import Asked
from amr_slam.wire import SetPose, ZenohSettings

DEADLINE_S = 20.0


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@contextmanager
def session(options: dict[str, Any]) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in ({"scouting/multicast/enabled": False} | options).items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as opened:
        yield opened


@contextmanager
def router(site: Site, auth: Auth) -> Iterator[str]:
    """The written configuration in a real router; only its port is another."""
    settings = json.loads((site.router_folder / "router.json5").read_text())
    protocol = "tls" if auth == "tls" else "tcp"
    endpoint = f"{protocol}/127.0.0.1:{free_port()}"
    settings["listen"]["endpoints"] = [endpoint]
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):
        yield endpoint


def member(credentials: Credentials, endpoint: str) -> dict[str, Any]:
    return {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 3000,
        **credentials.options(),
    }


@pytest.fixture(params=["tls", "password"])
def auth(request: pytest.FixtureRequest) -> Auth:
    kind: Auth = request.param
    return kind


@pytest.fixture
def site(tmp_path: Path, auth: Auth) -> Site:
    made = create(tmp_path / "keys", "hall3", ["127.0.0.1"], auth=auth)
    made.add_robot("amr7", 30)
    made.add_robot("amr8", 30)
    made.add_controller("main", 30, commands=True)
    made.add_controller("board", 30, commands=False)
    return made


def test_robots_speak_for_themselves_only_and_controllers_hear_them(
    tmp_path: Path, site: Site, auth: Auth
) -> None:
    keys = tmp_path / "keys"
    with router(site, auth) as endpoint:
        settings = ZenohSettings(listen=(), connect=(endpoint,), keys=keys / "robots/amr7")
        with (
            FleetListener(endpoint, keys=keys / "fleet/board") as fleet,
            RobotPublisher(settings, "amr7") as robot,
            session(member(read_credentials(keys / "robots/amr8"), endpoint)) as forger,
        ):
            assert fleet.wait_for(lambda views: "amr7" in views, DEADLINE_S)
            token = forger.liveliness().declare_token("amr/amr7/alive")
            forged = pose_of(seq=99, robot="amr7").encode()
            heard = []

            def true_pose_comes() -> bool:
                forger.put("amr/amr7/pose", forged)
                robot.publish_pose(pose_of(seq=1))
                pose = fleet.next_pose(0.05)
                if pose is not None:
                    heard.append(pose.seq)
                return len(heard) >= 20

            until(true_pose_comes)
            assert set(heard) == {1}
            token.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stub leaves the result open


def test_only_named_controllers_command(tmp_path: Path, site: Site, auth: Auth) -> None:
    keys = tmp_path / "keys"
    called: list[str] = []

    def answer(query: zenoh.Query) -> None:
        with query:
            called.append(str(query.key_expr))
            query.reply(query.key_expr, b"done")

    with (
        router(site, auth) as endpoint,
        session(member(read_credentials(keys / "robots/amr7"), endpoint)) as robot,
    ):
        robot.declare_queryable("amr/amr7/cmd/relocalize", answer)
        robot.declare_queryable("amr/amr7/pose", answer)

        def replies(who: str, key: str) -> int:
            with session(member(read_credentials(keys / who), endpoint)) as asker:
                # What is refused is not answered at all: a short time-out tells as much.
                return sum(reply.ok is not None for reply in asker.get(key, timeout=1.0))

        until(lambda: replies("fleet/main", "amr/amr7/cmd/relocalize") == 1)
        assert replies("fleet/board", "amr/amr7/pose") == 1
        called.clear()
        assert replies("fleet/board", "amr/amr7/cmd/relocalize") == 0
        assert replies("robots/amr8", "amr/amr7/cmd/relocalize") == 0
        assert called == []


def test_strangers_are_not_let_in(tmp_path: Path, site: Site, auth: Auth) -> None:
    other = create(tmp_path / "other", "hall4", ["127.0.0.1"], auth=auth)
    other.add_robot("amr7", 30)
    other.add_controller("main", 30, commands=True)
    with router(site, auth) as endpoint:
        for keys in (tmp_path / "other/fleet/main", None):
            with pytest.raises(SessionError):
                FleetListener(endpoint, keys=keys, connect_timeout_s=2.0)


def test_the_revoked_are_not_heard_any_more(tmp_path: Path, site: Site, auth: Auth) -> None:
    kept = tmp_path / "stolen"
    (tmp_path / "keys/robots/amr7").rename(kept)
    with pytest.raises(KeysError, match="no robot is named 'amr9'"):
        site.revoke("robot", "amr9")
    site.revoke("robot", "amr7")
    with router(load(tmp_path / "keys"), auth) as endpoint:
        settings = ZenohSettings(listen=(), connect=(endpoint,), keys=kept)
        trusted = ZenohSettings(listen=(), connect=(endpoint,), keys=tmp_path / "keys/robots/amr8")
        with (
            FleetListener(endpoint, keys=tmp_path / "keys/fleet/main") as fleet,
            RobotPublisher(settings, "amr7") as revoked,
            RobotPublisher(trusted, "amr8") as robot,
        ):
            heard = []

            def both_spoke() -> bool:
                revoked.publish_pose(pose_of(seq=1, robot="amr7"))
                robot.publish_pose(pose_of(seq=1, robot="amr8"))
                pose = fleet.next_pose(0.05)
                if pose is not None:
                    heard.append(pose.robot)
                return len(heard) >= 10

            until(both_spoke)
            assert set(heard) == {"amr8"}


def test_cameras_are_heard_on_their_key_by_robots_and_may_do_nothing_else(
    tmp_path: Path, site: Site, auth: Auth
) -> None:
    keys = tmp_path / "keys"
    site.add_camera("ceiling", 30, key="cameras/*/pose")
    heard: list[bytes] = []
    overheard: list[bytes] = []
    with router(load(keys), auth) as endpoint, ExitStack() as opened:
        settings = ZenohSettings(listen=(), connect=(endpoint,), keys=keys / "robots/amr7")
        robot = opened.enter_context(RobotPublisher(settings, "amr7"))
        robot.hear("cameras/amr7/pose", heard.append)
        board, camera, other = (
            opened.enter_context(session(member(read_credentials(keys / who), endpoint)))
            for who in ("fleet/board", "cameras/ceiling", "robots/amr8")
        )
        board.declare_subscriber("amr/*/pose", lambda s: overheard.append(s.payload.to_bytes()))
        camera.declare_subscriber(
            "**", lambda _: overheard.append(b"by a camera"), allowed_origin=zenoh.Locality.REMOTE
        )

        def all_speak() -> bool:
            robot.publish_pose(pose_of())
            camera.put("amr/amr7/pose", b"forged")
            other.put("cameras/amr7/pose", b"another robot's")
            camera.put("cameras/amr7/pose", b"seen")
            return len(heard) >= 20 and len(overheard) >= 20

        until(all_speak)
        assert set(heard) == {b"seen"}
        assert set(overheard) == {pose_of().encode()}
        assert not any(r.ok for r in camera.get("amr/amr7/pose", timeout=0.5))


@pytest.mark.parametrize(
    "key", ["amr/x/pose", "*/pose", "**", "amr7/tf", "uagv/x", "0/x", "a//b", "a/b#c", "", "a/$*"]
)
def test_a_camera_s_key_is_never_a_robot_s(tmp_path: Path, key: str) -> None:
    site = create(tmp_path / "keys", "hall3", ["10.0.0.1"])
    site.add_robot("amr7", 30)
    site.allow_vda5050("uagv")
    with pytest.raises(KeysError, match=r"a word of its own|no key expression"):
        site.add_camera("ceiling", 30, key=key)
    site.add_camera("ceiling", 30, key="cameras/**")
    with pytest.raises(KeysError, match="camera ceiling speaks under it"):
        site.add_robot("cameras", 30)
    with pytest.raises(KeysError, match="camera ceiling speaks under it"):
        site.allow_vda5050("cameras")


@pytest.mark.parametrize("kind", ["robot", "fleet", "camera"])
def test_of_the_revoked_nothing_is_left(
    tmp_path: Path, kind: Literal["robot", "fleet", "camera"]
) -> None:
    site = create(tmp_path / "keys", "hall3", ["10.0.0.1"])
    add: dict[str, Callable[[str, int], object]] = {
        "robot": site.add_robot,
        "fleet": partial(site.add_controller, commands=True),
        "camera": partial(site.add_camera, key="cameras/*/pose"),
    }
    for name in ("kept", "gone"):
        add[kind](name, 30)
    folder = {member.name: member.folder for member in site.members()}["gone"]
    site.revoke(kind, "gone")
    for known in (site, load(tmp_path / "keys")):
        assert [member.name for member in known.members()] == ["kept"]
    rules = (site.router_folder / "router.json5").read_text()
    assert f"{kind}-kept" in rules
    assert f"{kind}-gone" not in rules
    assert not (folder / "key.pem").exists()
    assert not (folder / "cert.pem").exists()


def test_private_files_are_private_and_nothing_is_made_anew(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    create(keys, "hall3", ["10.0.0.1"]).add_robot("amr7", 30)
    for path in [*keys.rglob("key.pem"), *keys.rglob("login.json")]:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = (keys / "authority/key.pem").read_bytes()
    with pytest.raises(KeysError, match="is a site's folder already"):
        create(keys, "hall3", ["10.0.0.1"])
    assert (keys / "authority/key.pem").read_bytes() == before
    (robot,) = load(keys).members()
    assert robot.expires is not None
    assert expires_soon(robot)
    assert not expires_soon(robot, datetime.now(UTC) - timedelta(days=31))


@pytest.mark.parametrize("name", ["", "../up", "a/b", "*", "a" * 65, "-x"])
def test_names_that_could_be_anything_else_are_refused(tmp_path: Path, name: str) -> None:
    site = create(tmp_path / "keys", "hall3", ["10.0.0.1"])
    with pytest.raises(KeysError, match="letters, digits"):
        site.add_robot(name, 30)
    with pytest.raises(KeysError, match="letters, digits"):
        site.add_controller(name, 30, commands=True)


def test_the_command_makes_a_site_and_says_where_its_folders_go(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = str(tmp_path / "keys")
    assert main(["keys", "robot", "amr7", "--dir", keys]) == 1
    assert "begin with 'amr-slam keys init'" in capsys.readouterr().err
    assert main(["keys", "init", "--site", "hall3", "--router", "10.0.0.5", "--dir", keys]) == 0
    assert main(["keys", "robot", "amr7", "--dir", keys]) == 0
    assert main(["keys", "fleet", "main", "--commands", "--dir", keys]) == 0
    assert main(["keys", "camera", "ceiling", "--key", "cameras/*", "--dir", keys]) == 0
    assert f"copy {keys}/robots/amr7/" in capsys.readouterr().out
    assert main(["keys", "list", "--dir", keys]) == 0
    out = capsys.readouterr().out
    assert "robot amr7: until 20" in out
    assert "fleet main (commands): until 20" in out
    assert "camera ceiling (cameras/*): until 20" in out
    assert main(["keys", "vda5050", "uagv", "--dir", keys]) == 0
    assert "uagv/VERSION/MANUFACTURER/ROBOT/" in capsys.readouterr().out
    assert "uagv/*/*/amr7/visualization" in (tmp_path / "keys/router/router.json5").read_text()
    assert main(["keys", "vda5050", "off", "--dir", keys]) == 0
    assert "uagv" not in (tmp_path / "keys/router/router.json5").read_text()
    assert main(["keys", "revoke", "fleet", "main", "--dir", keys]) == 0
    (tmp_path / "keys/site.json").write_text("{}")
    assert main(["keys", "list", "--dir", keys]) == 1
    assert "site.json" in capsys.readouterr().err


def test_a_damaged_authority_is_named_and_signs_nothing(tmp_path: Path) -> None:
    site = create(tmp_path / "keys", "hall3", ["10.0.0.1"])
    (tmp_path / "keys/authority/key.pem").write_text("damaged")
    with pytest.raises(KeysError, match="authority: damaged"):
        site.add_robot("amr7", 30)
    assert load(tmp_path / "keys").members() == []


def test_a_folder_without_keys_is_named(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"ca\.pem: No such file"):
        RobotPublisher(ZenohSettings(listen=(), keys=tmp_path), "amr7")
    (tmp_path / "login.json").write_text("[]")
    with pytest.raises(SessionError, match="no user and password"):
        RobotPublisher(ZenohSettings(listen=(), keys=tmp_path), "amr7")


def test_of_vda_5050_robots_have_their_own_topics_and_only_commanders_speak_to_them(
    tmp_path: Path, site: Site, auth: Auth
) -> None:
    keys = tmp_path / "keys"
    with pytest.raises(KeysError, match="letters, digits"):
        site.allow_vda5050("uagv/#")
    site.allow_vda5050("uagv")
    topics = "uagv/v3/acme/amr7"
    encoders = vda5050.encoders(
        Vda5050Settings(versions=("3.0",), manufacturer="acme", take_position=True),
        prefix="amr",
        robot="amr7",
        pose_hz=50.0,
    )
    places = {"fleet/main": 1.0, "fleet/board": 2.0, "robots/amr8": 3.0}
    asked: list[Asked] = []
    heard: list[dict[str, Any]] = []

    def loop(one: Asked) -> None:
        asked.append(one)
        one.not_done("nothing fits")

    with router(load(keys), auth) as endpoint, ExitStack() as opened:
        members = {
            who: opened.enter_context(session(member(read_credentials(keys / who), endpoint)))
            for who in ("fleet/main", "fleet/board", "robots/amr8")
        }
        members["fleet/board"].declare_subscriber(
            "uagv/**", lambda sample: heard.append(json.loads(sample.payload.to_bytes()))
        )
        settings = ZenohSettings(listen=(), connect=(endpoint,), keys=keys / "robots/amr7")
        robot = opened.enter_context(RobotPublisher(settings, "amr7", encoders))
        robot.serve(loop)

        def all_speak(*who: str) -> None:
            robot.publish_pose(pose_of())
            members["robots/amr8"].put(f"{topics}/visualization", b'{"forged": true}')
            for one in who:
                told = initialize_position(x=places[one], action_id=f"{one}-{len(heard)}")
                members[one].put(f"{topics}/instantActions", told)

        def commanded() -> bool:
            all_speak("fleet/main")
            return bool(asked)

        def overheard() -> bool:
            all_speak("fleet/board", "robots/amr8")
            return len(heard) > before + 20

        until(commanded)
        before = len(heard)
        until(overheard)
        assert {one.request.x for one in asked if isinstance(one.request, SetPose)} == {1.0}
        assert not any("forged" in message for message in heard)
        key = "amr/amr7/vda5050/v3/action_states"

        def told() -> bool:
            robot.publish_pose(pose_of())
            replies = members["fleet/board"].get(key, timeout=1.0)
            return any(b"nothing fits" in r.ok.payload.to_bytes() for r in replies if r.ok)

        until(told)


def initialize_position(*, x: float, action_id: str) -> bytes:
    position = {"x": x, "y": 2.0, "theta": 0.0, "mapId": MAP_ID}
    parameters = [{"key": key, "value": value} for key, value in position.items()]
    action = {"actionType": "initializePosition", "actionId": action_id, "blockingType": "NONE"}
    return json.dumps({"actions": [{**action, "actionParameters": parameters}]}).encode()
