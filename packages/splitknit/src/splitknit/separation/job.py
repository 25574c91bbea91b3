"""Images under fine patterns, or through polarising films, in; two kinds of light out."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from splitknit.errors import require
from splitknit.verbs import AnyPath, Encoding, Help, Job, Progress, path

_OF_PATTERNS = ("alpha", "dark", "patterns", "check_px")


@dataclass(frozen=True, slots=True)
class SeparateJob(Job):
    """Split images under fine patterns into direct and global light, or polarised ones.

    Returns
    -------
    dict
        The facts of ``report.json``, and ``out``.
    """

    # fmt: off
    folders: Annotated[tuple[AnyPath, ...], Help(
        "folder of images under patterns; or 'polarised PARALLEL CROSSED', two folders of the same "
        "photographs through parallel and crossed films: specular and diffuse light", "FOLDER", positional=True)]
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write the results into", "DIR")]
    alpha: Annotated[float | None, Help("fraction of the pattern that is lit (default: 0.5)")] = None
    dark: Annotated[float | None, Help("brightness of its unlit part (default: 0)")] = None
    patterns: Annotated[str | None, Help(
        "folder of state images, white = lit, or 'estimate' to find the states in the images: no bias by noise",
        "WHERE")] = None
    encoding: Annotated[Encoding | None, Help("of the images (default: linear)")] = None
    check_px: Annotated[float | None, Help(
        "side of a check on the images, for noisy checkerboards on skin (whose states are found in the images unless "
        "`patterns` gives them)")] = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Separate them, and write what comes out."""
        from splitknit.separation.folder import separate_polarised_folders, separate_to_folder

        folders, out = [Path(one) for one in self.folders], path(self.out)
        given = {name: getattr(self, name) for name in (*_OF_PATTERNS, "encoding")}
        given = {name: value for name, value in given.items() if value is not None}
        if len(folders) == 1:
            return separate_to_folder(folders[0], out, **given, progress=progress)
        plain = not set(given) & set(_OF_PATTERNS)
        good = len(folders) == 3 and str(folders[0]) == "polarised" and plain
        fault = "name one folder of images under patterns, or 'polarised PARALLEL CROSSED',"
        require(good, f"{fault} with `out` and `encoding` alone.")
        return separate_polarised_folders(folders[1], folders[2], out, encoding=self.encoding, progress=progress)
