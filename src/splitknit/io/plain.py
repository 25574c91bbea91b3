"""Other people's data: plain images and a list of light directions become a capture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, check_lights, read_bytes, require
from splitknit.io.content import check_content, mask_from_image
from splitknit.io.images import StackReader, image_size
from splitknit.model import Band, Camera, Capture, Led, Rig

Background = float | str | os.PathLike[str] | None


def read_lights_txt(path: str | os.PathLike[str]) -> NDArray[np.float64]:
    """Read light directions (L, 3) from a text file: x, y, z a line, apart by spaces or commas.

    A first line with a single number is the count of the lights that follow; ``#`` starts a comment.

    Raises
    ------
    BadInput
        Naming the file and the line.
    """
    name = os.fspath(path)
    try:
        text = read_bytes(path, 1_000_000).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadInput(f"{name} is not a text file.") from error
    rows: list[list[float]] = []
    count: int | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        if len(words) == 1 and not rows and count is None and words[0].isdecimal():
            count = int(words[0][:9])
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        require(
            len(values) == 3 and all(abs(value) <= 1e6 for value in values),
            f"{name}, line {number}: three finite numbers x y z are expected, none beyond a million, but it is "
            f"{line.strip()[:60]!a}.",
        )
        rows.append(values)
    require(len(rows) > 0, f"{name} holds no lights: a line x y z for each image is expected.")
    require(
        count is None or count == len(rows), f"{name} states {count} lights in its first line, but {len(rows)} follow."
    )
    return np.array(rows, dtype=np.float64)


def capture_from_plain_images(
    images: Sequence[str | os.PathLike[str]],
    lights: NDArray[np.float64],
    px_per_mm: float,
    *,
    intensities: Sequence[float] | None = None,
    mask: str | os.PathLike[str] | None = None,
    material: str = "opaque",
    encoding: str = "linear",
    background: Background = None,
    tip_direction_deg: float | None = None,
) -> Capture:
    """Make a capture of images of one object under distant lights; all of them form the band ``white``.

    Parameters
    ----------
    images : PNG, TIFF or JPEG files of one size, at least three, in the order of the lights
    lights : (L, 3) directions *towards* the lights, x right, y up, z to the camera, of any length
    px_per_mm : pixels a millimetre on the object; heights scale with it
    intensities : relative strength of each light; equal where None
    mask : image file, white = object
    material : ``opaque`` (default) or ``skin``
    encoding : ``linear`` or ``srgb``
    background : stored value of no light that was added to every pixel (a number), or an image with all lights off
    tip_direction_deg : where a finger's tip points (0 = up, counter-clockwise)

    Returns
    -------
    Capture
        Write it with :func:`splitknit.write_capture`.

    Raises
    ------
    BadInput
        If files are missing, damaged or of different sizes, lights and images differ in number, the lights do not
        determine a normal, an image is black or overexposed.
    """
    require(len(images) >= 3, f"at least three images are needed, but there are {len(images)}.")
    require(material in ("skin", "opaque"), f"material must be 'skin' or 'opaque', but it is '{material}'.")
    require(encoding in ("linear", "srgb"), f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.")
    vectors = check_lights(lights, len(images))
    require(
        bool((vectors[:, 2] > 0).all()),
        f"light {int(np.argmin(vectors[:, 2]))} points away from the camera (z <= 0); lights point towards the light.",
    )
    files = [Path(image) for image in images]
    rig = _rig(vectors, px_per_mm, image_size(files[0]), intensities)
    size, by = rig.camera.image_size, str(files[0])
    is_file = isinstance(background, (str, os.PathLike))
    with StackReader() as reader:
        stack = reader.start(files, size, by)
        ambient = reader.start([Path(background)], size, by)[0] if is_file else None  # type: ignore[arg-type]
        mask_pixels = None if mask is None else reader.start([Path(mask)], size, by)[0]
        hashes = reader.finish()
    black = 0.0 if is_file or background is None else float(background)  # type: ignore[arg-type]
    full = int(np.iinfo(stack.dtype).max)
    require(0.0 <= black < full, f"the background must lie between 0 and {full}, but it is {black:g}.")
    band = Band(
        name="white",
        pixels=stack,
        leds=tuple((k,) for k in range(len(files))),
        exposure=np.ones(len(files)),
        black_level=np.full(len(files), black),
        ambient=ambient,
        files=tuple(str(file) for file in files),
    )
    check_content(band)
    return Capture(
        rig=rig,
        bands={"white": band},
        encoding=encoding,
        material=material,
        tip_direction_deg=tip_direction_deg,
        mask=None if mask_pixels is None else mask_from_image(mask_pixels, str(mask)),
        hashes=hashes,
    )


def _rig(
    vectors: NDArray[np.float64], px_per_mm: float, size: tuple[int, int], intensities: Sequence[float] | None
) -> Rig:
    strengths = [1.0] * len(vectors) if intensities is None else [float(value) for value in intensities]
    require(
        len(strengths) == len(vectors),
        f"there are {len(strengths)} intensities for {len(vectors)} lights; give one for each.",
    )
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    leds = tuple(
        Led(band="white", direction=(float(x), float(y), float(z)), intensity=strength)
        for (x, y, z), strength in zip(units, strengths, strict=True)
    )
    return Rig(Camera(px_per_mm=float(px_per_mm), image_size=size), leds, {"source": "plain images, distant lights"})
