"""Where a batch lies: in folders of a disk, or as objects behind a URL (``s3://bucket/people``), by fsspec.

An object appears whole or not at all: it is put at once, when all its bytes are known. Credentials and addresses of
servers are fsspec's and the store's own affair (environment, configuration files): none is taken, kept or written here.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, BinaryIO

from splitknit import BadInput, atomic_file, inside, open_file, read_bytes, require

MEMORY = "memory"
SCHEMES = ("s3", "gs", "az", MEMORY)  # schemes of URLs that are accepted; nothing else on a network is ever contacted
_MAX_CAPTURE_BYTES = 20_000_000_000
_AHEAD_BYTES = 1 << 16  # what is read beyond what is asked for: most objects come in one piece
_UNREAD = frozenset({"truth.npz", "impression.json"})  # files of a simulated capture that nobody reconstructs from
_NO_METADATA = "AWS_EC2_METADATA_DISABLED"


@dataclass(frozen=True, slots=True)
class Objects:
    """A folder or a file among objects, used as a :class:`pathlib.Path` is."""

    url: str  # ``s3://bucket/people``, without an end

    def __truediv__(self, name: str) -> Objects:
        """Return what is called `name` below this."""
        return Objects(f"{self.url}/{name}")

    def __str__(self) -> str:
        return self.url

    @property
    def name(self) -> str:
        """Last part of the URL."""
        return self.url.rpartition("/")[2]

    @property
    def stem(self) -> str:
        """The same without its suffix."""
        return PurePosixPath(self.name).stem


Location = Path | Objects  # where a population, a store, or a file in it is


def location(name: str | os.PathLike[str] | Objects) -> Location:
    """What a name means: a URL is objects, all else a path.

    Raises BadInput if the URL is of another kind than :data:`SCHEMES`, incomplete, or holds credentials.

    >>> location("s3://fingers/people/").url
    's3://fingers/people'
    """
    if isinstance(name, Objects):
        return name
    text = os.fspath(name)
    scheme, found, rest = text.partition("://")
    if not found:
        return Path(text)
    cure = f"use {', '.join(f'{one}://' for one in SCHEMES)}, or a folder."
    require(scheme in SCHEMES, f"'{scheme}://' is not an object storage that a batch may lie in; {cure}")
    bucket, _, below = rest.strip("/").partition("/")
    require(
        "@" not in bucket and "?" not in rest and "#" not in rest,
        f"a URL of {scheme}:// names a bucket and a place in it only; give credentials and options by the environment "
        "(docs/guide/batch.md), never in a URL.",
    )
    clean = bool(below) and text.isprintable() and not {"", ".", ".."} & set(below.split("/"))
    require(clean, f"a URL must be of the form {scheme}://BUCKET/PLACE, but it is '{scheme}://{rest}'.")
    return Objects(f"{scheme}://{bucket}/{below}")


def stored_bytes(place: Location, max_bytes: int) -> bytes:
    """Read a whole file or object; BadInput if it is missing, larger than `max_bytes`, or cannot be read."""
    if isinstance(place, Path):
        return read_bytes(place, max_bytes)
    with stored_file(place, max_bytes) as stream:
        return stream.read()


@contextlib.contextmanager
def stored_file(place: Location, max_bytes: int) -> Iterator[IO[bytes]]:
    """Open a file or an object of at most `max_bytes`; of an object only what is asked for is read, a little ahead.
    Raises BadInput if it is missing, too large, or cannot be read.
    """
    if isinstance(place, Path):
        with open_file(place, max_bytes) as (stream, _):
            yield stream
        return
    with _refusing(place, "read"):
        fs, path = _of(place)
        with fs.open(path, block_size=_AHEAD_BYTES) as stream:
            fits = stream.size <= max_bytes
            require(fits, f"'{place}' is too large: {stream.size} bytes, at most {max_bytes} are read.")
            yield stream


@contextlib.contextmanager
def whole_file(place: Location) -> Iterator[BinaryIO]:
    """Yield a binary file that becomes `place`, as a whole, when the block ends; BadInput if it cannot be written."""
    if isinstance(place, Path):
        with atomic_file(place) as stream:
            yield stream
        return
    memory = io.BytesIO()
    yield memory
    with _refusing(place, "written"):
        fs, path = _of(place)
        fs.pipe_file(path, memory.getvalue())  # not its open(): that keeps a part where the block fails


def there(place: Location) -> bool:
    """Whether there is a file or object of this name. Raises BadInput if that cannot be found out."""
    if isinstance(place, Path):
        return place.is_file()
    with _refusing(place, "read"):
        fs, path = _of(place)
        return bool(fs.isfile(path))


def files_below(place: Location, *, deep: bool = False) -> list[str]:
    """Names of the files in a folder, or below it, relative to it and in order; none where there is no folder."""
    if isinstance(place, Path):
        found = [file for file in (place.rglob("*") if deep else place.glob("*")) if file.is_file()]
        return sorted(file.relative_to(place).as_posix() for file in found)
    return sorted(_sizes(place, deep=deep))


def _sizes(place: Objects, *, deep: bool) -> dict[str, int]:
    """Bytes of the objects of a folder by their names in it."""
    with _refusing(place, "listed"):
        fs, path = _of(place)
        found = fs.find(path, maxdepth=None if deep else 1, detail=True)
        start = len(path.rstrip("/")) + 1
        return {name[start:]: int(facts["size"]) for name, facts in found.items() if len(name) > start}


@contextlib.contextmanager
def captures_at_hand(population: Location, names: Sequence[str]) -> Iterator[Iterator[Path]]:
    """Yield, for each capture in turn, a folder of this computer below which it lies under its name, until the next one
    is asked for. Objects are copied into a private temporary folder, the next capture while the present one is worked
    on, without what is not read (truth). Raises BadInput if objects cannot be read, or the name of one leads out of its
    capture: that is not a failure of the capture.
    """
    if isinstance(population, Path):
        for name in names:
            inside(population, name, f"'{population}'", "the name of a capture")
        yield iter([population] * len(names))
        return
    with tempfile.TemporaryDirectory(prefix="splitknit-") as folder, ThreadPoolExecutor(1) as ahead:
        roots = [Path(folder) / str(k) for k in range(len(names))]

        def each() -> Iterator[Path]:
            coming = [ahead.submit(_copy, population, names[0], roots[0])] if names else []
            for k, root in enumerate(roots):
                coming.pop().result()
                if k + 1 < len(names):
                    coming.append(ahead.submit(_copy, population, names[k + 1], roots[k + 1]))
                yield root
                shutil.rmtree(root)

        yield each()


def _copy(population: Objects, name: str, root: Path) -> None:
    """Copy a capture's objects to where they lie below `root`; of what is not read, the name alone."""
    source, target = population / name, inside(root, name, f"'{population}'", "the name of a capture")
    target.mkdir(parents=True)
    sizes = {file: size for file, size in _sizes(source, deep=True).items() if file not in _UNREAD}
    fault = f"'{source}' is too large for a capture: {sum(sizes.values())} bytes,"
    require(sum(sizes.values()) <= _MAX_CAPTURE_BYTES, f"{fault} at most {_MAX_CAPTURE_BYTES} are read.")
    (target / "truth.npz").touch()
    with _refusing(source, "read"):
        fs, path = _of(source)
        for file, size in sizes.items():
            local = inside(target, file, f"'{source}'", "the name of an object")
            local.parent.mkdir(parents=True, exist_ok=True)
            with _refusing(source / file, "read"):
                got = local.write_bytes(fs.cat_file(f"{path}/{file}"))
                require(got == size, f"'{source / file}' came with {got} of {size} bytes; run the same again.")


def _of(place: Objects) -> tuple[Any, str]:
    """File system of fsspec and the path in it, of which nothing that was listed earlier is believed."""
    if place.url.startswith("s3:"):
        os.environ.setdefault(_NO_METADATA, "true")  # else it asks 169.254.169.254 where it finds no credentials
    from fsspec.core import url_to_fs  # type: ignore[import-untyped]  # only where a URL is named

    fs, path = url_to_fs(place.url)
    fs.invalidate_cache()
    return fs, path


@contextlib.contextmanager
def _refusing(place: Objects, what: str) -> Iterator[None]:
    """Turn whatever a storage raises into one sentence; the storage's own words may quote what is secret."""
    try:
        yield
    except (BadInput, MemoryError):
        raise
    except FileNotFoundError as error:
        raise BadInput(f"'{place}' does not exist; correct the name, or make the bucket first.") from error
    except ImportError as error:
        scheme = place.url.partition(":")[0]
        package = {"s3": "s3fs", "gs": "gcsfs", "az": "adlfs"}.get(scheme, "fsspec")
        raise BadInput(f"{scheme}:// needs {package}, which cannot be imported; pip install {package}.") from error
    except Exception as error:
        fault = f"'{place}' cannot be {what} ({type(error).__name__})"
        cure = "check the bucket, its rights, the address of the server and the credentials in the environment,"
        raise BadInput(f"{fault}; {cure} and run the same again.") from error
