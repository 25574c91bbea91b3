"""Input checks with one message style: what was expected, what came, what to do about it.

Every check raises :class:`BadInput`, a ``ValueError`` whose text is one sentence that a user can
act on. The command line prints it and exits with code 2. An argument stands between backticks in it
(```px_per_mm```), of which the command line makes its option.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:  # numpy takes longer to import than all the rest of `splitknit --help`
    import numpy as np
    from numpy.typing import NDArray

T = TypeVar("T")
J = TypeVar("J")


class BadInput(ValueError):  # noqa: N818 - a user reads it as a statement about the input, not about our code
    """The input cannot be used; the message names the part, and the remedy.

    A message quotes what files hold: characters that end a line or cannot be printed become escapes
    in it, and what is longer than 2000 characters is cut.
    """

    def __init__(self, message: str = "") -> None:
        """Take over the message."""
        super().__init__(printable(message if len(message) <= 2000 else f"{message[:2000]} ..."))


def printable(text: str) -> str:
    """Return `text` on one line that moves no cursor: what cannot be printed, and what turns the
    direction of writing, become escapes.

    Every line that a person reads goes through here: names of files, and what files hold, may be
    any characters.

    >>> print(printable(chr(27) + "[2J" + chr(0x202E) + "gnp.exe"))
    \\x1b[2J\\u202egnp.exe
    """
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    )


class Refused(BadInput):
    """The input was understood and is not good enough; `facts` hold what was found all the same."""

    def __init__(self, message: str, facts: dict[str, Any]) -> None:  # noqa: D107 - the class says it
        super().__init__(message)
        self.facts = facts


class BadExposure(BadInput):
    """A sound image is black, blank or overexposed."""


def require(condition: Any, message: str, kind: type[BadInput] = BadInput) -> None:
    """Raise :class:`BadInput`, or a `kind` of it, with `message` unless `condition` holds."""
    if not condition:
        raise kind(message)


class Unfinished:
    """Counts open critical sections; Ctrl-C and SIGTERM wait until it is zero.

    A section, such as removing a temporary folder, begins with ``UNFINISHED.depth += 1`` (a call
    could be interrupted before it counts) and ends with :meth:`leave` in a ``finally``.
    """

    depth = 0
    signal = 0
    """What came meanwhile."""

    def leave(self) -> None:
        """One part is done; if it was the last, what came meanwhile comes now."""
        self.depth -= 1
        if self.signal and not self.depth:
            import signal

            number, self.signal = self.signal, 0
            signal.raise_signal(number)


UNFINISHED = Unfinished()


@contextlib.contextmanager
def importing(message: str) -> Iterator[None]:
    """Turn a failure to import a package that not every installation has into BadInput. `message`
    says how to get it; ``{error}`` in it becomes Python's reason.
    """
    try:
        yield
    except (ImportError, OSError) as error:
        raise BadInput(message.format(error=error)) from error


def naming(path: object, work: Callable[[], T]) -> T:
    """Let what stages refuse, which know arrays only, name the file."""
    try:
        return work()
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error


@contextlib.contextmanager
def refusing(message: str) -> Iterator[None]:
    """Turn whatever a parser raises in the block into :class:`BadInput` with `message`, one
    sentence.

    A :class:`BadInput` passes as it is, and so does a :class:`MemoryError`: it is not a fault of
    the input.

    >>> with refusing("the table is damaged; write it again."):
    ...     {}["rows"]
    Traceback (most recent call last):
    ...
    splitknit.errors.BadInput: the table is damaged; write it again.
    """
    try:
        yield
    except (BadInput, MemoryError):
        raise
    except Exception as error:  # parsers raise whatever they meet
        raise BadInput(message) from error


@contextlib.contextmanager
def open_file(
    path: str | os.PathLike[str], max_bytes: int
) -> Iterator[tuple[io.BufferedReader[io.FileIO], int]]:
    """Open a regular file of at most `max_bytes`; yield the stream and the file's size. Raises
    BadInput if it is missing, no regular file (devices and pipes are not opened for reading), too
    large, or cannot be read, also in the block.
    """
    name = shown_path(path)
    try:
        # closes a folder, unlike fdopen
        with io.BufferedReader(io.FileIO(path, "rb", opener=open_at_once)) as stream:
            status = os.fstat(stream.fileno())
            require(stat.S_ISREG(status.st_mode), f"{name} is not a file.")
            require(
                status.st_size <= max_bytes,
                f"{name} is too large: {status.st_size} bytes, at most {max_bytes} are read.",
            )
            yield stream, status.st_size
    except FileNotFoundError as error:
        raise BadInput(f"{name} does not exist; add the file or correct the name.") from error
    except IsADirectoryError as error:
        raise BadInput(f"{name} is not a file.") from error
    except BadInput:
        raise
    except (OSError, ValueError) as error:
        raise BadInput(
            f"{name} cannot be read: {getattr(error, 'strerror', None) or error}."
        ) from error


def open_at_once(path: str | os.PathLike[str], flags: int, mode: int = 0o600) -> int:
    """Opener for files: through no link (:func:`given_folders`), and at once where a pipe has no
    writer."""
    refuse_links(path)
    return os.open(path, flags | os.O_NONBLOCK, mode)


_GIVEN: set[str] = set()


@contextlib.contextmanager
def given_folders(paths: Iterable[str | os.PathLike[str]]) -> Iterator[None]:
    """In the block, nothing inside these folders is read or written through a symbolic link: a
    folder may come from anyone. What the user named may be a link. Readers (:func:`open_file`) and
    writers (:mod:`splitknit.io.atomic`) ask :func:`refuse_links`, in worker processes too
    (:func:`with_given_folders`).
    """
    earlier = set(_GIVEN)
    for path in map(Path, paths):
        with contextlib.suppress(OSError, ValueError, RuntimeError):  # refused where it is used
            own = path.expanduser()
            _GIVEN.update(map(str, (path.absolute(), own.absolute(), own.resolve())))
    try:
        yield
    finally:
        _GIVEN.clear()
        _GIVEN.update(earlier)


def with_given_folders(work: Callable[[J], T]) -> Callable[[J], T]:
    """Return `work` for another process, where the same folders are given as here."""
    return functools.partial(_in_given_folders, tuple(_GIVEN), work)


def _in_given_folders(folders: tuple[str, ...], work: Callable[[J], T], job: J) -> T:
    with given_folders(folders):
        return work(job)


def refuse_links(path: str | os.PathLike[str]) -> None:
    """Refuse, by name, a link inside the nearest given folder above `path`. Raises BadInput."""
    whole = Path(path).absolute() if _GIVEN else None
    if whole is None or str(whole) in _GIVEN:
        return
    inside = [whole]
    for parent in whole.parents:
        if str(parent) in _GIVEN:
            link = next((part for part in reversed(inside) if part.is_symlink()), None)
            name = path if link == whole else link
            require(
                link is None,
                f"'{name}' is a link inside a folder, which is not followed; put the file or folder"
                " itself there.",
            )
            return
        inside.append(parent)


def read_bytes(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """Read a whole regular file of at most `max_bytes`; every reader of a file goes through here.

    The size is checked before memory is taken, and again while reading, for a file that grows and
    for those of ``/proc``, which have no size. Raises BadInput as :func:`open_file`.

    >>> read_bytes("/dev/zero", 1000)
    Traceback (most recent call last):
    ...
    splitknit.errors.BadInput: /dev/zero is not a file.
    """
    with open_file(path, max_bytes) as (stream, size):
        data = stream.read(size + 1)
        while len(data) > size and len(data) <= max_bytes and (more := stream.read(1 << 16)):
            data += more
    require(
        len(data) <= max_bytes, f"{shown_path(path)} is too large: more than {max_bytes} bytes."
    )
    return data


def shown_path(path: str | os.PathLike[str]) -> str:
    """Return a path as messages give it, on one line."""
    text = os.fspath(path)
    return text if text.isprintable() else ascii(text)


def check_stack(stack: Any, *, least: int = 1, name: str = "stack") -> NDArray[np.float32]:
    """Return `stack` as a finite float32 array of shape (L, H, W) with at least `least` images."""
    import numpy as np

    array = np.asarray(stack)
    require(
        array.ndim == 3,
        f"{name} must have the shape (L, H, W), but it has the shape {array.shape}.",
    )
    require(
        array.shape[0] >= least,
        f"{name} must hold at least {least} images, but it holds {array.shape[0]}.",
    )
    require(
        array.shape[1] > 0 and array.shape[2] > 0, f"{name} has empty images: shape {array.shape}."
    )
    return _finite(array, name)


def check_image(image: Any, *, name: str = "image") -> NDArray[np.float32]:
    """Return `image` as a finite float32 array of shape (H, W)."""
    import numpy as np

    array = np.asarray(image)
    require(
        array.ndim == 2 and array.size > 0,
        f"{name} must have the shape (H, W), but it has {array.shape}.",
    )
    return _finite(array, name)


def check_mask(mask: Any, shape: tuple[int, int], *, name: str = "mask") -> NDArray[np.bool_]:
    """Return `mask` as a boolean array of `shape` that is true somewhere; ``None`` gives an
    all-true mask."""
    import numpy as np

    if mask is None:
        return np.ones(shape, dtype=np.bool_)
    array = np.asarray(mask)
    require(array.shape == shape, f"{name} must have the shape {shape}, but it has {array.shape}.")
    result = array.astype(np.bool_, copy=False)
    require(bool(result.any()), f"{name} is empty: not one pixel belongs to the surface.")
    return result


def check_lights(
    lights: Any, count: int | None = None, *, name: str = "lights"
) -> NDArray[np.float64]:
    """`lights` as a float64 array (L, 3) that determines a normal: finite, non-zero, distinct, not
    coplanar. A row's length is the light's relative strength. Directions within 0.5 deg are
    duplicates; where the smallest singular value is below 1 % of the largest they lie in one plane
    for all practical purposes. Raises BadInput otherwise.
    """
    import numpy as np

    array = np.asarray(lights, dtype=np.float64)
    require(
        array.ndim == 2 and array.shape[1] == 3,
        f"{name} must have the shape (L, 3), but it has {array.shape}.",
    )
    finite = np.isfinite(array) & (np.abs(array) < 1e100)  # the squares of more overflow
    require(bool(finite.all()), f"{name} contains NaN or infinite values.")
    require(
        count in (None, array.shape[0]),
        f"{name} and images differ in number: {array.shape[0]} lights for {count} images.",
    )
    require(
        array.shape[0] >= 3,
        f"photometric stereo needs at least 3 lights, but {name} holds {array.shape[0]}.",
    )
    norms = np.linalg.norm(array, axis=1)
    require(
        bool((norms > 0).all()), f"{name} contains a zero vector (light {int(np.argmin(norms))})."
    )
    unit = array / norms[:, None]
    cosines = unit @ unit.T - 2.0 * np.eye(len(unit))
    i, j = np.unravel_index(int(np.argmax(cosines)), cosines.shape)
    require(
        bool(cosines[i, j] < np.cos(np.deg2rad(0.5))),
        f"{name} {min(i, j)} and {max(i, j)} have the same direction; remove one or correct the"
        " rig.",
    )
    singular = np.linalg.svd(unit, compute_uv=False)
    require(
        bool(singular[-1] > 0.01 * singular[0]),
        f"{name} are coplanar; normals need light directions that span three dimensions.",
    )
    return array


def _finite(array: NDArray[Any], name: str) -> NDArray[np.float32]:
    import numpy as np

    result = np.ascontiguousarray(array, dtype=np.float32)
    require(bool(np.isfinite(result).all()), f"{name} contains NaN or infinite values.")
    return result
