"""The camera in a browser while somebody turns the lens: picture, sharpness and histogram, served
to whoever on this computer was shown its address."""

from __future__ import annotations

import base64
import hmac
import json
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from splitknit.devices import Opened
from splitknit.errors import BadInput, printable
from splitknit.model import PixelArray
from splitknit_rig.capture.exposure import (
    FINGER_PERCENTILE,
    START_S,
    ExposureSettings,
    exposure_of,
    grey_light,
    measure_focus,
)
from splitknit_rig.capture.session import FOCUS_FIELD_MM

PAGE = Path(__file__).with_name("preview.html")


class Preview:
    """Looks through the camera under one LED, again and again."""

    def __init__(self, devices: Opened, led: int) -> None:
        """Take devices that are open."""
        self._devices, self._led = devices, led
        self._exposure = ExposureSettings()
        self._product = START_S
        self.best = 0.0
        """Largest sharpness so far, %."""
        self.looks = 0

    def look(self) -> dict[str, Any]:
        """Take a picture: ``sharpness`` of its middle and the ``best`` so far (%), ``histogram`` of
        the light, ``clipped`` (fraction), and JPEG files ``picture`` and ``middle`` (base64)."""
        camera, rig = self._devices.camera, self._devices.rig
        time_s, gain = exposure_of(self._product, camera.exposures, self._exposure)
        camera.lock(time_s, gain, rig.leds[self._led].band)
        self._devices.lights.on(self._led)
        frame = camera.capture()
        light = grey_light(frame.pixels, frame.black_level)
        level = max(float(np.percentile(light[::4, ::4], FINGER_PERCENTILE)), 0.01)
        self._product = time_s * gain * float(np.clip(self._exposure.target / level, 0.25, 4.0))
        half = 0.5 * FOCUS_FIELD_MM * rig.camera.px_per_mm
        part = tuple(
            slice(max(int(length / 2 - half), 0), int(length / 2 + half)) for length in light.shape
        )
        everywhere = np.ones(light[part].shape, dtype=np.bool_)
        sharpness = measure_focus(light[part], everywhere, rig.camera.px_per_mm).sharpness
        self.best = max(self.best, sharpness)
        self.looks += 1
        counts, _ = np.histogram(light[::4, ::4], 64, (0.0, 1.0))
        return {
            "sharpness": round(sharpness, 3),
            "best": round(self.best, 3),
            "exposure_ms": round(1e3 * time_s, 2),
            "histogram": counts.tolist(),
            "clipped": float(np.mean(frame.pixels >= np.iinfo(frame.pixels.dtype).max)),
            "picture": _jpeg(frame.pixels),
            "middle": _jpeg(frame.pixels[part]),
        }


def _jpeg(pixels: PixelArray) -> str:
    scale = min(1.0, 640 / pixels.shape[1])
    seen = np.asarray(pixels / (np.iinfo(pixels.dtype).max / 255.0), dtype=np.uint8)[..., ::-1]
    small = cv2.resize(seen, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", small)[1].tobytes()).decode("ascii")


def serve_preview(
    preview: Preview, seconds: float, port: int, ready: Callable[[str], None]
) -> None:
    """Serve the page on 127.0.0.1 for some seconds; `ready` gets its address, which no other user
    of this computer can guess. Raises BadInput where the port is taken.

    One request at a time: the camera takes one picture at a time.
    """

    secret = f"/{secrets.token_urlsafe()}"

    class Handler(BaseHTTPRequestHandler):
        timeout = 2.0  # s

        def do_GET(self) -> None:
            """Answer."""
            folder, _, name = self.path.rpartition("/")
            # another site's page that resolves its own name to this computer
            if self.headers.get("Host") not in hosts:
                self._answer(403, "text/plain", "open the address that the terminal shows")
            elif not hmac.compare_digest(folder.encode(), secret.encode()):
                self._answer(404, "text/plain", "open the address that the terminal shows")
            elif not name:
                self._answer(200, "text/html; charset=utf-8", PAGE.read_text(encoding="utf-8"))
            elif name == "look":
                try:
                    self._answer(200, "application/json", json.dumps(preview.look()))
                except BadInput as error:
                    self._answer(503, "text/plain; charset=utf-8", printable(str(error)))
            else:
                self._answer(404, "text/plain", "not here")

        def _answer(self, code: int, kind: str, text: str) -> None:
            body = text.encode("utf-8")
            self.send_response(code)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            with suppress(ConnectionError):  # the page was closed
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, *unused: object) -> None:
            """Write nothing."""

    try:
        server = HTTPServer(("127.0.0.1", port), Handler)
    except OSError as error:
        raise BadInput(
            f"port {port} of this computer is taken ({error.strerror}); end the other preview."
        ) from error
    with server:
        server.timeout = 0.2
        hosts = {f"{name}:{server.server_port}" for name in ("127.0.0.1", "localhost")}
        ready(f"http://127.0.0.1:{server.server_port}{secret}/")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            server.handle_request()
