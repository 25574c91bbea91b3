"""The polarising films of a rig, from a printed matt card and a glossy black ball (or a sheet of
glass) behind them.

The card returns depolarised light, of which both positions of the analyser should pass the same
fraction. It shows how much darker the crossed images are, their tint, and by how much turning the
analyser shifts the image. The ball reflects the lights specularly: what remains of them in the
crossed images has leaked through the films.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from splitknit import Capture, read_capture, write_rig
from splitknit.errors import naming, require
from splitknit.findings import Finding
from splitknit.imaging.pixels import GREY_WEIGHTS, block_means, pick_channel
from splitknit.imaging.robust import deviation
from splitknit.io.capture import with_rig
from splitknit.io.provenance import plain_json, provenance
from splitknit.model import Array, BoolArray, Films, FloatArray, Progress
from splitknit.observation.films import crossed_place
from splitknit.observation.light import Light
from splitknit_rig.calibration.radiometry import rounded
from splitknit_rig.calibration.written import check_rig_file

_LEAK_ERROR = 2.5e-4
"""Half of the largest error of the measured leak. Chosen on: simulated objects (rigs with
films)."""


def films_to_file(
    folder: Path,
    out: Path,
    *,
    rig: Path | None,
    progress: Progress,
) -> dict[str, Any]:
    """Measure the films by the photographs in `folder`, and write them into the rig file `out`."""
    check_rig_file(out)
    progress("card", 0.0)
    captures = {}
    for name in ("card", "ball"):
        capture = read_capture(folder / name, may_be_dark=name == "ball")
        captures[name] = capture if rig is None else with_rig(capture, rig)
        require(
            "white_crossed" in capture.bands,
            f"{folder / name} holds no crossed series; photograph the {name} with the analyser"
            " parallel (white) and crossed (white_crossed).",
        )
    card, ball = captures["card"], captures["ball"]
    require(
        ball.bands["white"].leds == card.bands["white"].leds and ball.shape == card.shape,
        f"{folder / 'ball'} has other LEDs or another size than {folder / 'card'}; use the same for"
        " both.",
    )
    films, facts = naming(folder / "card", lambda: measure_card(card))
    progress("ball", 0.4)
    light = naming(folder / "ball", lambda: measure_ball(ball, films))
    both = light[:, 0, 0] + light[:, 1, 0]
    leak = light[:, 1, 0] / both
    error = np.hypot(np.hypot(light[:, 1, 1], leak * light[:, 0, 1]) / both, _LEAK_ERROR)
    facts["leak_interval"] = [
        [rounded(max(a - 2 * b, 0.0)), rounded(a + 2 * b)] for a, b in zip(leak, error, strict=True)
    ]
    leaking = [
        Finding(
            "film-leak",
            f"light {k}: {100 * part:.1f} % of the specular light is left in the crossed image;"
            " turn its film or the analyser.",
        )
        for k, part in enumerate(leak)
        if part > 0.05
    ]
    facts["findings"] += [finding.facts for finding in leaking]
    films = replace(films, leak=tuple(rounded(float(part)) for part in np.clip(leak, 0.0, 0.499)))
    hashes = {
        f"{name}/{file}": digest
        for name, capture in captures.items()
        for file, digest in capture.hashes.items()
    }
    facts |= provenance({}, hashes)
    write_rig(
        replace(
            card.rig,
            films=films,
            provenance={**card.rig.provenance, "polarisers": plain_json(facts)},
        ),
        out,
    )
    progress("done", 1.0)
    return {**facts, "films": plain_json(asdict(films)), "out": str(out)}


def _series(capture: Capture) -> tuple[Light, Light]:
    """Light of the parallel and the crossed series, behind the films."""
    near, far = (
        Light(capture.bands[name], capture.rig, capture.encoding)
        for name in ("white", "white_crossed")
    )
    return near, far


def _undone(image: FloatArray, films: Films) -> FloatArray:
    """A crossed image (h, w) or (h, w, C), of floats or as stored, resampled onto the parallel
    one's pixels."""
    matrix = crossed_place(films, image.shape)
    size = (image.shape[1], image.shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    )


def _image(light: Light, k: int) -> FloatArray:
    """(h, w, 3) linear light of one image."""
    return np.ascontiguousarray(np.moveaxis(light.of_images([k]).stack[:, 0], 0, 2))


def _grey(light: Light, k: int) -> FloatArray:
    """(h, w) the same in grey."""
    return np.asarray(light.of_images([k]).grey[0])


# The card: where the crossed image lies, and its brightness.


def measure_card(card: Capture) -> tuple[Films, dict[str, Any]]:
    """Measure the films' image shift and brightness, not yet the leak, with a printed matt card;
    also errors and residuals. Raises BadInput if the card has no print, is clipped, or moved.
    """
    near, far = _series(card)
    some = (0, near.photographs // 2)
    grey = [sum(_grey(band, k) for k in some) for band in (near, far)]
    films, deviation = _shift(*grey)  # type: ignore[arg-type]
    inner = np.zeros(card.shape, dtype=np.float32)
    margin = 4 + int(np.hypot(*films.shift_px))
    inner[margin:-margin, margin:-margin] = 1.0
    side = max(4, max(card.shape) // 60)  # 60 cells along the longer side
    cells = (card.shape[0] // side, card.shape[1] // side)
    brightness = []
    residuals = []
    for k in range(near.photographs):
        good = inner * ~(near.of_images([k]).clipped[0] | far.of_images([k]).clipped[0])
        parts = (good, _image(near, k), _undone(_image(far, k), films))
        whole, p, c = (block_means(part, cells, side) for part in parts)
        bright = pick_channel(p, "grey")
        used = (whole > 0.999) & (bright > max(0.4 * float(np.percentile(bright, 95)), 0.0))
        require(
            int(used.sum()) >= 50,
            f"image {k}: too little of the card is bright and not clipped; expose it to about 70 %"
            " of full scale.",
        )
        ratio = np.full((*cells, 3), np.nan)
        ratio[used] = c[used].astype(np.float64) / p[used]
        brightness.append(np.nanmedian(ratio, axis=(0, 1)))
        least, most = brightness[-1].min(), brightness[-1].max()
        require(
            least > 0.2 and most < 5.0,
            f"image {k}: the card is {least:.2g} to {most:.2g} times as bright in the crossed image"
            " as in the parallel one; state exposure_s of every image, and compare the films.",
        )
        residuals.append((ratio / brightness[-1]) @ GREY_WEIGHTS.astype(np.float64) - 1.0)
    rms = [100 * float(np.sqrt(np.nanmean(residual**2))) for residual in residuals]
    count = [int(np.isfinite(residual).sum()) for residual in residuals]
    facts = {
        "shift_interval_px": [rounded(2.0 * part) for part in deviation[:2]],
        "scale_interval": rounded(2.0 * deviation[2]),
        "brightness_interval": [
            rounded(2.5 * 0.01 * part / np.sqrt(n)) for part, n in zip(rms, count, strict=True)
        ],
        "residual_rms_percent": list(map(rounded, rms)),
        "residual_largest_percent": [
            rounded(100 * float(np.nanmax(np.abs(residual)))) for residual in residuals
        ],
        "findings": [
            Finding(
                "glossy-card",
                f"the card's crossed image {k} departs by {departure:.1f} % (rms) from a parallel"
                " one of other brightness; use a matt card.",
            ).facts
            for k, departure in enumerate(rms)
            if departure > 1.0 and near.lights[k] == far.lights[k]
        ],
    }
    rows = tuple(tuple(map(rounded, row.tolist())) for row in brightness)
    return replace(films, leds=tuple(group[0] for group in near.lights), brightness=rows), facts


def _shift(parallel: FloatArray, crossed: FloatArray) -> tuple[Films, Array]:
    """Register the crossed image (h, w) to the parallel one by least squares, coarse to fine; with
    standard deviations (3,)."""
    crossed = crossed * np.float32(parallel.mean() / max(float(crossed.mean()), 1e-9))
    films = Films((), (), ())
    for sigma in (8.0, 4.0, 2.0):  # px, coarse to fine
        blurs = (sigma, 4.0 * sigma)  # what is finer than the second and coarser than the first
        fixed, moving = (
            np.subtract(
                *(
                    cv2.GaussianBlur(image, (0, 0), s, borderType=cv2.BORDER_REPLICATE)
                    for s in blurs
                )
            )
            for image in (parallel, crossed)
        )
        fields = [spline_filter(part, mode="nearest") for part in (moving, *np.gradient(moving))]
        every, margin = max(1, int(sigma / 2)), int(3 * sigma) + 8
        places = np.mgrid[tuple(slice(margin, n - margin, every) for n in parallel.shape)]
        rows, columns = places.reshape(2, -1)
        require(rows.size > 100, "the pictures of the card are too small.")
        down, across = rows - (parallel.shape[0] - 1) / 2, columns - (parallel.shape[1] - 1) / 2
        seen = fixed[rows, columns].astype(np.float64)
        for _ in range(10):  # OpenCV would round places to 1/32 pixel
            at = crossed_place(films, parallel.shape) @ (columns, rows, np.ones(len(rows)))
            here, slope_y, slope_x = (
                map_coordinates(field, at[::-1], prefilter=False, mode="nearest")
                for field in fields
            )
            jacobian = np.stack([slope_x, slope_y, slope_x * across + slope_y * down, here])
            normal = jacobian @ jacobian.T
            step = np.linalg.lstsq(normal, jacobian @ (seen - here), rcond=None)[0]
            x, y, s = (
                films.shift_px[0] + step[0],
                films.shift_px[1] + step[1],
                films.scale + step[2],
            )
            films = replace(films, shift_px=(float(x), float(y)), scale=float(s))
            if float(np.abs(step[:2]).max()) < 1e-4:
                break
        rest = seen - here - step @ jacobian
        likeness = (
            float(np.corrcoef(seen, here)[0, 1]) if float(seen.std() * here.std()) > 0 else 0.0
        )
    # a card without print has no details that correlate
    require(
        likeness >= 0.5,
        "the parallel and the crossed image of the card show no common details; photograph a matt"
        " card with print on it, such as the board of 'splitknit rig target', and leave it in place"
        " while the analyser is turned.",
    )
    # blurred noise is alike over 4 pi sigma^2 pixels
    variance = (
        np.diag(np.linalg.pinv(normal))
        * float((rest**2).mean())
        * 4.0
        * np.pi
        * (sigma / every) ** 2
    )
    x, y = map(rounded, films.shift_px)
    return replace(films, shift_px=(x, y), scale=round(films.scale, 7)), np.sqrt(variance[:3])


# The ball: what is left of the lights that it mirrors.


@dataclass(frozen=True, slots=True)
class Spot:
    """Specular highlight of a light in an image: its centre and extent."""

    column: int
    row: int
    radius_px: float

    def disc(self, shape: tuple[int, ...], times: float = 1.0) -> BoolArray:
        """(h, w) pixels within a multiple of the radius."""
        rows, columns = np.ogrid[: shape[0], : shape[1]]
        return np.asarray(
            (rows - self.row) ** 2 + (columns - self.column) ** 2 <= (times * self.radius_px) ** 2
        )


def measure_ball(ball: Capture, films: Films) -> Array:
    """(L, 2, 2) light of the parallel and crossed highlights of L lights in a glossy black ball,
    and its standard deviation. Raises BadInput if a highlight is missing or clipped, or the series
    are swapped.
    """
    near, far = _series(ball)
    matrix = crossed_place(films, ball.shape)
    light = []
    for k, (led, crossed_led) in enumerate(zip(near.lights, far.lights, strict=True)):
        grey = cv2.GaussianBlur(_grey(near, k), (0, 0), 1.0)
        spot = _spot(grey, k)
        column, row = matrix @ (spot.column, spot.row, 1.0)
        place = Spot(round(float(column)), round(float(row)), spot.radius_px)
        if led != crossed_led:  # films at right angles on LEDs beside each other
            grey = cv2.GaussianBlur(_grey(far, k), (0, 0), 1.0)
            # LEDs beside each other are mirrored on the ball within 1 mm
            around = replace(place, radius_px=ball.rig.camera.px_per_mm).disc(grey.shape)
            at = np.unravel_index(int(np.argmax(np.where(around, grey, -np.inf))), grey.shape)
            place = Spot(int(at[1]), int(at[0]), spot.radius_px)
        crossed = _flux(far, k, place) / (films.brightness[k] @ GREY_WEIGHTS)
        light.append((_flux(near, k, spot), crossed))
    values = np.array(light)
    require(
        float(np.median(values[:, 1, 0] / values[:, 0, 0])) < 1.0,
        "the highlights are brighter in the crossed series than in the parallel one; exchange white"
        " and white_crossed.",
    )
    return values


def _spot(grey: NDArray[Any], k: int) -> Spot:
    row, column = np.unravel_index(int(np.argmax(grey)), grey.shape)
    beside = float(np.median(grey))
    peak = float(grey[row, column]) - beside
    _, labels = cv2.connectedComponents((grey > beside + 0.5 * peak).astype(np.uint8))
    area = float((labels == labels[row, column]).sum())
    noise = deviation(grey - beside)
    require(
        peak > max(10.0 * noise, 3.0 * beside) and area < 0.01 * grey.size,
        f"image {k}: no highlight stands out; photograph a glossy black ball or a sheet of glass"
        " that mirrors the light.",
    )
    return Spot(int(column), int(row), 3.0 * float(np.sqrt(area / np.pi)) + 5.0)


def _flux(light: Light, k: int, spot: Spot) -> Array:
    """(2,) grey light of a highlight above its surroundings, and its standard deviation."""
    grey = _grey(light, k).astype(np.float64)
    disc = spot.disc(grey.shape)
    require(
        not (light.of_images([k]).clipped[0] & disc).any(),
        f"image {k} of the band '{light.name}': the highlight is clipped; photograph the ball with"
        " a shorter exposure.",
    )
    ring = grey[spot.disc(grey.shape, 1.8) & ~spot.disc(grey.shape, 1.1)]
    beside = float(np.median(ring))
    spread = deviation(ring - beside)
    flux = float((grey[disc] - beside).sum())
    pixels = disc.sum() * (1.0 + 1.57 * disc.sum() / max(ring.size, 1))
    # an LED's light varies by 0.4 % from one photograph to the next, with its shot noise
    return np.array([flux, np.sqrt(spread**2 * pixels + (0.004 * flux) ** 2)])
