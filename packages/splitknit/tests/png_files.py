"""PNG files by hand: of any kind that the standard knows, with sound checksums whatever they
hold."""

from __future__ import annotations

import struct
import zlib
from random import Random

PNG = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, body: bytes) -> bytes:
    """One chunk of a PNG, its checksum sound."""
    return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")


def png_of(  # noqa: PLR0917
    rows: int, columns: int, depth: int, colour: int, interlaced: bool, random: Random
) -> bytes:
    """A PNG of noise, written by hand: of any kind that the standard knows."""
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour]
    steps = (
        (
            (0, 0, 8, 8),
            (0, 4, 8, 8),
            (4, 0, 8, 4),
            (0, 2, 4, 4),
            (2, 0, 4, 2),
            (0, 1, 2, 2),
            (1, 0, 2, 1),
        )
        if interlaced
        else ((0, 0, 1, 1),)
    )
    lines = b""
    for r, c, dr, dc in steps:
        height, width = len(range(r, rows, dr)), len(range(c, columns, dc))
        size = (width * samples * depth + 7) // 8
        lines += b"".join(
            bytes([random.randrange(5)]) + random.randbytes(size)
            for _ in range(height if width else 0)
        )
    head = struct.pack(">IIBBBBB", columns, rows, depth, colour, 0, 0, int(interlaced))
    palette = chunk(b"PLTE", random.randbytes(768)) if colour == 3 else b""
    return (
        PNG
        + chunk(b"IHDR", head)
        + palette
        + chunk(b"IDAT", zlib.compress(lines))
        + chunk(b"IEND", b"")
    )
