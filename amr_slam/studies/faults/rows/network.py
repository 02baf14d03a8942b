"""Rows 19, 28, 29 and 30: the router, and those who are not what they say."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from amr_slam.client import FleetListener, SessionError
from amr_slam.client.asking import AskingError, call
from amr_slam.client.session import close_session, open_client
from amr_slam.studies.faults.row import Row
from amr_slam.studies.faults.rows.scanners import GOES_ON
from amr_slam.studies.faults.settings import PREFIX, ROBOT, Setting
from amr_slam.studies.faults.stage import Stage
from amr_slam.wire import (
    CommandReply,
    PoseMessage,
    SetPose,
    Topic,
    WireError,
    command_key,
    robot_key,
)

_ROUTER_BACK_S: Final = 5.0
_ASK_S: Final = 1.0
_FORGED_S: Final = 4.0
_FORGED_X_M: Final = 99.0
_KEYS: Final = Setting(router="keys")
_ELSEWHERE: Final = SetPose(x=3.0, y=3.0, theta=0.0, radius=1.0)


@contextmanager
def _router_lost(stage: Stage) -> Iterator[None]:
    stage.stop_router()
    yield
    stage.start_router()
    begin_s = time.monotonic()
    with stage.daemon.listener(stage.endpoint, ROBOT) as fleet:
        pose = fleet.next_pose(2.0 * _ROUTER_BACK_S)
    took_s = time.monotonic() - begin_s
    stage.notes.append(f"poses through the router again after {took_s:.1f} s")
    if pose is None or took_s > _ROUTER_BACK_S:
        stage.broken.append(f"no pose through the router within {_ROUTER_BACK_S:g} s")


@contextmanager
def _intruder(stage: Stage, member: tuple[str, str] | None) -> Iterator[Any]:
    keys = None if member is None else stage.keys_of(*member)
    session = open_client(stage.endpoint, keys, 5.0)
    try:
        yield session
    finally:
        close_session(session)


@contextmanager
def _forged_commands(stage: Stage) -> Iterator[None]:
    try:
        FleetListener(stage.endpoint, [ROBOT], connect_timeout_s=2.0).close()
    except SessionError:
        stage.notes.append("no keys: not let in")
    else:
        stage.broken.append("let somebody in who has no keys")
    for kind, name in (("fleet", "board"), ("robots", "amr8")):
        with _intruder(stage, (kind, name)) as session:
            try:
                reply = call(session, PREFIX, ROBOT, _ELSEWHERE, _ASK_S)
            except AskingError:
                stage.notes.append(f"set_pose by {kind}/{name}: not answered")
            else:
                stage.broken.append(f"answered set_pose by {kind}/{name}: {reply.ok}")
    yield


@contextmanager
def _forged_poses(stage: Stage) -> Iterator[None]:
    begin_ns = time.monotonic_ns()
    newest = stage.witness.wait_for(lambda one: isinstance(one, PoseMessage), begin_ns, 5.0)
    assert newest is not None
    assert isinstance(newest.message, PoseMessage)
    forged = newest.message.model_copy(update={"x": _FORGED_X_M, "seq": 10**6}).encode()
    with _intruder(stage, ("robots", "amr8")) as session:
        end_s = time.monotonic() + _FORGED_S
        while time.monotonic() < end_s:
            session.put(robot_key(PREFIX, ROBOT, Topic.POSE), forged)
            stage.rest(0.02)
    yield
    believed = [
        one for one in stage.witness.since(begin_ns)
        if isinstance(one.message, PoseMessage) and one.message.x == _FORGED_X_M
    ]  # fmt: skip
    if believed:
        stage.broken.append(f"{len(believed)} forged poses reached the fleet")


@contextmanager
def _odd_payloads(stage: Stage) -> Iterator[None]:
    """Too large, too deep, no numbers, and a megabyte that should not even be read."""
    key = command_key(PREFIX, ROBOT, "set_pose")
    nan = SetPose.model_construct(x=math.nan, y=0.0, theta=0.0, radius=1.0)
    payloads = {
        "5 kB": b" " * 5000,
        "100 kB": b" " * 100_000,
        "nested": b"[" * 4000,
        "not finite": nan.model_dump_json().replace("null", "NaN").encode(),
        "1 MB": b" " * 1_000_000,
    }
    with _intruder(stage, None) as session:
        for name, payload in payloads.items():
            answers = [
                _answer(reply) for reply in session.get(key, payload=payload, timeout=_ASK_S)
            ]
            said = answers[0] if answers else "not answered"
            stage.notes.append(f"{name}: {said}")
            if said == "done":
                stage.broken.append(f"took a command of {name}")
    yield


def _answer(reply: Any) -> str:
    if reply.ok is None:
        return "not answered"
    try:
        answer = CommandReply.decode(reply.ok.payload.to_bytes())
    except WireError as error:
        return str(error)
    return "done" if answer.ok else f"refused ({answer.error})"


NETWORK: Final = (
    Row(
        number="19", fault="router gone for 6 s", inject=_router_lost, sign="", lasts_s=6.0,
        stays=GOES_ON, setting=Setting(router="open"), elsewhere="delay and loss on the network",
    ),
    Row(
        number="28", fault="set_pose by strangers, by who may only look, by another robot",
        inject=_forged_commands, sign="", lasts_s=6.0, stays=GOES_ON, setting=_KEYS,
    ),
    Row(
        number="29", fault="commands too large, too deep, not finite", inject=_odd_payloads,
        sign="", lasts_s=4.0, stays=GOES_ON,
    ),
    Row(
        number="30", fault="poses of this robot by another robot", inject=_forged_poses, sign="",
        lasts_s=4.0, stays=GOES_ON, setting=_KEYS,
    ),
)  # fmt: skip
