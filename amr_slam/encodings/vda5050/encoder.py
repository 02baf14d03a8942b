"""The poses as messages of one version of VDA 5050, and what comes back."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Final

from amr_slam.encodings.base import Encoded, Encoder, Inlet, Lane, Outlet
from amr_slam.encodings.vda5050 import fields
from amr_slam.encodings.vda5050.actions import MAX_ACTIONS_BYTES, PositionActions
from amr_slam.encodings.vda5050.editions import (
    ACTIONS,
    EDITIONS,
    STATE,
    VISUALIZATION,
    Edition,
)
from amr_slam.encodings.vda5050.settings import Vda5050Settings
from amr_slam.encodings.vda5050.trust import Worth, worth
from amr_slam.wire import MapPart, PoseMessage, StatusMessage, robot_key
from amr_slam.wire.vda5050 import HEADER_IDS, StateHeader

_JSON: Final = "application/json"
_MAX_STATE_BYTES: Final = 1 << 17
"""Of the vehicle controller's state; a robot receives nothing larger anyway."""


def encoders(
    settings: Vda5050Settings, *, prefix: str, robot: str, pose_hz: float
) -> list[Encoder]:
    """One for each version that is switched on. ``pose_hz``: how often there is a pose."""
    return [
        Vda5050Encoder(EDITIONS[version], settings, prefix=prefix, robot=robot, pose_hz=pose_hz)
        for version in settings.versions
    ]


class Vda5050Encoder(Encoder):
    """One version: its ``visualization``, and the localization's part of its ``state``."""

    def __init__(
        self,
        edition: Edition,
        settings: Vda5050Settings,
        *,
        prefix: str,
        robot: str,
        pose_hz: float,
    ) -> None:
        manufacturer, serial = settings.manufacturer or "", settings.serial_number or robot
        topic = f"{settings.interface}/{edition.major}/{manufacturer}/{serial}"
        own = robot_key(prefix, robot, f"vda5050/{edition.major}")
        self._edition = edition
        self._settings = settings
        self._sender = {
            "version": edition.version,
            "manufacturer": manufacturer,
            "serialNumber": serial,
        }
        # Never more often than asked for; by counting poses, whose times are kept elsewhere.
        self._every = max(1, math.ceil(pose_hz / settings.visualization_hz - 1e-6))
        self._since = 0
        self._told: tuple[bool, str | None, int] | None = None
        self._header_id = 0
        self._state_header_id = 0
        self._map: MapPart | None = None
        self._actions = PositionActions(edition, settings.take_radius_m, manufacturer, serial)
        self._visualization = Outlet(key=f"{topic}/{VISUALIZATION}", encoding=_JSON, lane=Lane.POSE)
        self._state_part = Outlet(
            key=f"{own}/state_part", encoding=_JSON, lane=Lane.POSE, answers=True
        )
        self._action_states = Outlet(
            key=f"{own}/action_states", encoding=_JSON, lane=Lane.STATUS, answers=True
        )
        self.outlets = [self._visualization, self._state_part]
        self.inlets = []
        if edition.refers_to_state:
            self.inlets.append(
                Inlet(
                    key=f"{topic}/{STATE}",
                    name=f"VDA 5050 {edition.major} state",
                    decode=self._hear_state,
                    max_bytes=_MAX_STATE_BYTES,
                )
            )
        if settings.take_position:
            self.outlets.append(self._action_states)
            self.inlets.append(
                Inlet(
                    key=f"{topic}/{ACTIONS}",
                    name=f"VDA 5050 {edition.major} instant actions",
                    decode=self._actions.decode,
                    max_bytes=MAX_ACTIONS_BYTES,
                )
            )

    def pose(self, message: PoseMessage) -> Iterable[Encoded]:
        name = self._map.name if self._map is not None and self._map.id == message.map else ""
        map_id = (message.map or "") if self._settings.map_id == "uuid" else name
        self._actions.map_is(map_id)
        if message.map is not None and not map_id:
            return []  # a map whose name comes with the status, in 0.1 s at most
        encoded = list(self._news())
        known = worth(message, self._settings)
        what = known.localized, message.map, message.epoch
        self._since += 1
        if what != self._told or self._since >= self._every:
            self._told, self._since = what, 0
            encoded += self._positions(message, known, map_id, name)
        return encoded

    def status(self, message: StatusMessage) -> Iterable[Encoded]:
        self._map = message.map
        return list(self._news())

    def _positions(
        self, message: PoseMessage, known: Worth, map_id: str, name: str
    ) -> Iterator[Encoded]:
        edition = self._edition
        said = {
            edition.position: fields.position(edition, message, known, map_id, name),
            "velocity": fields.velocity(message),
        }
        header = {
            "headerId": self._header_id,
            "timestamp": fields.timestamp(message.stamp),
            **self._sender,
        }
        if edition.refers_to_state:
            header["referenceStateHeaderId"] = self._state_header_id
        self._header_id = (self._header_id + 1) % HEADER_IDS
        which = {"v": 1, "seq": message.seq, "epoch": message.epoch}
        yield Encoded(
            key=self._visualization.key,
            payload=fields.to_json(header | said),
            attachment=fields.to_json(which),
        )
        state = {
            **said,
            "maps": fields.maps(edition, message, map_id, name),
            "errors": fields.errors(edition, known),
        }
        part = {**which, "stamp": message.stamp, "state": state}
        yield Encoded(key=self._state_part.key, payload=fields.to_json(part))

    def _news(self) -> Iterator[Encoded]:
        news = self._actions.news()
        if news is not None:
            payload = fields.to_json({"v": 1, "state": news})
            yield Encoded(key=self._action_states.key, payload=payload)

    def _hear_state(self, payload: bytes) -> None:
        """On a thread of zenoh's."""
        self._state_header_id = StateHeader.decode(payload).header_id
