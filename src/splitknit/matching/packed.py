"""What the bytes of minutiae and codes have in common: a head with magic, version, sizes, checksum, then the body."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class Packing:
    """How one kind of things is packed."""

    name: str
    """What they are, for people."""
    magic: bytes
    """The first four bytes."""
    version: int
    """A reader refuses others."""
    sizes: str
    """Format of the sizes in the head, little-endian, as of :mod:`struct`."""
    remedy: str
    """What to do about bytes that cannot be read."""
    plural: bool = True
    """Whether the name is one of many things."""

    @property
    def head(self) -> struct.Struct:
        """Magic, version (uint16), sizes, CRC-32 of the body (uint32)."""
        return struct.Struct(f"<4sH{self.sizes}I")

    def pack(self, sizes: tuple[int, ...], body: bytes) -> bytes:
        """Head and body."""
        return self.head.pack(self.magic, self.version, *sizes, zlib.crc32(body)) + body

    def unpack(self, data: bytes, body_size: Callable[..., int]) -> tuple[tuple[Any, ...], bytes]:
        """Sizes and body of what :meth:`pack` made; `body_size` tells the body's length by the sizes, 0 if impossible.

        Raises
        ------
        BadInput
            If the bytes are damaged, of another version, or something else.
        """
        head, name = self.head, self.name
        are, their = ("are", "their") if self.plural else ("is", "its")
        require(
            len(data) > head.size and data[:4] == self.magic,
            f"these {len(data)} bytes are no packed {name} (they begin with '{self.magic.decode('ascii')}'); "
            f"{self.remedy}",
        )
        _, version, *sizes, sum_ = head.unpack_from(data)
        require(
            version == self.version,
            f"the {name} {are} of version {version}, but this program reads version {self.version}; {self.remedy}",
        )
        body = data[head.size :]
        size = body_size(*sizes)
        require(
            size > 0 and len(body) == size and zlib.crc32(body) == sum_,
            f"the packed {name} {are} damaged ({their} length or checksum does not fit); {self.remedy}",
        )
        return tuple(sizes), body
