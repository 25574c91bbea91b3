"""Networks as files: ``NAME.onnx`` with the weights, and ``NAME.json``, its card, which describes them.

The card states what goes in and out, where the weights come from (data, seed, metrics, licence, the command that makes
them again), and their SHA-256, which is checked whenever they are read.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from splitknit.errors import BadInput, read_bytes, refusing, require

FORMAT = "splitknit-network"
_MAX_BYTES, _MAX_CARD_BYTES = 500_000_000, 1_000_000
"""The shipped networks have less than 1 MB, their cards 3 kB."""
REINSTALL = "reinstall splitknit, or name another network"


@dataclass(frozen=True, slots=True)
class Card:
    """What is known of a network; :attr:`facts` holds the whole document."""

    name: str
    sha256: str
    """Of the ``.onnx`` file, hexadecimal."""
    channels_in: int
    channels_out: int
    stride: int
    """Both sides of an image must be multiples of this; :func:`splitknit.networks.unet.run_network` sees to it."""
    reach: int
    """A pixel further than this from a tile that begins on the stride's grid does not change the tile's result."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Data, training, metrics, licence, command."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("channels_in", 1, 4096),
            ("channels_out", 1, 4096),
            ("stride", 1, 256),
            ("reach", 0, 4096),
        ):
            value = getattr(self, name)
            require(
                isinstance(value, int) and not isinstance(value, bool) and low <= value <= high,
                f"the card of network '{self.name}' gives {name} as {value!r}; "
                f"it must be a whole number from {low} to {high}.",
            )


def _shipped_names() -> list[str]:
    """Names of the networks in the package."""
    folder = _shipped()
    if not folder.is_dir():
        return []
    names = [entry.name for entry in folder.iterdir()]
    return sorted(name[: -len(".onnx")] for name in names if name.endswith(".onnx"))


def read_network(name: str | os.PathLike[str]) -> tuple[Card, bytes]:
    """Read a network's card and weights, and check that they belong together.

    `name`: of a network in the package, or path of an ``.onnx`` file with its card, a ``.json``, beside it. Returns the
    card and the bytes of the ONNX file. Raises BadInput if one is missing or damaged, or they do not belong together.
    """
    weights_file, card_file, remedy = _files(name)
    weights = _read(weights_file, f"the weights '{weights_file}'", remedy)
    card = _parse(_read(card_file, f"the card '{card_file}'", remedy), card_file, remedy)
    found = hashlib.sha256(weights).hexdigest()
    require(
        found == card.sha256,
        f"the weights '{weights_file}' are damaged or not those of their card "
        f"(SHA-256 {found[:12]}... instead of {card.sha256[:12]}...); {remedy}.",
    )
    return card, weights


def card_bytes(name: str, weights: bytes, facts: Mapping[str, Any]) -> bytes:
    """Return the card of `weights` as it is stored: `facts` under a head with name, format and hash.

    `facts` must hold ``channels_in``, ``channels_out``, ``stride`` and ``reach``.
    """
    head = {"format": FORMAT, "version": 1, "name": name, "sha256": hashlib.sha256(weights).hexdigest()}
    data = (json.dumps({**head, **facts}, indent=1, allow_nan=False) + "\n").encode()
    _parse(data, Path(f"{name}.json"), "correct the facts")
    return data


def _shipped() -> Traversable:
    return resources.files("splitknit.networks") / "shipped"


def _files(name: str | os.PathLike[str]) -> tuple[Traversable, Traversable, str]:
    """Weights, card, and what to do if they are no good."""
    text = os.fspath(name)
    if text.endswith(".onnx"):
        path = Path(text).expanduser()
        return path, path.with_suffix(".json"), "copy the network again or train it again (splitknit train)"
    known = _shipped_names()
    require(
        text in known,
        f"there is no network '{text}' in this installation; "
        f"name one of {', '.join(known) or '(none)'}, or the path of an .onnx file.",
    )
    return _shipped() / f"{text}.onnx", _shipped() / f"{text}.json", REINSTALL


def _read(file: Traversable, words: str, remedy: str) -> bytes:
    try:
        return read_bytes(file, _MAX_BYTES) if isinstance(file, Path) else file.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error).rstrip(".")
        raise BadInput(f"{words} cannot be read ({reason}); {remedy}.") from error


def _parse(data: bytes, file: Traversable, remedy: str) -> Card:
    with refusing(f"the card '{file}' is damaged; {remedy}."):
        require(len(data) <= _MAX_CARD_BYTES, f"the card '{file}' has {len(data)} bytes, too many; {remedy}.")
        document = json.loads(data)
        require(
            document["format"] == FORMAT and document["version"] == 1,
            f"'{file}' is not the card of a network (format {FORMAT}, version 1); {remedy}.",
        )
        return Card(
            name=str(document["name"]),
            sha256=str(document["sha256"]),
            channels_in=document["channels_in"],
            channels_out=document["channels_out"],
            stride=document["stride"],
            reach=document["reach"],
            facts=document,
        )
