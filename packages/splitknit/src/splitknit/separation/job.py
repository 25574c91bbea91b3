"""Images under fine patterns in; direct and global light out."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Annotated, Any

from splitknit.verbs import AnyPath, Encoding, Help, Job, Progress, path


@dataclass(frozen=True, slots=True)
class SeparateJob(Job):
    """Split images under fine patterns into direct and global light.

    Returns
    -------
    dict
        The facts of ``report.json``, and ``out``.
    """

    # fmt: off
    folder: Annotated[AnyPath, Help("folder of images under patterns", positional=True)]
    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write the results into", "DIR")]
    alpha: Annotated[float, Help("fraction of the pattern that is lit")] = 0.5
    dark: Annotated[float, Help("brightness of its unlit part")] = 0.0
    patterns: Annotated[str | None, Help(
        "folder of state images, white = lit, or 'estimate' to find the states in the images: no bias by noise",
        "WHERE")] = None
    encoding: Annotated[Encoding, Help("of the images")] = "linear"
    check_px: Annotated[float | None, Help(
        "side of a check on the images, for noisy checkerboards on skin (whose states are found in the images unless "
        "`patterns` gives them)")] = None
    # fmt: on

    def run(self, progress: Progress) -> dict[str, Any]:
        """Separate them, and write what comes out."""
        from splitknit.separation.folder import separate_to_folder

        return separate_to_folder(
            path(self.folder),
            path(self.out),
            alpha=self.alpha,
            dark=self.dark,
            patterns=self.patterns,
            encoding=self.encoding,
            check_px=self.check_px,
            progress=progress,
        )
