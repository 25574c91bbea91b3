"""What the live page is answered: the newest frame, its heights, and what its buttons do."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from splitknit import BadInput, Query, Reply, json_reply, require, srgb_code, static_file, static_files
from splitknit_rig.capture.live import Live, LiveFrame

_PATIENCE_S = 2.0  # a request for a newer frame is answered after so long at the latest, without one
_JPEG_QUALITY = 85
_MARKED = (255, 0, 200)  # colour over markers, RGB


class LiveService:
    """Answers about one live stream, also to several threads. `live` measures
    :class:`splitknit_rig.capture.live.LiveHeights`, or is None without a calibration; `facts` describe it; `actions`
    are the page's buttons by name: of the newest frame to one sentence.
    """

    def __init__(
        self, live: Live[Any], facts: dict[str, Any], actions: dict[str, Callable[[LiveFrame[Any]], str]]
    ) -> None:
        """Take the stream, which the caller starts and ends."""
        self._live, self._facts, self._actions = live, facts, actions
        levels = np.arange(256) / 255.0
        self._eye = np.rint(255 * (srgb_code(levels) if live.source.encoding == "linear" else levels)).astype(np.uint8)

    def answer(self, path: str, query: Query) -> Reply:
        """Answer a request to read. Raises BadInput if there is nothing at `path`, or the stream has ended."""
        if path in static_files():
            return static_file(path)
        match path:
            case "":
                return static_file("live.html")
            case "api/live":
                return json_reply({**self._facts, "source": self._live.source.name, "actions": sorted(self._actions)})
            case "api/live/frame":
                after = query.get("after", "0")
                require(after.isascii() and after.isdigit() and len(after) < 16, "after= takes a frame's number.")
                return self._frame(self._live.newest(int(after), _PATIENCE_S))
        raise BadInput("there is nothing at this address.")

    def act(self, path: str, query: Query) -> Reply:
        """Do what a button of the page stands for. Raises BadInput if there is none, or it cannot be done."""
        name = path.removeprefix("api/live/")
        if name == "hold":
            self._live.hold(query.get("on") == "1")
            return json_reply({"done": "frozen" if query.get("on") == "1" else "live"})
        require(path.startswith("api/live/") and name in self._actions, "there is no such action.")
        frame = self._live.newest(0, _PATIENCE_S)
        require(frame is not None, "there is no frame yet; try again.")
        assert frame is not None
        return json_reply({"done": self._actions[name](frame)})

    def _frame(self, frame: LiveFrame[Any] | None) -> Reply:
        """Facts in the header X-Frame; heights in um, (H, W) little-endian float32, if measured; photograph, JPEG."""
        if frame is None:
            return Reply("application/octet-stream", 0, [b""])
        found = frame.measured
        heights = np.empty((0, 0)) if found is None else found.height_um
        facts = {"number": frame.number, "dropped": frame.dropped, "per_second": round(frame.per_second, 1)}
        facts |= {"rows": heights.shape[0], "columns": heights.shape[1], **({} if found is None else found.facts())}
        content = heights.astype("<f4").tobytes() + self._photograph(frame)
        # in pieces it is not compressed: on the loopback address that costs more than it saves
        return Reply("application/octet-stream", len(content), [content], {"X-Frame": json.dumps(facts)})

    def _photograph(self, frame: LiveFrame[Any]) -> bytes:
        small: Any = frame.pixels
        if small.dtype != np.uint8:
            small = cv2.convertScaleAbs(small, alpha=1 / 257)
        if frame.measured is not None:
            markers = frame.measured.markers
            small = cv2.resize(small, markers.shape[::-1], interpolation=cv2.INTER_AREA)
            small[markers] = _MARKED
        small = cv2.LUT(small, self._eye)
        picture: Any = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
        return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
