"""``splitknit records what FILE``: what a file of another system is, and what it holds, drawn if wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from splitknit import BadInput
from splitknit.cli.verb import Outcome, Verb, count
from splitknit.errors import require
from splitknit.verbs import AnyPath, Help, Job, Progress, path

if TYPE_CHECKING:
    from splitknit.io.prints import PrintFile
    from splitknit_match.records.minutiae_record import FingerView

_FIRST_BYTES = 4096


@dataclass(frozen=True, slots=True)
class WhatJob(Job):
    """Tell what a record, a picture or a template is, and what it holds."""

    file: Annotated[AnyPath, Help("any file", "FILE", positional=True)]
    out: Annotated[AnyPath | None, Help("draw its minutiae, or those of its prints, on the picture", "PNG")] = None

    def run(self, progress: Progress) -> Outcome:
        """Look at its bytes; that it cannot be read is a result, where it is known what it is."""
        from splitknit.errors import open_file
        from splitknit.io.atomic import write_file
        from splitknit.io.prints import PrintFile
        from splitknit.io.provenance import file_hash  # verbs import what they need
        from splitknit_match.records.fmr_bytes import standard_of, what_bytes_are
        from splitknit_match.records.print_formats import FORMATS, read_prints
        from splitknit_match.records.templates import MAGIC

        file, out = path(self.file), path(self.out)
        with open_file(file, 1 << 50) as (stream, size):
            first = stream.read(_FIRST_BYTES)
        form = next((one for one in FORMATS.values() if first.startswith(one.starts)), None)
        what = standard_of(first) or (form.words if form else what_bytes_are(first, "of an unknown kind"))
        facts: dict[str, Any] = {"file": str(file), "bytes": size, "sha256": file_hash(file), "what": what, "holds": []}
        lines = [f"{file}: {what}, {size:,} bytes."]
        if first.startswith(MAGIC):
            require(out is None, f"{file} is a template; only records and pictures are drawn.")
            return facts, lines
        try:
            held = read_prints(file) if form is not None else ()
        except BadInput as error:
            require(out is None, f"it cannot be drawn: {error}")
            return {**facts, "damage": str(error)}, [*lines, f"It cannot be read: {error}"]
        for number, one in enumerate(held, start=1):
            about: dict[str, Any] = {"finger": one.finger, "impression": one.impression}
            rows, columns = one.image.shape if isinstance(one, PrintFile) else one.size
            about |= {"rows": rows, "columns": columns}
            if isinstance(one, PrintFile):
                about["ppi"] = one.resolution_ppi
                said = "resolution unknown" if one.resolution_ppi is None else f"{one.resolution_ppi:.0f} ppi"
            else:
                about |= {"ppcm": list(one.resolution_ppcm), "minutiae": one.count, "quality": one.finger_quality}
                said = f"{count(one.count, 'minutia', 'minutiae')}, quality {one.finger_quality}"
            facts["holds"].append(about)
            who = one.finger.replace("_", " ")
            lines.append(f"{number}. {who}, {one.impression}: {columns} x {rows} pixels, {said}.")
        if out is not None:
            require(len(held) > 0, f"{file} holds no print and no minutiae that could be drawn.")
            require(out.resolve() != file.resolve(), f"'{out}' is the file itself; name another one.")
            write_file(out, _drawn(held, str(file)))
            facts["out"] = str(out)
            lines.append(f"Drawn: {out} (blue: endings; orange: bifurcations; grey: others).")
        return facts, lines


def _drawn(held: tuple[PrintFile | FingerView, ...], name: str) -> bytes:
    """PNG of what a file holds, side by side."""
    import cv2
    import numpy as np

    from splitknit.io.images import encode_image
    from splitknit.io.pictures import ORANGE, SKY
    from splitknit.io.prints import PrintFile
    from splitknit_match.prints.export import minutiae_in
    from splitknit_match.prints.from_file import print_at_500_ppi
    from splitknit_match.records.finger_image import MAX_PIXELS

    pictures = []
    sizes = [one.image.shape if isinstance(one, PrintFile) else one.size for one in held]
    require(sum(rows * columns for rows, columns in sizes) <= MAX_PIXELS, f"{name} is too large to be drawn.")
    for one in held:
        if isinstance(one, PrintFile):
            require(one.resolution_ppi is not None, f"{name} states no resolution, so its minutiae cannot be found.")
            view, grey = minutiae_in(one), print_at_500_ppi(one).image
        else:
            view, grey = one, np.full(one.size, 255, np.uint8)
        picture = np.repeat(grey[..., None], 3, axis=2)
        along = np.stack([np.cos(view.direction_rad), -np.sin(view.direction_rad)], axis=1)
        tails = np.stack([view.x_px, view.y_px], axis=1) + 12 * along
        for x, y, kind, tail in zip(view.x_px.tolist(), view.y_px.tolist(), view.type.tolist(), tails, strict=True):
            colour = SKY if kind == 1 else ORANGE if kind == 2 else (128, 128, 128)
            cv2.circle(picture, (x, y), 4, colour, 1, cv2.LINE_AA)
            cv2.line(picture, (x, y), tuple(np.rint(tail).astype(int).tolist()), colour, 1, cv2.LINE_AA)
        pictures.append(picture)
    highest = max(len(one) for one in pictures)
    padded = [np.pad(one, ((0, highest - len(one)), (0, 0), (0, 0)), constant_values=255) for one in pictures]
    return encode_image(np.hstack(padded), ".png")


WHAT = Verb(WhatJob)
