"""Bring your own data: plain images and a ``lights.txt`` become a capture folder.

Without arguments this makes a small folder of its own (a matt sphere under six distant lights), converts it, reads it
back and prints what it holds. With arguments it converts a folder of yours::

    python examples/plot_convert_plain_images.py --images photos --lights photos/lights.txt --px-per-mm 20 \
        --background 71 --out my_capture
    splitknit reconstruct my_capture --out my_result

``lights.txt`` has a line ``x y z`` for each image, in the order of the images' names: the direction *towards* the
light, x right, y up, z to the camera.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from pathlib import Path

import numpy as np

from splitknit.errors import BadInput
from splitknit.imaging.band import linear_stack
from splitknit.io.capture import read_capture, write_capture
from splitknit.io.images import write_image
from splitknit.io.plain import capture_from_plain_images, read_lights_txt

SUFFIXES = {".png", ".tif", ".tiff", ".jpg", ".jpeg"}


def make_plain_folder(folder: Path, size: int = 96) -> None:
    """Write six images of a matt sphere, a mask, and ``lights.txt``."""
    azimuth = np.deg2rad(np.arange(6) * 60.0)
    slant = np.deg2rad(35.0)
    lights = np.stack([np.sin(slant) * np.cos(azimuth), np.sin(slant) * np.sin(azimuth)], axis=1)
    lights = np.column_stack([lights, np.full(6, np.cos(slant))])
    rows, columns = np.mgrid[:size, :size]
    x, y = (columns - (size - 1) / 2) / (0.45 * size), ((size - 1) / 2 - rows) / (0.45 * size)
    inside = x * x + y * y < 1.0
    normals = np.stack([x, y, np.sqrt(np.clip(1.0 - x * x - y * y, 0.0, None))], axis=-1)
    for k, light in enumerate(lights):
        shade = np.where(inside, np.clip(normals @ light, 0.0, None), 0.0)
        write_image(folder / f"photo_{k}.png", np.rint(shade * 200.0).astype(np.uint8))
    write_image(folder / "mask.png", inside.astype(np.uint8) * np.uint8(255))
    text = "\n".join(" ".join(f"{value:.6f}" for value in light) for light in lights)
    (folder / "lights.txt").write_text(f"# x right, y up, z to the camera\n{text}\n", encoding="ascii")


def images_in(folder: Path, mask: Path | None) -> list[Path]:
    """Return the images of a folder, photo_2 before photo_10; files called mask are no photographs."""
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and "mask" not in file.stem.lower()]
    files = [file for file in files if mask is None or file.resolve() != mask.resolve()]
    return sorted(files, key=lambda file: [int(part) if part.isdigit() else part for part in _words(file.name)])


def _words(name: str) -> list[str]:
    return re.split(r"(\d+)", name)


def describe(folder: Path) -> None:
    """Read a capture folder back and report what it holds."""
    capture = read_capture(folder)
    for name, band in capture.bands.items():
        light = linear_stack(band, capture.encoding)
        print(f"band {name}: {light.shape[0]} images of {light.shape[1]} x {light.shape[2]} pixels")
        for file, image, group in zip(band.files, light, band.leds, strict=True):
            direction = capture.rig.leds[group[0]].direction
            print(f"  {file}: light from {np.round(direction, 3)}, brightest pixel {image.max():.3f}")
    covered = "no mask" if capture.mask is None else f"mask covers {100 * capture.mask.mean():.1f} %"
    print(f"material {capture.material}, {capture.rig.camera.px_per_mm:g} px/mm, {covered}")


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Convert plain images and a lights.txt to a capture folder.")
    parser.add_argument("--images", type=Path, help="folder of images, all of one size")
    parser.add_argument("--lights", type=Path, help="directions towards the lights, a line x y z for each image")
    parser.add_argument("--px-per-mm", type=float, default=20.0)
    parser.add_argument("--out", type=Path, help="the capture folder to write")
    parser.add_argument("--mask", type=Path, help="image, white = object; replaces the automatic mask")
    parser.add_argument("--material", choices=["opaque", "skin"], default="opaque")
    parser.add_argument("--encoding", choices=["linear", "srgb"], default="linear")
    parser.add_argument("--background", type=float, default=0.0, help="stored value that every pixel has without light")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        if options.images is None:
            plain = Path(scratch) / "plain"
            plain.mkdir()
            make_plain_folder(plain)
            options.images, options.mask = plain, plain / "mask.png"
        lights = options.lights or options.images / "lights.txt"
        out = options.out or Path(scratch) / "capture"
        try:
            capture = capture_from_plain_images(
                images_in(options.images, options.mask),
                read_lights_txt(lights),
                options.px_per_mm,
                mask=options.mask,
                material=options.material,
                encoding=options.encoding,
                background=options.background,
            )
            write_capture(capture, out, overwrite=True)
        except (BadInput, OSError) as error:
            print(error)
            return 2
        describe(out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
