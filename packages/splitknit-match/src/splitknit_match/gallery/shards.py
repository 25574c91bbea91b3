"""Shards: the codes of a gallery as files that are mapped into memory, for searches through millions of fingers.

A folder of shards holds renewable codes (:mod:`splitknit_match.matching.renewable`) and the numbers of the rows they
belong to, nothing else. It is made from a gallery, brought up to date in part, and renewed under a new salt as often as
wanted (:func:`write_shards`); the gallery itself stays as it is. A search compares the bits of all codes, the finer
numbers of the best, and leaves the rest to the ridges.

Each file is a header of 4096 bytes (JSON, padded with blanks), then row numbers (N, little-endian int64), bits
(N, 64 bytes) and numbers (N, 192 bytes). ``shards.json`` lists the files and their SHA-256, under an HMAC by the key: a
file that something else changed, exchanged or took away is found by the first search that would read it.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import (
    BadInput,
    FloatArray,
    atomic_file,
    canonical_json,
    json_text,
    make_folder,
    open_file,
    read_json,
    refusing,
    require,
    sweep,
    write_file,
)
from splitknit_match.gallery.key import SALT_BYTES, Key, code_secret
from splitknit_match.matching.code import CODE_VERSION, ProbeSettings, code_size, probe_codes
from splitknit_match.matching.renewable import BITS, RenewableCode
from splitknit_match.matching.template import Template

ROWS_A_SHARD = 1 << 22
"""Row numbers that share a file: 1.1 GB if all are taken."""
RESCORED = 10_000
"""Fingers whose finer numbers are compared, at most; of a smaller gallery a hundredth, but a thousand at least."""
_FORMAT, _VERSION, _HEADER = "splitknit-code-shard", 1, 4096
_NAME = re.compile(r"codes-[0-9]{6}\.skc")
SEALED = "shards.json"
"""Lists the files of a folder of shards."""
_sound: set[tuple[Any, ...]] = set()
"""Files that this process compared with their SHA-256, as they were then."""
_LARGEST = 1 << 40
_BLOCK = 4096
_FAR = 1 << 12
"""Beyond any Hamming distance."""


@dataclass(frozen=True, slots=True)
class Hits:
    """The best of a search, best first."""

    rows: NDArray[np.int64]
    """(k,) of the gallery."""
    similarity: FloatArray
    """(k,) of the codes, -1 to about 1."""
    variant: NDArray[np.int64]
    """(k,) of :meth:`splitknit_match.matching.code.ProbeSettings.variants`, how the probe was laid."""


def write_shards(
    folder: Path,
    rows: NDArray[np.int64],
    codes: NDArray[np.int8],
    key: Key | None = None,
    *,
    renew: bool = False,
    rows_a_shard: int = ROWS_A_SHARD,
) -> dict[str, Any]:
    """Make a folder of shards what a gallery holds; return facts.

    Files whose rows (N,), ascending, and codes (N, K) int8 are as they were stay as they are; those that are damaged,
    or that something else changed, are written anew. The same rows, codes, key and salt give the same bytes, in however
    many steps they were added. `key`: of the gallery; without one the codes are not protected, as anyone can make the
    transform from the salt; `renew`: under a new salt, with which nothing of before can be compared; `rows_a_shard`:
    row numbers that share a file. Raises BadInput if there is no code, the codes are of another shape, the rows do not
    ascend, the folder holds something else, links, or shards under another key, or it cannot be written.
    """
    require(
        len(rows) > 0, f"there is no code to keep in shards; enrol fingers first (and remove '{folder}' if it is old)."
    )
    wanted = (len(rows), code_size())
    require(codes.shape == wanted and codes.dtype == np.int8, f"codes must be int8 of the shape {wanted}.")
    require(bool((np.diff(rows) > 0).all()) and (len(rows) == 0 or rows[0] >= 0), "rows of shards must ascend from 0.")
    try:
        make_folder(folder)
        sweep(folder)  # writing would do it, but a run that changes nothing writes nothing
    except OSError as error:
        raise BadInput(
            f"'{folder}' cannot be a folder of shards ({error.strerror}); name a folder with `shards`."
        ) from error
    found = list(folder.iterdir())
    require(not found or bool(_files(folder)), f"'{folder}' is not empty and holds no shards; name another folder.")
    for file in (*_files(folder), folder / SEALED):
        require(not file.is_symlink(), f"'{file}' is a link, through which nothing is written; remove it.")
    known = []
    for file in () if renew else _files(folder):
        with contextlib.suppress(BadInput):  # what is damaged is written anew
            known.append(_read_header(file))
    salts = {header["salt"] for header in known}
    require(len(salts) < 2, f"the shards in '{folder}' are of several salts; renew them.")
    salt = bytes.fromhex(salts.pop()) if salts else os.urandom(SALT_BYTES)
    secret = code_secret(key, salt)
    code = RenewableCode(secret)
    for header in known:
        _require_key(folder, header["check"], code)
    written, kept, contents = 0, 0, {}
    there = {header["file"].name: header["digest"] for header in known}
    sealed = {}
    with contextlib.suppress(BadInput):
        sealed = _read_sealed(folder, secret)
    starts = np.flatnonzero(np.diff(rows // rows_a_shard, prepend=-1))
    for start, end in zip(starts, [*starts[1:], len(rows)], strict=True):
        name = f"codes-{rows[start] // rows_a_shard:06d}.skc"
        content = hashlib.sha256(np.ascontiguousarray(rows[start:end], dtype="<i8").data)
        content.update(np.ascontiguousarray(codes[start:end]).data)
        digest = hmac.digest(secret, content.digest(), "sha256").hex()
        if there.get(name) == digest and sealed.get(name, "") == _sha256(folder / name):
            contents[name] = sealed[name]
            kept += 1
            continue
        about = {
            "format": _FORMAT, "version": _VERSION, "code_version": CODE_VERSION, "rows": int(end - start),
            "bits": BITS, "numbers": code_size(), "salt": salt.hex(), "check": code.check.hex(), "digest": digest,
            "encrypted": key is not None,
        }  # fmt: skip
        _write_shard(folder / name, about, rows[start:end], codes[start:end], code)
        contents[name] = _sha256(folder / name)
        written += 1
    for file in _files(folder):
        if file.name not in contents:
            file.unlink()
    if contents != sealed:
        write_file(
            folder / SEALED, json_text({**_SEAL, "shards": contents, "seal": _seal(contents, secret)}).encode("ascii")
        )
    return {"shards": str(folder), "fingers": len(rows), "written": written, "kept": kept, "keyed": key is not None}


def _write_shard(
    file: Path, about: dict[str, Any], rows: NDArray[np.int64], codes: NDArray[np.int8], code: RenewableCode
) -> None:
    with atomic_file(file) as stream:
        stream.write(json.dumps(about, sort_keys=True).encode("ascii").ljust(_HEADER))
        stream.write(np.ascontiguousarray(rows, dtype="<i8").data)
        places = _HEADER + 8 * len(rows), _HEADER + (8 + BITS // 8) * len(rows)
        for start in range(0, len(codes), _BLOCK):
            for place, part in zip(places, code.stored(codes[start : start + _BLOCK]), strict=True):
                stream.seek(place + start * part.shape[1])
                stream.write(part.data)


def files_of_shards(folder: Path) -> list[Path]:
    """What :func:`write_shards` wrote into a folder; nothing where there is none."""
    found = []
    for file in (*_files(folder), folder / SEALED):
        with contextlib.suppress(BadInput), open_file(file, _LARGEST) as (stream, _):
            found += [file] if f'"{_FORMAT}'.encode("ascii") in stream.read(_HEADER) else []
    return found if any(file.name != SEALED for file in found) else []


_SEAL = {"format": f"{_FORMAT}s", "version": 1}


def _seal(contents: dict[str, str], secret: bytes) -> str:
    message = b"splitknit code shards 1\0" + canonical_json(contents).encode("ascii")
    return hmac.digest(secret, message, "sha256").hex()


def _read_sealed(folder: Path, secret: bytes) -> dict[str, str]:
    """SHA-256 of the shards by name; raises BadInput if there is no such list, or it was not made with the key."""
    changed = _changed(folder)
    require((folder / SEALED).is_file(), changed)
    document, _ = read_json(folder / SEALED)
    with refusing(changed):
        contents = dict(document["shards"])
        require(hmac.compare_digest(document["seal"], _seal(contents, secret)), changed)
    return contents


def _changed(folder: Path) -> str:
    return (
        f"the shards in '{folder}' are not those that were last written (something else changed them, or their making "
        f"was stopped); run 'splitknit gallery index' with `shards` {folder} again."
    )


def _sha256(file: Path) -> str:
    with open_file(file, _LARGEST) as (stream, _):
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _files(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if _NAME.fullmatch(file.name)) if folder.is_dir() else []


def _read_header(file: Path) -> dict[str, Any]:
    """Header of a shard whose size is what it says, as a dictionary with its file and sizes.

    Raises BadInput if it is none, damaged, cut off, or of another version; nothing is mapped then.
    """
    wrong = f"'{file}' is not a shard of codes, or damaged; make it anew with 'splitknit gallery index' and `shards`."
    with open_file(file, _LARGEST) as (stream, size):
        head = stream.read(_HEADER)
    with refusing(wrong):
        header = json.loads(head)
        require(header["format"] == _FORMAT, wrong)
        versions = header["version"], header["code_version"], header["bits"], header["numbers"]
        current = (_VERSION, CODE_VERSION, BITS, code_size())
        require(
            versions == current,
            f"'{file}' holds codes of another version; make it anew with 'splitknit gallery index' and `shards`.",
        )
        rows = header["rows"]
        require(type(rows) is int and rows > 0 and size == _HEADER + rows * (8 + BITS // 8 + code_size()), wrong)
        bytes.fromhex(header["digest"])
        sound = len(bytes.fromhex(header["salt"])) == SALT_BYTES and len(bytes.fromhex(header["check"])) == 16
        require(sound and type(header["encrypted"]) is bool, wrong)
    return {**header, "file": file}


def _require_key(folder: Path, check: str, code: RenewableCode) -> None:
    require(
        hmac.compare_digest(bytes.fromhex(check), code.check),
        f"the key is not that of the shards in '{folder}'; give the one they were made with, or make them anew with "
        "'splitknit gallery index', `shards` FOLDER and `renew`.",
    )


class Shards:
    """A folder of shards, mapped; what is read of it is what a search touches."""

    def __init__(self, folder: Path, key: Key | None = None) -> None:
        """Open the shards in a folder.

        Raises BadInput if there is none, one is missing, damaged or of another version, or the key is missing, wrong or
        not wanted.
        """
        headers = [_read_header(file) for file in _files(folder)]
        require(
            len(headers) > 0, f"'{folder}' holds no shards of codes; 'splitknit gallery index' makes some (`shards`)."
        )
        first = headers[0]
        require(
            all(header["check"] == first["check"] and header["salt"] == first["salt"] for header in headers),
            f"the shards in '{folder}' are of several keys; make them anew with 'splitknit gallery index', `shards` "
            f"{folder} and `renew`.",
        )
        require(
            first["encrypted"] == (key is not None),
            f"the shards in '{folder}' were made {'with' if first['encrypted'] else 'without'} a key; "
            + ("give it." if first["encrypted"] else "leave the key out, or renew them with it."),
        )
        secret = code_secret(key, bytes.fromhex(first["salt"]))
        self._code = RenewableCode(secret)
        _require_key(folder, first["check"], self._code)
        self._contents = _read_sealed(folder, secret)
        require(set(self._contents) == {header["file"].name for header in headers}, _changed(folder))
        self.files = tuple(Path(header["file"]) for header in headers)
        self._sizes = [int(header["rows"]) for header in headers]

    def __len__(self) -> int:
        return sum(self._sizes)

    def require_same(self, rows: NDArray[np.int64], codes: NDArray[np.int8]) -> None:
        """Compare every byte with what these rows and codes give; BadInput if one differs."""
        place = 0
        for file in self.files:
            there = _mapped(file, self._code.check, self._contents)
            count = len(there[0])
            same = np.array_equal(there[0], rows[place : place + count])
            for start in range(0, count if same else 0, _BLOCK):
                end = min(start + _BLOCK, count)
                expected = self._code.stored(codes[place + start : place + end])
                same = same and all(
                    np.array_equal(one[start:end], other) for one, other in zip(there[1:], expected, strict=True)
                )
            place += count
            require(same, _behind(file))
        require(place == len(rows), _behind(self.files[0].parent))

    def search(self, template: Template, k: int = 500, settings: ProbeSettings | None = None) -> Hits:
        """The `k` fingers whose codes are most similar, equal ones in the order of their rows; at most `RESCORED`.

        The result is the same, whatever the number of shards and threads. `settings`: of the probe's variants. Raises
        BadInput if the probe is a failure to acquire, k is less than 1, or a shard changed meanwhile.
        """
        require(k >= 1, f"k must be at least 1, but it is {k}.")
        settings = settings or ProbeSettings()
        bits, fine = self._code.probe(probe_codes(template, settings))
        count = rescored_count(len(self))
        every = [_mapped(file, self._code.check, self._contents) for file in self.files]
        places = [_nearest(bits[settings.coarse()], one[1], count) for one in every]
        chosen = _best(np.concatenate([distance for distance, _ in places]), count)
        found, start = [], 0
        for (numbers, _, codes), (_, place) in zip(every, places, strict=True):
            # the file is read forwards
            here = np.sort(place[chosen[(chosen >= start) & (chosen < start + len(place))] - start])
            products = fine @ codes[here].T.astype(np.float32)
            variant = products.argmax(axis=0)
            found.append((numbers[here], products[variant, np.arange(len(here))], variant))
            start += len(place)
        rows, similarity, variant = (np.concatenate(parts) for parts in zip(*found, strict=True))
        order = np.lexsort((rows, -similarity))[:k]
        return Hits(rows[order], similarity[order], variant[order])


def _behind(place: Path) -> str:
    return f"'{place}' does not hold the codes of the gallery as it is; run 'splitknit gallery index' again (`shards`)."


def rescored_count(fingers: int) -> int:
    """How many of so many fingers have their finer numbers compared."""
    return min(fingers, RESCORED, max(1000, fingers // 100))


_Mapped = tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.int8]]
"""Rows, bits and numbers."""


def _mapped(file: Path, check: bytes, contents: dict[str, str]) -> _Mapped:
    """Map a shard whose SHA-256 is the expected one; it is computed once a process, and again after a change."""
    header = _read_header(file)
    require(header["check"] == check.hex(), f"'{file}' is of another key than the probe; open the shards again.")
    with open_file(file, _LARGEST) as (stream, size):
        status, content = os.fstat(stream.fileno()), contents.get(file.name, "")
        state = (file, content, status.st_ino, size, status.st_mtime_ns, status.st_ctime_ns)
        if state not in _sound:
            require(hashlib.file_digest(stream, "sha256").hexdigest() == content, _changed(file.parent))
            _sound.add(state)
        count, data = int(header["rows"]), np.memmap(stream, np.uint8, "r")
    first, second = _HEADER + 8 * count, _HEADER + 8 * count + BITS // 8 * count
    return (
        np.asarray(data[_HEADER:first].view("<i8")),
        np.asarray(data[first:second]).reshape(count, -1),
        np.asarray(data[second:].view(np.int8)).reshape(count, -1),
    )


def _best(distance: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Places of the `count` least distances; of equal ones the first."""
    return np.argsort(distance, kind="stable")[:count]


def _nearest(
    probe: NDArray[np.uint8], bits: NDArray[np.uint8], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Distances and places of the `count` codes nearest to any variant, in the order of distance, then place.

    With faiss where it is installed: its search by counting keeps the first of equal distances, whatever the number of
    threads, which share out variants, not codes.
    """
    count = min(count, len(bits))
    try:
        import faiss  # of the extra `search`
    except ImportError:
        return _nearest_by_numpy(probe, bits, count)
    distances, places = faiss.knn_hamming(probe, bits, count, variant="mc")
    joined = np.sort((places.astype(np.int64) * _FAR + distances).ravel())
    first = np.flatnonzero(np.diff(joined // _FAR, prepend=-1))
    place, distance = np.divmod(joined[first], _FAR)
    order = _best(distance, count)
    return distance[order], place[order]


def _nearest_by_numpy(
    probe: NDArray[np.uint8], bits: NDArray[np.uint8], count: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    words = np.ascontiguousarray(probe).view(np.uint64)
    distance = np.empty(len(bits), dtype=np.int64)
    for start in range(0, len(bits), _BLOCK):
        part = np.ascontiguousarray(bits[start : start + _BLOCK]).view(np.uint64)
        apart = [np.bitwise_count(part ^ word).sum(axis=1, dtype=np.int64) for word in words]
        distance[start : start + len(part)] = np.min(apart, axis=0)
    order = _best(distance, count)
    return distance[order], order.astype(np.int64)
