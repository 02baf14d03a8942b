"""Maps that robots have, fetched from them one after another: each once, unless it grows."""

from __future__ import annotations

import io
import logging
import queue
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import zenoh
from numpy.typing import NDArray
from PIL import Image

from amr_slam.client.asking import AskingError, ask_map_image
from amr_slam.wire import MapImage

_log = logging.getLogger(__name__)

_ANSWER_S: Final = 10.0
_MOST_READ: Final = 100_000_000
_TRIES: Final = 3
_GROWS_S: Final = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pictured:
    """A map's picture and where it lies."""

    frame: str
    """Name of the map."""
    pixels: NDArray[np.uint8]
    """(rows, columns): 0 a wall, above 250 floor, else unknown; the first row is the topmost."""
    where: MapImage


class MapPictures:
    """Asks on a thread of its own; all methods are for one other thread and return at once."""

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._session, self._prefix = session, prefix
        self._wanted: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._got: queue.SimpleQueue[Pictured] = queue.SimpleQueue()
        self._asked: dict[str, tuple[str, float]] = {}
        self._known: dict[str, Pictured] = {}
        threading.Thread(target=self._run, name="map-pictures", daemon=True).start()

    def want(self, robot: str, frame: str, map_id: str, now_s: float, *, grows: bool) -> None:
        """``robot`` has the map ``map_id``: to be fetched unless that was done before; of one that
        ``grows``, within half a minute. ``now_s``: of a monotonic clock."""
        asked_id, asked_s = self._asked.get(frame, (None, 0.0))
        if asked_id != map_id or (grows and now_s >= asked_s + _GROWS_S):
            self._asked[frame] = map_id, now_s
            self._wanted.put((robot, frame))

    def take(self, frames: Iterable[str]) -> list[Pictured]:
        """What has come since the last time; of maps that are not in ``frames`` nothing is kept."""
        came = []
        while not self._got.empty():
            came.append(self._got.get())
        self._known |= {one.frame: one for one in came}
        alive = set(frames)
        self._known = {name: one for name, one in self._known.items() if name in alive}
        self._asked = {name: one for name, one in self._asked.items() if name in alive}
        return came

    def of(self, frame: str) -> Pictured | None:
        """The picture of a map, if it has come."""
        return self._known.get(frame)

    def _run(self) -> None:
        while True:
            robot, frame = self._wanted.get()
            for _ in range(_TRIES):  # a robot that starts has no map to show yet
                try:
                    png, where = ask_map_image(self._session, self._prefix, robot, _ANSWER_S)
                    self._got.put(pictured(frame, png, where))
                except (AskingError, ValueError, OSError) as error:
                    _log.warning("%s: no picture of map %s: %s", robot, frame, error)
                else:
                    break


def pictured(frame: str, png: bytes, where: MapImage) -> Pictured:
    """Raises ValueError or OSError where ``png`` is no such picture."""
    image = Image.open(io.BytesIO(png), formats=("PNG",))
    if image.size != (where.width_px, where.height_px) or image.width * image.height > _MOST_READ:
        raise ValueError(f"a picture of {image.width} x {image.height} pixels, not as it says")
    return Pictured(frame=frame, pixels=np.asarray(image.convert("L")), where=where)
