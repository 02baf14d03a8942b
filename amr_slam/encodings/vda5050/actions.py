"""Instant actions that set the pose: read, checked, and what became of them."""

from __future__ import annotations

import threading
from collections import OrderedDict
from functools import partial
from typing import Final, Literal

from amr_slam.encodings.base import Request
from amr_slam.encodings.vda5050.editions import Edition
from amr_slam.encodings.vda5050.fields import Fields
from amr_slam.wire import CommandReply, SetPose, WireError
from amr_slam.wire.vda5050 import InstantAction, InstantActions

MAX_ACTIONS_BYTES: Final = 16 * 1024
"""Larger messages of instant actions are refused unread."""
_KEPT: Final = 16
"""So many states of actions are told, newest last."""
_REMEMBERED: Final = 256
"""So many actions are known again: MQTT and bridges may deliver one twice."""

Status = Literal["RUNNING", "FINISHED", "FAILED"]


class PositionActions:
    """Takes ``initPosition`` or ``initializePosition`` from messages of instant actions.

    All other actions are the vehicle controller's. :meth:`decode` is for zenoh's threads, what it
    returns is answered on the desk's, and the rest is for the loop's.
    """

    def __init__(self, edition: Edition, radius_m: float, manufacturer: str, serial: str) -> None:
        self._edition = edition
        self._radius_m = radius_m
        self._vehicle = manufacturer, serial
        self._map_id = ""
        self._lock = threading.Lock()
        self._states: OrderedDict[str, tuple[Status, str | None]] = OrderedDict()
        self._changed = False

    def map_is(self, map_id: str) -> None:
        """The map that positions are in now; empty: none that has been told."""
        self._map_id = map_id

    def decode(self, payload: bytes) -> Request | None:
        """The command in a message; None where there is none, or it came before. Raises WireError
        for what is not such a message, or names a position that cannot be."""
        message = InstantActions.decode(payload)
        named = message.manufacturer, message.serial_number
        if any(said not in {None, own} for said, own in zip(named, self._vehicle, strict=True)):
            raise WireError("is for another vehicle than its topic")
        ours = [one for one in message.actions if one.action_type == self._edition.set_pose]
        fresh = [action for action in ours if self._begin(action.action_id)]
        if not fresh:
            return None
        try:
            command = self._command(fresh)
        except WireError as error:
            for action in fresh:
                self._end(action.action_id, "FAILED", str(error))
            raise
        return Request(command=command, answered=partial(self._answered, fresh[0].action_id))

    def news(self) -> Fields | None:
        """The states of the last actions; None where nothing changed since the last call."""
        with self._lock:
            if not self._changed:
                return None
            self._changed = False
            told = list(self._states.items())[-_KEPT:]
        return {self._edition.action_states: [self._fields(*one) for one in told]}

    def _fields(self, action_id: str, state: tuple[Status, str | None]) -> Fields:
        status, result = state
        fields = {
            "actionId": action_id,
            "actionType": self._edition.set_pose,
            "actionStatus": status,
        }
        return fields if result is None else {**fields, self._edition.action_result: result}

    def _command(self, actions: list[InstantAction]) -> SetPose:
        if len(actions) > 1:
            raise WireError("more than one position in a message: none is taken")
        position = actions[0].position()
        known = self._map_id
        if position.map_id != known:
            active = f"the active map is {known}" if known else "no map is active yet"
            raise WireError(f"mapId: {position.map_id:.64}: {active}")
        return SetPose(x=position.x, y=position.y, theta=position.theta, radius=self._radius_m)

    def _answered(self, action_id: str, reply: CommandReply) -> None:
        if reply.error is not None:
            self._end(action_id, "FAILED", reply.error)
            return
        pose = reply.pose
        found = f"found at x={pose.x:.3f} y={pose.y:.3f} theta={pose.theta:.4f}" if pose else None
        self._end(action_id, "FINISHED", found)

    def _begin(self, action_id: str) -> bool:
        """False where the action is known."""
        with self._lock:
            if action_id in self._states:
                return False
            self._states[action_id] = "RUNNING", None
            while len(self._states) > _REMEMBERED:
                self._states.popitem(last=False)
            self._changed = True
            return True

    def _end(self, action_id: str, status: Status, result: str | None) -> None:
        with self._lock:
            if action_id in self._states:
                self._states[action_id] = status, result
                self._changed = True
