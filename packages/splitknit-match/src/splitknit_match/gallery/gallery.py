"""A gallery to enrol into and to search: :class:`splitknit_match.Gallery`, :func:`splitknit_match.enroll`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from splitknit.model import no_progress
from splitknit.verbs import AnyPath, Progress
from splitknit_match.gallery.enrol import Duplicates, Enrolling, Enrolment, enroll_fingers
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.gallery.identify import Identification, identify_finger
from splitknit_match.gallery.identify_job import IdentifyJob
from splitknit_match.gallery.key import Key
from splitknit_match.matching.inputs import Side, held
from splitknit_match.matching.match_job import Finger


class Gallery(GalleryFile):
    """A gallery that stays open, in memory; threads and forked processes may use one object.

    Each call sees what the file holds at that time, also what other programs changed, and whichever file has the name
    then; one that was there and is gone is refused. One that is not there yet appears with its first finger.

    Examples
    --------
    >>> import splitknit_match
    >>> with splitknit_match.Gallery("people.skg") as gallery:  # doctest: +SKIP
    ...     gallery.enroll(pixels, "Ann", "right_index", resolution_ppi=500)
    ...     found = gallery.identify(other_pixels, resolution_ppi=500)
    """

    def __enter__(self) -> Gallery:
        return self

    def identify(self, probe: Finger, *, side: Side | None = None, **how: Any) -> Identification:
        """Who is it? `how`: as of :func:`splitknit_match.identify` (``resolution_ppi``, ``top``, ``fmr``, ``person``
        for verification ...). Raises BadInput as it.
        """
        return identify_finger(IdentifyJob(self.path, probe, **how), gallery=self, side=side)

    def enroll(
        self,
        finger_of: Finger | Sequence[Finger],
        person: str,
        finger: str,
        *,
        session: str | None = None,
        resolution_ppi: float | None = None,
        duplicates: Duplicates = "warn",
        how: Enrolling | None = None,
        put_down: Callable[[], object] = lambda: None,
        progress: Progress = no_progress,
    ) -> Enrolment:
        """Put a finger, or several sessions of one, in; as :func:`splitknit_match.enroll`.

        `put_down`: called before what was written is final, such as to write a line into a log; what it raises undoes
        it.
        """
        several = isinstance(finger_of, list | tuple)
        fingers: Sequence[Any] = finger_of if several else [finger_of]  # type: ignore[assignment]
        return enroll_fingers(
            self, [held(one, resolution_ppi) for one in fingers], person, finger, session, how=how or Enrolling(),
            duplicates=duplicates, put_down=put_down, progress=progress,
        )  # fmt: skip


def enroll(
    gallery: AnyPath,
    finger_of: Finger | Sequence[Finger],
    person: str,
    finger: str,
    *,
    session: str | None = None,
    key: Key | AnyPath | None = None,
    resolution_ppi: float | None = None,
    duplicates: Duplicates = "warn",
    how: Enrolling | None = None,
    progress: Progress = no_progress,
) -> Enrolment:
    """Put a finger, or several sessions of one, into a gallery, which is made where there is none; all or none.

    Parameters
    ----------
    gallery : path
    finger_of : path, array (H, W) uint8 of a print, or bytes of a template; or a list of them
    person, finger, session : str
        Finger: such as ``right_index``; session: by default the next number.
    key : path, optional
        File with the key of an encrypted gallery.
    resolution_ppi : float, optional
        Pixels per inch of arrays.
    duplicates : {"refuse", "warn", "allow"}
        What to do about one that matches another person's (of the person's own fingers it is only said),
        at a false match rate of 1 in 10,000 a comparison: refuse it, report it (the default), or not look. Of more
        than 200 captures those whose minutiae agree best are compared, so that about 1 in 100 such fingers is missed.
    how : Enrolling, optional
        Preset, settings and what is kept.
    progress : callable, optional

    Returns
    -------
    Enrolment

    Raises
    ------
    BadInput
        Naming what is at fault; the gallery is then as before.
    """
    with Gallery(gallery, key) as opened:
        return opened.enroll(
            finger_of, person, finger, session=session, resolution_ppi=resolution_ppi, duplicates=duplicates, how=how,
            progress=progress,
        )  # fmt: skip
