"""``splitknit records what FILE``: what a file of another system is, and what it holds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from splitknit import BadInput
from splitknit.cli.verb import Outcome, Verb, count
from splitknit.verbs import AnyPath, Help, Job, Progress, path

_FIRST_BYTES = 4096


@dataclass(frozen=True, slots=True)
class WhatJob(Job):
    """Tell what a record, a picture or a template is, and what it holds."""

    file: Annotated[AnyPath, Help("any file", "FILE", positional=True)]

    def run(self, progress: Progress) -> Outcome:
        """Look at its bytes; that it cannot be read is a result, where it is known what it is."""
        from splitknit.errors import open_file
        from splitknit.io.prints import PrintFile
        from splitknit.io.provenance import file_hash  # verbs import what they need
        from splitknit_match.records.fmr_bytes import standard_of, what_bytes_are
        from splitknit_match.records.print_formats import FORMATS, read_prints

        file = path(self.file)
        with open_file(file, 1 << 50) as (stream, size):
            first = stream.read(_FIRST_BYTES)
        form = next((one for one in FORMATS.values() if first.startswith(one.starts)), None)
        what = standard_of(first) or (form.words if form else what_bytes_are(first, "of an unknown kind"))
        facts: dict[str, Any] = {"file": str(file), "bytes": size, "sha256": file_hash(file), "what": what, "holds": []}
        lines = [f"{file}: {what}, {size:,} bytes."]
        try:
            held = read_prints(file) if form is not None else ()
        except BadInput as error:
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
        return facts, lines


WHAT = Verb(WhatJob)
