"""Changes to sound files, as strategies: of any bytes, and of formats whose checksums or structure
such changes spoil.

A file is its bytes, or a word for another thing: ``folder``, ``pipe``, ``loop`` (a link to itself),
``huge`` (3 GB of nothing). Nothing leads out of the folder: some readers may also write, and the
fuzzer may be root.
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
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from hypothesis.errors import HypothesisException, InvalidArgument

from png_files import PNG, chunk

File = bytes | str
Files = dict[str, File]
Draw = Callable[[st.SearchStrategy[Any]], Any]
SPECIAL = ("folder", "pipe", "loop", "huge")
LONGEST = 4_000_000
"""Of a mutated file: what is refused for its size alone shows nothing else."""
SMALL_EDGES = (
    0,
    1,
    2,
    3,
    127,
    128,
    255,
    256,
    4095,
    32767,
    32768,
    65535,
    65536,
    10**6,
    2**31 - 1,
    2**31,
    2**32 - 1,
)
EDGES = (*SMALL_EDGES, 2**32, 2**53, 2**63 - 1, 2**63, 2**64 - 1)
TEXTS = [
    b"0",
    b"-1",
    b"1",
    b"65536",
    b"2147483648",
    b"99999999999999999999",
    b"1e999",
    b"-1e308",
    b"1e-320",
    b"nan",
]
TEXTS += [
    b"inf",
    b"NaN",
    b"",
    b" ",
    b"9" * 5000,
    b"\xff",
    b"\xef\xbb\xbf",
    b"\0",
    b"\n",
    b'"',
    b",",
    b"\xed\xa0\x80",
]
TEXTS += [
    "٣".encode(),
    "é".encode(),
    b"../../x",
    b"/nowhere/x",
    b"%s%n",
    b"__class__",
    b"0x10",
    b"1_000",
]
VALUES: list[Any] = [
    None,
    True,
    2**63,
    10**400,
    -(10**400),
    1e308,
    -1e308,
    5e-324,
    float("nan"),
    float("inf"),
]
VALUES += [
    "x" * 5000,
    "",
    " ",
    "a\nb",
    "\ud800",
    "\0",
    "..",
    "/",
    "../../x",
    "/nowhere/x",
    "C:\\x",
    "~",
    "srgb",
    "linear",
    "nir",
]
VALUES += [
    "white",
    "nan",
    "\u202e",
    [0] * 300,
    {"": 0},
    [1e308, 1e308, 1e308],
    [0, 0, 0],
    [[0, 0], [0, 0]],
]
json_values = st.sampled_from(VALUES) | st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=4,
)
rarely = st.integers(0, 11).map(lambda number: number == 7)
texts = st.sampled_from(TEXTS) | st.binary(max_size=40)


@st.composite
def inputs(draw, samples, repair):
    """One of the sound samples with one to four changes; checksums fit again in half of the
    cases."""
    result = dict(draw(st.sampled_from(samples)))
    for _ in range(draw(st.sampled_from((1, 1, 1, 1, 2, 3, 4)))):
        names = sorted(
            (name for name, file in result.items() if isinstance(file, bytes)),
            key=lambda n: len(result[n]),
        )
        if not names:
            break
        # small files are documents, which decide more than pixels do
        name = draw(st.sampled_from(names) | st.sampled_from(names[:3]))
        if draw(rarely) and (len(result) > 1 or draw(rarely)):
            content = draw(st.sampled_from((None, *SPECIAL, result[names[0]], result[names[-1]])))
            result[name] = content
            if content is None:
                del result[name]
        else:
            pool = [sample[name] for sample in samples if isinstance(sample.get(name), bytes)]
            result[name] = changed(draw, result[name], pool)[:LONGEST]  # type: ignore[arg-type]
    result = repair(result) if repair is not None and draw(st.booleans()) else result
    assume(result not in samples)
    return result


def changed(draw, data, pool):
    """Changed bytes of one file; by its format in two of three cases, where that is known."""
    if draw(st.sampled_from((True, True, False))):
        for is_one, change in FORMATS:
            if is_one(data):
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        return change(draw, data)
                except InvalidArgument:  # there is nothing to choose from
                    break
                except HypothesisException:
                    raise
                # what was changed before may be no such file any more: then any bytes are changed
                except Exception:
                    break
    return any_bytes(draw, data, pool)


ACTIONS = (
    "flip",
    "set",
    "number",
    "number",
    "number",
    "text",
    "digits",
    "digits",
    "cut",
    "out",
    "in",
    "double",
    "zero",
)
ACTIONS += ("splice",)


def any_bytes(draw, data, pool=None):
    """Other bytes in place of some: fewer, more, doubled, one bit flipped, a number, a text, or
    another file's end."""
    reach = draw(st.sampled_from((len(data), len(data), 64, 300)))  # headers are at the beginning
    at = draw(st.integers(0, max(0, min(reach, len(data)) - 1)))
    at = max(0, len(data) - 1 - at) if draw(rarely) else at  # directories at the end
    part = data[at : at + draw(st.sampled_from((1, 2, 4, 16, 50, 200, 1000)))]
    size, order = draw(st.sampled_from((2, 4, 4, 8))), draw(st.sampled_from(("little", "big")))
    number = st.builds(
        lambda edge, more: (edge + more) % (1 << 8 * size),
        st.sampled_from(EDGES),
        st.integers(-1, 1),
    )
    action = draw(st.sampled_from(ACTIONS))
    if action == "flip":
        return (
            data[:at]
            + bytes(byte ^ (1 << draw(st.integers(0, 7))) for byte in part[:1])
            + data[at + 1 :]
        )
    if action == "set":
        return data[:at] + draw(st.binary(min_size=1, max_size=3)) + data[at + 1 :]
    if action == "number":
        at -= at % draw(st.sampled_from((1, size)))
        number_bytes = draw(number).to_bytes(size, order)  # type: ignore[arg-type]
        return data[:at] + number_bytes + data[at + size :]
    if action in ("text", "digits"):  # another number for one that stands there as text
        numbers = list(re.finditer(rb"-?\d+(\.\d+)?", data[:20_000])) if action == "digits" else []
        first, last = draw(st.sampled_from(numbers)).span() if numbers else (at, at + len(part))
        return data[:first] + draw(texts) + data[last:]
    if action == "splice":
        return (
            data[:at]
            + draw(st.sampled_from([*(pool or ()), data]))[draw(st.integers(0, len(data))) :]
        )
    put = {
        "cut": b"",
        "out": b"",
        "in": draw(texts) + part,
        "double": part * draw(st.sampled_from((2, 2, 50))),
    }
    put["zero"] = draw(st.sampled_from((b"\0", b"\xff"))) * len(part)
    return data[:at] + put[action] + (b"" if action == "cut" else data[at + len(part) :])


# --- documents
# ------------------------------------------------------------------------------------------------


def _paths(node, path=()):
    yield path
    children = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node[:50])
        if isinstance(node, list)
        else ()
    )
    for key, child in children:
        yield from _paths(child, (*path, key))


def _at(root, path):
    for key in path:
        root = root[key]
    return root


def _json(draw, data):
    """Replace, remove, double, scale or rename a value of a JSON document, or write it as no writer
    would."""
    if draw(st.integers(0, 3)) == 0:
        return _json_text(draw, data.decode("utf-8-sig"))
    root = {"root": json.loads(data.decode("utf-8-sig"))}
    for _ in range(draw(st.sampled_from((1, 1, 2, 3)))):
        # the root, of which least is left, last: what is first is drawn most
        paths = list(_paths(root))[:0:-1]
        *above, key = draw(st.sampled_from(paths))
        parent = _at(root, tuple(above))
        old = parent[key]
        action = draw(
            st.sampled_from(
                ("scale", "scale", "value", "value", "remove", "double", "other", "rename")
            )
        )
        if action == "remove" and above:
            del parent[key]
        elif action == "double" and isinstance(parent, list):
            parent += [old] * draw(st.sampled_from((1, 500)))
        elif action == "other":
            parent[key] = copy.deepcopy(_at(root, draw(st.sampled_from(paths))))
        elif action == "scale" and isinstance(old, (int, float)) and not isinstance(old, bool):
            parent[key] = old * draw(st.sampled_from((-1, 0.5, 2, 1e3, 1e6, 1e-6))) + draw(
                st.integers(0, 1)
            )
        elif action == "rename" and isinstance(parent, dict):
            parent[draw(st.sampled_from(("", "x", f"{key}2", "version", "__class__")))] = (
                parent.pop(key)
            )
        else:
            # of those listed, another change must change none
            parent[key] = copy.deepcopy(draw(json_values))
    return json.dumps(root.get("root"), indent=draw(st.sampled_from((None, 1)))).encode()


def _json_text(draw, text):
    key = draw(st.sampled_from(re.findall(r'"\w+":', text) or ['"x":']))
    deep = draw(st.sampled_from([100, 600, 1000, 10_000, 100_000]))
    words = (
        "1e999",
        "NaN",
        "-Infinity",
        "9" * 5000,
        "0" * 50,
        "1.",
        "'x'",
        '"\\ud800"',
        "tru",
        "01",
    )
    number, count = draw(st.sampled_from(words)), draw(st.sampled_from((1, 1, 0)))
    document = draw(
        st.sampled_from(
            (
                text.replace("{", "{" + key + " 0, ", 1),
                re.sub(r"-?\d+(\.\d+)?", lambda _: number, text, count=count),
                "[" * deep + "]" * deep,
                text.replace(key, '"x": ' + '{"a":' * deep + "0" + "}" * deep + ', "y":', 1),
                text + text,
                "\ufeff" + text,
                text.encode("utf-16").decode("latin1"),
            )
        )
    )
    return document.encode("utf-8", "surrogatepass")


def _table(draw, data):
    """Change lines and cells of a table, or of settings."""
    lines = data.split(b"\n")
    k, j = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
    separator = next((mark for mark in (b",", b"\t", b"=", b" ") if mark in lines[k]), b",")
    cells = lines[k].split(separator)
    c = draw(st.integers(0, len(cells) - 1))
    action = draw(st.integers(0, 7))
    if action > 1:
        new = draw(texts | st.sampled_from(lines[j].split(separator)))
        cells[c : c + (action != 2)] = [] if action == 3 else [new]
        lines[k] = separator.join(cells)
    elif action == 0:
        lines[k : k + 1] = [lines[k]] * draw(st.sampled_from((0, 2, 3, 2000)))
    else:
        lines[k], lines[j] = lines[j], lines[k]
    return draw(st.sampled_from((b"\n", b"\n", b"\n", b"\r\n", b"\r"))).join(lines)


# --- pictures, archives, databases
# -------------------------------------------------------------------------------


PNG_KINDS = (
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
TIFF_TAGS = (
    256,
    257,
    258,
    259,
    262,
    270,
    273,
    277,
    278,
    279,
    282,
    284,
    296,
    317,
    322,
    323,
    324,
    325,
    338,
    339,
    330,
)


def _png(draw, data):
    """Change chunks and let their checksums fit."""
    chunks, place = [], 8
    while place + 12 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + length]))
        place += 12 + length
    k = draw(st.integers(0, len(chunks) - 1))
    kind, body = chunks[k]
    action = draw(st.integers(0, 6))
    if action == 0:
        chunks[k : k + 1] = draw(st.sampled_from(([], [chunks[k]] * 2, [chunks[k], chunks[0]])))
    elif action == 1:
        bodies = body, zlib.compress(bytes(300_000)), b"key\0\0" + body
        chunks[k] = draw(st.sampled_from(PNG_KINDS)), draw(st.sampled_from(bodies))
    elif action == 2:
        k, lines = next(
            (k, zlib.decompress(body)) for k, (kind, body) in enumerate(chunks) if kind == b"IDAT"
        )
        lines = lines + bytes(3_000_000) if draw(rarely) else any_bytes(draw, lines)
        chunks[k] = b"IDAT", zlib.compress(lines)
    elif action in (3, 4):
        head = list(struct.unpack(">IIBBBBB", chunks[0][1]))
        place = draw(st.integers(0, 6))
        choices = (
            SMALL_EDGES,
            SMALL_EDGES,
            (1, 2, 4, 8, 16, 3),
            (0, 2, 3, 4, 6, 1),
            (0, 1),
            (0, 1),
            (0, 1, 2),
        )[place]
        head[place] = draw(st.sampled_from(choices))
        chunks[0] = chunks[0][0], struct.pack(">IIBBBBB", *head)
    else:
        chunks[k] = kind, any_bytes(draw, body, [data for _, data in chunks])
    return PNG + b"".join(chunk(*part) for part in chunks)


def _tiff(draw, data):
    """Change an entry of the first directory."""
    order = "<" if data[:2] == b"II" else ">"
    (place,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, place)
    at = place + 2 + 12 * draw(st.integers(0, count - 1))
    entry = list(struct.unpack_from(order + "HHII", data, at))
    k = draw(st.integers(0, 3))
    special = st.sampled_from((TIFF_TAGS, range(14), SMALL_EDGES, SMALL_EDGES)[k])
    entry[k] = draw(special | st.sampled_from((entry[k] + 1, entry[k] - 1))) % (
        1 << (16, 16, 32, 32)[k]
    )
    return data[:at] + struct.pack(order + "HHII", *entry) + data[at + 12 :]


def _zip(draw, data):
    """Write an archive anew with a member changed, missing, doubled, renamed, enormous or of a
    false size."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = [(member.filename, archive.read(member)) for member in archive.infolist()]
    k = draw(st.integers(0, len(members) - 1))
    name, body = members[k]
    names = ("../x.npy", "/x.npy", "", "x", name.upper(), "x" * 300, "é.npy")
    action = draw(
        st.sampled_from(("npy", "npy", "npy", "bytes", "without", "double", "name", "bomb", "size"))
    )
    if action == "npy":
        members[k] = name, _npy(draw, body)
    elif action == "bytes":
        members[k] = name, any_bytes(draw, body, [data for _, data in members])
    elif action == "without":
        del members[k]
    elif action == "double":
        members.append((draw(st.sampled_from(members))[0], body))
    elif action == "name":
        members[k] = draw(st.sampled_from(names)), body
    elif action == "bomb":
        members[k] = name, _header((LONGEST * 10,), "|u1") + bytes(LONGEST * 10)
    stream = io.BytesIO()
    with zipfile.ZipFile(
        stream, "w", draw(st.sampled_from((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED)))
    ) as archive:
        for name, body in members:
            archive.writestr(
                zipfile.ZipInfo(name),
                body,
                zipfile.ZIP_DEFLATED if len(body) > LONGEST else None,
                1,
            )
    archived = bytearray(stream.getvalue())
    if action == "size":  # in the directory, not that of the member
        place = draw(
            st.sampled_from([entry.start() for entry in re.finditer(b"PK\x01\x02", archived)])
        )
        place += draw(st.sampled_from((10, 16, 20, 24, 28, 42)))
        archived[place : place + 4] = draw(st.sampled_from(SMALL_EDGES)).to_bytes(4, "little")
    return bytes(archived)


def _header(shape, kind, by_columns=False):
    text = f"{{'descr': '{kind}', 'fortran_order': {by_columns}, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _npy(draw, data):
    """Change the header of an array, or its values."""
    stream = io.BytesIO(data)
    np.lib.format.read_magic(stream)
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(stream)
    body, kind = data[stream.tell() :], dtype.str
    sides = tuple(
        draw(st.sampled_from((*EDGES, -1))) if draw(st.booleans()) else side
        for side in shape or (1,)
    )
    shapes = (
        (),
        (0,),
        shape[::-1],
        (*shape, 1),
        shape[:-1],
        (1,) * 33,
        (2**40, 2**40),
        (0, 2**62),
        sides,
    )
    kinds = ("<f8", "<f4", "<f2", ">f4", "<c16", "|O", "<U9", "|V7", "<M8[s]", "<i8")
    action = draw(st.sampled_from(("shape", "shape", "kind", "order", "values", "bytes")))
    if action == "shape":
        shape = draw(st.sampled_from(shapes))
    elif action == "kind":
        kind = draw(st.sampled_from(kinds))
    elif action == "order":
        by_columns = not by_columns
    elif dtype.kind in "fiub" and action == "values":
        values = np.frombuffer(body, dtype).copy()
        wanted = draw(
            st.sampled_from((np.nan, np.inf, -np.inf, 1e30, -1e30, 1e-40, 0.0, 1.0, 255.0))
        )
        with np.errstate(all="ignore"):
            part = (
                slice(None)
                if draw(st.booleans())
                else draw(st.integers(0, max(0, values.size - 1)))
            )
            values[part] = np.asarray(wanted).astype(dtype)
        body = values.tobytes()
    else:
        body = any_bytes(draw, body)
    return _header(shape, kind, by_columns) + body


def _sqlite(draw, data):
    """Change cells, rows, tables or the numbers in the header."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as database:
        database.deserialize(data)
        tables = [
            row[0]
            for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        ]
        table = draw(st.sampled_from(tables))
        column = draw(
            st.sampled_from([row[1] for row in database.execute(f"PRAGMA table_info({table})")])
        )
        row = draw(
            st.sampled_from(
                [row[0] for row in database.execute(f"SELECT rowid FROM {table}")] or [1]
            )
        )
        (old,) = database.execute(
            f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)
        ).fetchone() or (b"",)
        plain = old.encode() if isinstance(old, str) else old if isinstance(old, bytes) else b""
        value: Any = changed(draw, plain, [plain])
        value = value.decode("utf-8", "replace") if isinstance(old, str) else value
        value = draw(
            st.sampled_from(
                (value, value, value, value, None, 0, -(2**63), 1e308, b"", "x", bytes(300_000))
            )
        )
        update = (f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row))
        new_row = draw(st.sampled_from((-1, 0, 2**62)))
        others = (
            f"UPDATE {table} SET {column} = "
            f"(SELECT {column} FROM {table} ORDER BY rowid DESC LIMIT 1)",
            f"DELETE FROM {table} WHERE rowid = {row}",
            f"DELETE FROM {table}",
            f"DROP TABLE {table}",
            f"ALTER TABLE {table} RENAME COLUMN {column} TO other",
            f"CREATE TRIGGER t AFTER UPDATE ON {table} BEGIN DELETE FROM {table}; END",
            f"CREATE VIEW other AS SELECT * FROM {table}",
            f"INSERT INTO {table} SELECT * FROM {table} LIMIT 1",
            "PRAGMA user_version=0",
            "PRAGMA user_version=2147483647",
            "PRAGMA application_id=1",
            f"UPDATE {table} SET rowid = {new_row} WHERE rowid = {row}",
        )
        with contextlib.suppress(sqlite3.Error):
            database.execute(
                *draw(st.sampled_from((update, update, *((statement, ()) for statement in others))))
            )
        return database.serialize()


FORMATS: tuple[tuple[Callable[[bytes], bool], Callable[[Draw, bytes], bytes]], ...] = (
    (lambda data: data.startswith(PNG), _png),
    (lambda data: data[:4] in (b"II*\0", b"MM\0*"), _tiff),
    (lambda data: data.startswith(b"PK\x03\x04"), _zip),
    (lambda data: data.startswith(b"\x93NUMPY"), _npy),
    (lambda data: data.startswith(b"SQLite format 3\0"), _sqlite),
    (lambda data: data[:1] in (b"{", b"[") and len(data) < 300_000, _json),
    (
        lambda data: (
            len(data) < 300_000 and not set(data[:2000]) - set(range(32, 127)) - {9, 10, 13}
        ),
        _table,
    ),
)
