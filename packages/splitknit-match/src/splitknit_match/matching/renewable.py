"""Renewable codes: the code of a finger under a key, as short bits and as small integers.

A code of :mod:`splitknit_match.matching.code` is a direction. Here it is turned by an orthogonal matrix that only the
key determines, which keeps every angle between codes under one key. Under another key the same code gives another file,
so that one that was stolen cannot be compared with the new one, without a new capture. Who knows the codes of about
five fingers, and how codes are distributed, can estimate the matrix. What a search compares first is the signs of the
turned numbers, and of two more turns: `BITS` bits whose Hamming distance follows the angle.

References
----------
ISO/IEC 24745:2022 (renewable biometric references); Goemans and Williamson 1995, Improved approximation algorithms for
maximum cut (signs of projections keep angles); Charikar 2002, Similarity estimation techniques from rounding
algorithms; Choromanski et al. 2017, The unreasonable effectiveness of structured random orthogonal embeddings (products
of Hadamard matrices and random signs); Paley 1933, On orthogonal matrices.
"""

from __future__ import annotations

import hashlib
import hmac

import numpy as np
from numpy.typing import NDArray

from splitknit import FloatArray
from splitknit_match.matching.code import SCALE, code_size, in_steps

BITS = 512
"""Bits of the short code: at 139 million comparisons a second and core, ten million take 72 ms for each variant."""
_TURNS, _ROUNDS = 3, 3
_BLOCK = 8192
"""Codes that are turned at a time."""


class RenewableCode:
    """The transform of one key.

    Everything is integer arithmetic until the numbers are scaled at last, so that a key gives the same bytes whatever
    the machine and its threads.
    """

    def __init__(self, secret: bytes) -> None:
        """Derive the transform from 32 secret bytes (any length is taken; the same bytes give the same transform)."""
        size = code_size()
        stream = hashlib.shake_256(b"splitknit renewable code 1\0" + secret).digest(8 * _TURNS * _ROUNDS * size)
        chance = np.frombuffer(stream, dtype="<u8").reshape(_TURNS, _ROUNDS, size)
        hadamard = _paley_hadamard(size)
        turns = []
        for rounds in chance:
            turn = np.eye(size)
            for numbers in rounds:
                signs = np.where(numbers & np.uint64(1), 1.0, -1.0)
                turn = hadamard @ (signs[:, None] * turn[np.argsort(numbers, kind="stable")])
            turns.append(turn)
        self._matrix: NDArray[np.float64] = np.concatenate(turns)[:BITS]
        self._length = float(size) ** (_ROUNDS / 2)
        self.check = hmac.digest(secret, b"splitknit renewable code, check", "sha256")[:16]
        """By which codes under the same key are recognised; reveals nothing of it."""

    def stored(self, codes: NDArray[np.int8]) -> tuple[NDArray[np.uint8], NDArray[np.int8]]:
        """Codes (N, K) int8 of :func:`splitknit_match.matching.code.code_of` as a gallery keeps them.

        Returns packed bits (N, BITS / 8) uint8, and the turned codes (N, K) int8, whose products are those of `codes`
        but for rounding.

        >>> code = np.arange(-96, 96, dtype=np.int8)[None]
        >>> bits, fine = RenewableCode(b"a secret").stored(code)
        >>> bits.shape, fine.shape
        ((1, 64), (1, 192))
        >>> same, _ = RenewableCode(b"a secret").stored(code)
        >>> other, _ = RenewableCode(b"another").stored(code)
        >>> int(np.bitwise_count(bits ^ same).sum()), bool(np.bitwise_count(bits ^ other).sum() > 200)
        (0, True)
        """
        bits = np.empty((len(codes), BITS // 8), dtype=np.uint8)
        fine = np.empty((len(codes), code_size()), dtype=np.int8)
        for start in range(0, len(codes), _BLOCK):
            turned = codes[start : start + _BLOCK].astype(np.float64) @ self._matrix.T  # sums of integers: exact
            bits[start : start + _BLOCK] = np.packbits(turned > 0, axis=1)
            turned = turned[:, : code_size()]
            # to one length: what rounding had left of it would be the same under every key
            length = np.sqrt(np.maximum(np.sum(turned * turned, axis=1, keepdims=True), 1.0))
            fine[start : start + _BLOCK] = np.clip(np.rint(SCALE * turned / length), -127, 127)
        return bits, fine

    def probe(self, variants: FloatArray) -> tuple[NDArray[np.uint8], FloatArray]:
        """Bits (V, BITS / 8) and turned variants (V, K) of :func:`splitknit_match.matching.code.probe_codes`."""
        turned = variants.astype(np.float64) @ self._matrix.T  # sums of integers times 2 ** -23: exact
        return np.packbits(turned > 0, axis=1), in_steps(turned[:, : code_size()] / self._length)


def _paley_hadamard(size: int) -> NDArray[np.float64]:
    """Hadamard matrix of an order that is a prime of the form 4 n + 3, plus one (Paley's first construction)."""
    prime = size - 1
    residue = np.full(prime, -1.0)
    residue[np.arange(1, prime) ** 2 % prime] = 1.0
    residue[0] = 0.0
    number = np.arange(prime)
    matrix = np.ones((size, size))
    matrix[1:, 0] = -1.0
    matrix[1:, 1:] = residue[(number[:, None] - number[None, :]) % prime]
    matrix[1:, 1:] += np.eye(prime)
    return matrix
