"""Changes to sound files: of any bytes, and of the formats whose checksums or structure such changes do not get past.

A file is its bytes, or a word for what is no file: ``folder``, ``pipe``, ``loop`` (a link to itself), ``huge`` (3 GB of
nothing). Nothing leads out of the folder: some readers may also write, and the fuzzer may be root.
"""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import sqlite3
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from random import Random
from typing import Any

import numpy as np
from tests.png_files import PNG, chunk

File = bytes | str
Files = dict[str, File]
SPECIAL = ("folder", "pipe", "loop", "huge")
LONGEST = 4_000_000
"""Of a mutated file: what is refused for its size alone shows nothing else."""
_EDGES = [0, 1, 2, 3, 127, 128, 255, 256, 4095, 32767, 32768, 65535, 65536, 10**6, 2**31 - 1, 2**31, 2**32 - 1]
_EDGES += [2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1]
_TEXTS = [b"0", b"-1", b"1", b"65536", b"2147483648", b"99999999999999999999", b"1e999", b"-1e308", b"1e-320", b"nan"]
_TEXTS += [b"inf", b"NaN", b"", b" ", b"9" * 5000, b"\xff", b"\xef\xbb\xbf", b"\0", b"\n", b'"', b",", b"\xed\xa0\x80"]
_TEXTS += ["٣".encode(), "é".encode(), b"../../x", b"/nowhere/x", b"%s%n", b"__class__", b"0x10", b"1_000"]
_VALUES: list[Any] = [None, True, False, 0, -1, 1, 0.5, 2**31, 2**63, 10**30, 10**400, -(10**400), 1e308, -1e308]
_VALUES += [1e-320, 5e-324, float("nan"), float("inf"), "", " ", "x" * 5000, "a\nb", "\ud800", "\0", "é", "..", "/"]
_VALUES += ["../../x", "/nowhere/x", "C:\\x", "~", "srgb", "linear", "nir", "white", "1", "nan", "\u202e"]
_VALUES += [[], {}, [[]], [0] * 300, [None], {"": 0}, [1e308, 1e308, 1e308], [0, 0, 0], [[0, 0], [0, 0]]]


def mutated(files: Files, others: list[Files], random: Random, repair: Callable[[Files], Files] | None) -> Files:
    """Return the files with one to four changes.

    Parameters
    ----------
    files : a sound sample
    others : all sound samples, to splice in
    random : decides everything
    repair : makes checksums fit again; done in half of the cases
    """
    result = dict(files)
    for _ in range(random.choice((1, 1, 1, 2, 2, 3, 4))):
        names = sorted(name for name, file in result.items() if isinstance(file, bytes))
        if not names:
            break
        # small files are documents, which decide more than pixels do
        name = random.choice(names if random.random() < 0.5 else sorted(names, key=lambda one: len(result[one]))[:3])
        if (len(result) > 1 and random.random() < 0.08) or random.random() < 0.005:
            _change_place(result, name, random)
        else:
            pool = [other[name] for other in others if isinstance(other.get(name), bytes)]
            result[name] = change(result[name], pool, random)[:LONGEST]  # type: ignore[arg-type]
    return repair(result) if repair is not None and random.random() < 0.5 else result


def change(data: bytes, pool: list[Any], random: Random) -> bytes:
    """Return changed bytes of one file; by its format in two of three cases, where that is known."""
    if random.random() < 0.67:
        for is_one, changes in _FORMATS:
            if is_one(data):
                # what was changed before may be no such file any more: then any bytes are changed
                with contextlib.suppress(Exception), warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    return random.choice(changes)(data, random)
                break
    return random.choice(_ANY)(data, pool, random)


def _change_place(files: Files, name: str, random: Random) -> None:
    action = random.choice(("missing", "other", "special"))
    if action == "missing":
        del files[name]
    elif action == "other":
        files[name] = files[random.choice(sorted(files))]
    else:
        files[name] = random.choice(SPECIAL)


# --- any bytes ---------------------------------------------------------------------------------------------------


def _place(data: bytes, random: Random) -> int:
    """Headers are at the beginning, directories at the end."""
    reach = random.choice((len(data), len(data), 64, 300))
    place = random.randrange(max(1, min(reach, len(data))))
    return len(data) - 1 - place if random.random() < 0.15 and data else place


def _flip(data: bytes, pool: list[bytes], random: Random) -> bytes:
    result = bytearray(data or b"\0")
    for _ in range(random.choice((1, 1, 2, 8))):
        result[_place(bytes(result), random)] ^= 1 << random.randrange(8)
    return bytes(result)


def _set(data: bytes, pool: list[bytes], random: Random) -> bytes:
    result = bytearray(data or b"\0")
    for _ in range(random.choice((1, 1, 3))):
        result[_place(data, random) if data else 0] = random.choice((0, 1, 0x7F, 0x80, 0xFF, random.randrange(256)))
    return bytes(result)


def _number(data: bytes, pool: list[bytes], random: Random) -> bytes:
    size, order = random.choice((2, 4, 4, 8)), random.choice(("little", "big"))
    place = _place(data, random)
    place -= place % random.choice((1, size))
    value = random.choice(_EDGES) + random.choice((0, 0, -1, 1))
    return data[:place] + (value % (1 << 8 * size)).to_bytes(size, order) + data[place + size :]  # type: ignore[arg-type]


def _cut(data: bytes, pool: list[bytes], random: Random) -> bytes:
    return data[: _place(data, random)]


def _take_out(data: bytes, pool: list[bytes], random: Random) -> bytes:
    place = _place(data, random)
    return data[:place] + data[place + random.choice((1, 2, 4, 50, 1000)) :]


def _put_in(data: bytes, pool: list[bytes], random: Random) -> bytes:
    place = _place(data, random)
    return (
        data[:place] + random.choice((random.randbytes(random.randrange(1, 40)), random.choice(_TEXTS))) + data[place:]
    )


def _double(data: bytes, pool: list[bytes], random: Random) -> bytes:
    place, size = _place(data, random), random.choice((1, 4, 30, 1000))
    return data[: place + size] + data[place : place + size] * random.choice((1, 1, 50)) + data[place + size :]


def _zero(data: bytes, pool: list[bytes], random: Random) -> bytes:
    place, size = _place(data, random), random.choice((4, 16, 200))
    part = data[place : place + size]
    return data[:place] + random.choice((b"\0", b"\xff")) * len(part) + data[place + size :]


def _splice(data: bytes, pool: list[bytes], random: Random) -> bytes:
    other = random.choice(pool) if pool else data
    return data[: _place(data, random)] + other[_place(other, random) :]


def _digits(data: bytes, pool: list[bytes], random: Random) -> bytes:
    """Another number for one that stands there as text."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", data[:20_000]))
    if not found:
        return _set(data, pool, random)
    one = random.choice(found)
    return data[: one.start()] + random.choice(_TEXTS) + data[one.end() :]


def _noise(data: bytes, pool: list[bytes], random: Random) -> bytes:
    return data[: random.choice((0, 4, 8, 16, 32))] + random.randbytes(random.choice((0, 1, 30, 500)))


_ANY = (_flip, _flip, _set, _number, _number, _number, _cut, _take_out, _put_in, _double, _zero, _splice, _digits)
_ANY += (_digits, _noise)


# --- documents ---------------------------------------------------------------------------------------------------


def _tree(data: bytes, random: Random) -> bytes:
    """Replace, remove, double or exchange values of a JSON document."""
    root = {"root": json.loads(data.decode("utf-8-sig"))}
    for _ in range(random.choice((1, 1, 2, 3))):
        paths = list(_paths(root))[1:]
        path = random.choice(paths)
        parent: Any = root
        for key in path[:-1]:
            parent = parent[key]
        action = random.random()
        if action < 0.55:
            parent[path[-1]] = copy.deepcopy(random.choice(_VALUES))
        elif action < 0.7 and path != ("root",):
            del parent[path[-1]]
        elif action < 0.8 and isinstance(parent, list):
            parent += [parent[path[-1]]] * random.choice((1, 500))
        elif action < 0.9:
            source: Any = root
            for key in random.choice(paths):
                source = source[key]
            parent[path[-1]] = copy.deepcopy(source)
        elif isinstance(parent[path[-1]], (int, float)) and not isinstance(parent[path[-1]], bool):
            parent[path[-1]] = parent[path[-1]] * random.choice((-1, 0.5, 2, 1e3, 1e6, 1e-6)) + random.choice((0, 1))
        elif isinstance(parent, dict):
            parent[random.choice(("", "x", path[-1] + "2", "version", "__class__"))] = parent.pop(path[-1])
    return json.dumps(root.get("root"), indent=random.choice((None, 1))).encode()


def _json_text(data: bytes, random: Random) -> bytes:
    """Change the text of a document as no writer would."""
    text = data.decode("utf-8-sig")
    keys = re.findall(r'"\w+":', text)
    deep = 10 ** random.randrange(2, 6)
    number = random.choice(("1e999", "NaN", "-Infinity", "9" * 5000, "0" * 50, "1.", "'x'", '"\\ud800"', "tru", "01"))
    choices = [
        lambda: text.replace("{", "{" + random.choice(keys or ['"x":']) + " 0, ", 1),
        lambda: re.sub(r"-?\d+(\.\d+)?", lambda _: number, text, count=random.choice((1, 1, 0))),
        lambda: "[" * deep + "]" * deep,
        lambda: text.replace(random.choice(keys or ["{"]), '"x": ' + '{"a":' * deep + "0" + "}" * deep + ', "y":', 1),
        lambda: text.encode("utf-16").decode("latin1"),
        lambda: text + text,
        lambda: "\ufeff" + text,
    ]
    return random.choice(choices)().encode("utf-8", "surrogatepass")


def _paths(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield path
    children = node.items() if isinstance(node, dict) else enumerate(node[:50]) if isinstance(node, list) else ()
    for key, child in children:
        yield from _paths(child, (*path, key))


def _is_json(data: bytes) -> bool:
    return data[:1] in (b"{", b"[") and len(data) < 300_000


def _table(data: bytes, random: Random) -> bytes:
    """Change lines and cells of a table, or of settings."""
    lines = data.split(b"\n")
    k = random.randrange(len(lines))
    separator = next((one for one in (b",", b"\t", b"=", b" ") if one in lines[k]), b",")
    cells = lines[k].split(separator)
    c = random.randrange(len(cells))
    action = random.randrange(8)
    if action < 3:
        cells[c] = random.choice(_TEXTS)
    elif action == 3:
        cells.insert(c, random.choice(_TEXTS))
    elif action == 4:
        del cells[c]
    elif action == 5:
        cells[c] = random.choice(random.choice(lines).split(separator))
    lines[k] = separator.join(cells)
    if action == 6:
        lines[k : k + 1] = [lines[k]] * random.choice((0, 2, 3, 2000))
    if action == 7:
        j = random.randrange(len(lines))
        lines[k], lines[j] = lines[j], lines[k]
    return random.choice((b"\n", b"\n", b"\n", b"\r\n", b"\r")).join(lines)


def _is_text(data: bytes) -> bool:
    return len(data) < 300_000 and not set(data[:2000]) - set(range(32, 127)) - {9, 10, 13}


# --- pictures, archives, databases -------------------------------------------------------------------------------


def _png(data: bytes, random: Random) -> bytes:
    """Change chunks and let their checksums fit."""
    chunks, place = [], 8
    while place + 12 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    k = random.randrange(len(chunks))
    kind, body = chunks[k]
    action = random.randrange(8)
    if action == 0:
        del chunks[k]
    elif action == 1:
        chunks.insert(random.randrange(len(chunks) + 1), (kind, body))
    elif action == 2:
        kinds = (
            b"PLTE",
            b"IDAT",
            b"tRNS",
            b"acTL",
            b"fcTL",
            b"eXIf",
            b"zTXt",
            b"iTXt",
            b"pHYs",
            b"iCCP",
            b"zzzz",
            b"IEND",
        )
        chunks[k] = random.choice(kinds), random.choice((body, zlib.compress(bytes(300_000)), b"key\0\0" + body))
    elif action == 3:
        k, body = next((k, body) for k, (kind, body) in enumerate(chunks) if kind == b"IDAT")
        lines = zlib.decompress(body)
        changed = random.choice(_ANY)(lines, [lines], random)
        chunks[k] = b"IDAT", zlib.compress(random.choice((changed, changed, lines + bytes(3_000_000))))
    elif action in (4, 5):
        head = list(struct.unpack(">IIBBBBB", chunks[0][1]))
        place = random.randrange(7)
        choices = [_EDGES[:17], _EDGES[:17], [1, 2, 4, 8, 16, 3], [0, 2, 3, 4, 6, 1], [0, 1], [0, 1], [0, 1, 2]][place]
        head[place] = random.choice(choices)
        chunks[0] = chunks[0][0], struct.pack(">IIBBBBB", *head)
    else:
        chunks[k] = kind, random.choice(_ANY)(body, [one for _, one in chunks], random)
    return PNG + b"".join(chunk(*one) for one in chunks)


def _tiff(data: bytes, random: Random) -> bytes:
    """Change an entry of the first directory."""
    order = "<" if data[:2] == b"II" else ">"
    (place,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, place)
    at = place + 2 + 12 * random.randrange(count)
    entry = list(struct.unpack_from(order + "HHII", data, at))
    k = random.randrange(4)
    tags = (256, 257, 258, 259, 262, 270, 273, 277, 278, 279, 282, 284, 296, 317, 322, 323, 324, 325, 338, 339, 330)
    choices = [tags, range(14), _EDGES, _EDGES][k]
    entry[k] = random.choice((random.choice(choices), entry[k] + 1, max(0, entry[k] - 1)))
    if random.random() < 0.3:  # as a tag's own value
        entry[3] = random.choice(_EDGES[:17])
    sizes = (0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF)
    packed = struct.pack(order + "HHII", *(value & size for value, size in zip(entry, sizes, strict=True)))
    return data[:at] + packed + data[at + 12 :]


def _zip(data: bytes, random: Random) -> bytes:
    """Write an archive anew with a member changed, missing, doubled, renamed, enormous or of a false size."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(one.filename, archive.read(one)) for one in archive.infolist()]
    k = random.randrange(len(members))
    name, body = members[k]
    action = random.randrange(9)
    if action < 3:
        members[k] = name, _npy(body, random)
    elif action == 3:
        members[k] = name, random.choice(_ANY)(body, [one for _, one in members], random)
    elif action == 4:
        del members[k]
    elif action == 5:
        members.append((random.choice(members)[0], body))
    elif action == 6:
        members[k] = random.choice(("../x.npy", "/x.npy", "", "x", name.upper(), "x" * 300, "é.npy")), body
    elif action == 7:
        members[k] = name, _header((LONGEST * 10,), "|u1") + bytes(LONGEST * 10)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", random.choice((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))) as archive:
        for name, body in members:
            bomb = len(body) > LONGEST
            archive.writestr(zipfile.ZipInfo(name), body, zipfile.ZIP_DEFLATED if bomb else None, 1)
    made = bytearray(stream.getvalue())
    if action == 8:  # sizes in the directory that are not those of the members
        places = [one.start() for one in re.finditer(b"PK\x01\x02", made)]
        place = random.choice(places) + random.choice((10, 16, 20, 24, 28, 42))
        made[place : place + 4] = random.choice(_EDGES[:17]).to_bytes(4, "little")
    return bytes(made)


def _header(shape: tuple[int, ...], kind: str, by_columns: bool = False) -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': {by_columns}, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _npy(data: bytes, random: Random) -> bytes:
    """Change the header of an array, or its values."""
    stream = io.BytesIO(data)
    np.lib.format.read_magic(stream)
    shape, by_columns, kind = np.lib.format.read_array_header_1_0(stream)
    place = stream.tell()
    action = random.randrange(6)
    body = data[place:]
    if action == 0:
        sides = list(shape) or [1]
        sides[random.randrange(len(sides))] = random.choice([*_EDGES, -1])
        shape = tuple(sides)
    elif action == 1:
        shape = random.choice(((), (0,), shape[::-1], (*shape, 1), shape[:-1], (1,) * 33, (2**40, 2**40), (0, 2**62)))
    elif action == 2:
        return (
            _header(shape, random.choice(("<f8", "<f4", "<f2", ">f4", "<c16", "|O", "<U9", "|V7", "<M8[s]", "<i8")))
            + body
        )
    elif action == 3:
        by_columns = not by_columns
    elif kind.kind in "fiub" and action == 4:
        values = np.frombuffer(body, kind).copy()
        wanted = random.choice((np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40, 0.0, 1.0, 255.0))
        with np.errstate(all="ignore"):
            part = slice(None) if random.random() < 0.4 else random.randrange(max(1, values.size))
            values[part] = np.asarray(wanted).astype(kind)
        body = values.tobytes()
    else:
        body = random.choice(_ANY)(body, [body], random)
    return _header(shape, kind.str, by_columns) + body


def _glb(data: bytes, random: Random) -> bytes:
    """Change the document within, and let the lengths fit."""
    length = int.from_bytes(data[12:16], "little")
    text = random.choice((_tree, _json_text))(data[20 : 20 + length], random)
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    return data[:8] + struct.pack("<II", 20 + len(text) + len(rest), len(text)) + b"JSON" + text + rest


def _sqlite(data: bytes, random: Random) -> bytes:
    """Change cells, rows, tables or the numbers in the header."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
        database.deserialize(data)
        tables = [row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        table = random.choice(tables)
        columns = [row[1] for row in database.execute(f"PRAGMA table_info({table})")]
        column = random.choice(columns)
        rows = [row[0] for row in database.execute(f"SELECT rowid FROM {table}")]
        row = random.choice(rows or [1])
        (old,) = database.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone() or (b"",)
        plain = old.encode() if isinstance(old, str) else old if isinstance(old, bytes) else b""
        changed: Any = change(plain, [plain], random)
        if isinstance(old, str):
            changed = changed.decode("utf-8", "replace")
        value = random.choice((changed, changed, changed, changed, None, 0, -(2**63), 1e308, b"", "x", bytes(300_000)))
        statements: list[tuple[str, tuple[Any, ...]]] = [
            (f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row)),
            (f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row)),
            (f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row)),
            (f"UPDATE {table} SET {column} = (SELECT {column} FROM {table} ORDER BY rowid DESC LIMIT 1)", ()),
            (f"DELETE FROM {table} WHERE rowid = ?", (row,)),
            (f"DELETE FROM {table}", ()),
            (f"DROP TABLE {table}", ()),
            (f"ALTER TABLE {table} RENAME COLUMN {column} TO other", ()),
            (f"CREATE TRIGGER t AFTER UPDATE ON {table} BEGIN DELETE FROM {table}; END", ()),
            (f"CREATE VIEW other AS SELECT * FROM {table}", ()),
            (f"INSERT INTO {table} SELECT * FROM {table} LIMIT 1", ()),
            (f"PRAGMA user_version={random.choice((0, 2, 2**31 - 1))}", ()),
            (f"PRAGMA application_id={random.choice((0, 1))}", ()),
            (f"UPDATE {table} SET rowid = {random.choice((-1, 0, 2**62))} WHERE rowid = ?", (row,)),
        ]
        with contextlib.suppress(sqlite3.Error):
            database.execute(*random.choice(statements))
        return database.serialize()


def _parquet(data: bytes, random: Random) -> bytes:
    """Write a table anew with a column of other values or of another type, missing, or with other metadata."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(io.BytesIO(data))
    k = random.randrange(table.num_columns)
    name = table.column_names[k]
    values = table.column(k).to_pylist()
    action = random.randrange(7)
    if action == 0:
        table = table.drop_columns([name])
    elif action == 1:
        other: Any = random.choice(([None], [1], [1.5], ["x"], [b"x"], [[1]], [{"a": 1}], [True]))
        table = table.set_column(k, name, pa.array(other * len(values)))
    elif action == 2:
        table = table.slice(0, random.choice((0, 1)))
    elif action == 3:
        facts = dict(table.schema.metadata or {})
        one = random.choice(sorted(facts)) if facts else b"splitknit"
        facts[one] = change(facts.get(one, b"{}"), [], random)
        table = table.replace_schema_metadata(facts)
    elif action == 4:
        table = pa.concat_tables([table, table])
    else:
        row = random.randrange(max(1, len(values)))
        old = values[row]
        if isinstance(old, bytes):
            values[row] = change(old, [one for one in values if isinstance(one, bytes)], random)
        elif isinstance(old, str):
            values[row] = random.choice(("", "x", "\0", "../x", "x" * 3000, old + "\n"))
        elif isinstance(old, (int, float)):
            values[row] = (
                random.choice((0, -1, 2**31 - 1, old))
                if isinstance(old, int)
                else random.choice((0.0, 1e308, float("nan")))
            )
        else:
            values[row] = None
        table = table.set_column(k, table.schema.field(k), pa.array(values, table.schema.field(k).type))
    stream = io.BytesIO()
    pq.write_table(table, stream, compression=random.choice(("zstd", "none", "snappy")), store_schema=True)
    return stream.getvalue()


_FORMATS: tuple[tuple[Callable[[bytes], bool], tuple[Callable[[bytes, Random], bytes], ...]], ...] = (
    (lambda data: data.startswith(PNG), (_png,)),
    (lambda data: data[:4] in (b"II*\0", b"MM\0*"), (_tiff,)),
    (lambda data: data.startswith(b"PK\x03\x04"), (_zip,)),
    (lambda data: data.startswith(b"\x93NUMPY"), (_npy,)),
    (lambda data: data.startswith(b"SQLite format 3\0"), (_sqlite,)),
    (lambda data: data.startswith(b"PAR1"), (_parquet,)),
    (lambda data: data.startswith(b"glTF"), (_glb,)),
    (_is_json, (_tree, _tree, _tree, _json_text)),
    (_is_text, (_table,)),
)
