"""``map``, ``map/image`` and ``map/changes``."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial
from typing import Final

import zenoh

from amr_slam.map import MapError
from amr_slam.map.file import identity
from amr_slam.serving.asked import (
    Asked,
    ChangesWanted,
    ImageWanted,
    MapFile,
    MapWanted,
    NotDone,
    Picture,
    Put,
)
from amr_slam.serving.desk import Answering, Desk, asking
from amr_slam.wire import MAX_MAP_BYTES, SCHEMA_VERSION, MapChanges, Topic

_MAP_QUERIES: Final = 2
"""Of the map, its picture and its changes, here at once."""

_MAP: Final = Topic.MAP.value
_IMAGE: Final = Topic.MAP_IMAGE.value
_CHANGES: Final = Topic.MAP_CHANGES.value
_LEAVES: Final = tuple(f"/{leaf}" for leaf in (_MAP, _IMAGE, _CHANGES))

_Finding = Callable[[zenoh.Query], Answering]


class MapDesk:
    """``map``, ``map/image`` and ``map/changes``: answered one after another."""

    def __init__(self, session: zenoh.Session, base: str, put: Put) -> None:
        self._map_key, self._image_key = f"{base}/{_MAP}", f"{base}/{_IMAGE}"
        self._changes_key = f"{base}/{_CHANGES}"
        self._desk = Desk("maps", put, places=_MAP_QUERIES)
        self._queryables = (
            session.declare_queryable(self._map_key, partial(self._on_query, self._find_map)),
            session.declare_queryable(self._image_key, partial(self._on_query, self._find_image)),
            session.declare_queryable(
                self._changes_key, partial(self._on_query, self._find_changes)
            ),
        )

    def close(self) -> None:
        self._desk.close()

    def _on_query(self, find: _Finding, query: zenoh.Query) -> None:
        """On a thread of zenoh's."""
        if not str(query.key_expr).endswith(_LEAVES):
            query.drop()  # type: ignore[no-untyped-call]  # who asks for all gets no megabytes
        elif not self._desk.enter(lambda: self._perform(find, query)):
            _refuse_map(query, "busy with the queries before this one: ask again")

    def _perform(self, find: _Finding, query: zenoh.Query) -> Answering:
        try:
            return find(query)
        except (NotDone, MapError) as error:
            return partial(_refuse_map, query, str(error))

    def _find_map(self, query: zenoh.Query) -> Answering:
        found: MapFile = self._desk.ask(Asked(request=MapWanted(), by=asking(query)))
        data = _read(found)
        attachment = json.dumps({"v": SCHEMA_VERSION, "map": found.map_id}).encode()
        encoding = zenoh.Encoding.APPLICATION_OCTET_STREAM.with_schema("amrmap")
        return partial(_send, query, self._map_key, data, encoding, attachment)

    def _find_image(self, query: zenoh.Query) -> Answering:
        wanted = ImageWanted(resolution_m=_resolution_m(query.parameters))
        image: Picture = self._desk.ask(Asked(request=wanted, by=asking(query)))
        attachment = image.georeference.encode()
        return partial(
            _send, query, self._image_key, image.png, zenoh.Encoding.IMAGE_PNG, attachment
        )

    def _find_changes(self, query: zenoh.Query) -> Answering:
        found: MapChanges = self._desk.ask(Asked(request=ChangesWanted(), by=asking(query)))
        encoding = zenoh.Encoding.APPLICATION_JSON
        return partial(_send, query, self._changes_key, found.encode(), encoding)


def _send(
    query: zenoh.Query,
    key: str,
    payload: bytes,
    encoding: zenoh.Encoding,
    attachment: bytes | None = None,
) -> None:
    with query:
        query.reply(key, payload, encoding=encoding, attachment=attachment)


def _read(found: MapFile) -> bytes:
    """Raises NotDone and MapError."""
    try:
        with found.path.open("rb") as stream:
            data = stream.read(MAX_MAP_BYTES + 1)
    except OSError as error:
        raise NotDone(f"cannot read the map's file: {error.strerror or error}") from error
    if len(data) > MAX_MAP_BYTES:
        raise NotDone(f"the map's file is larger than {MAX_MAP_BYTES >> 20} MiB: copy it")
    if str(identity(data)) != found.map_id:
        raise NotDone("the map's file has been replaced since it was loaded")
    return data


def _resolution_m(parameters: zenoh.Parameters) -> float | None:
    text = parameters.get("resolution")
    if text is None:
        return None
    try:
        resolution_m = float(text)
    except ValueError:
        resolution_m = math.nan
    if not 0.001 <= resolution_m <= 100.0:
        raise NotDone("resolution should be metres for a pixel, 0.001 to 100")
    return resolution_m


def _refuse_map(query: zenoh.Query, reason: str) -> None:
    with query:
        query.reply_err(reason.encode(), encoding=zenoh.Encoding.TEXT_PLAIN)
