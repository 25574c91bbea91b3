from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

from splitknit.check import BadInput
from splitknit.separate import weights
from splitknit.separate.unet import load_network
from splitknit.separate.weights import card_bytes, read_network, shipped_networks

TINY = Path(__file__).parent / "tiny.onnx"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for suffix in (".onnx", ".json"):
        shutil.copy(TINY.with_suffix(suffix), tmp_path / f"net{suffix}")
    return tmp_path / "net.onnx"


def test_a_network_is_read_with_its_card() -> None:
    card, data = read_network(TINY)
    assert (card.name, card.channels_in, card.channels_out, card.stride) == ("tiny", 3, 3, 8)
    assert len(data) == TINY.stat().st_size
    assert load_network(str(TINY)).card == card


def test_one_changed_byte_is_noticed(copy: Path) -> None:
    data = bytearray(copy.read_bytes())
    data[len(data) // 2] ^= 1
    copy.write_bytes(data)
    with pytest.raises(BadInput, match=r"damaged or not those of their card .* copy the network again"):
        load_network(copy)


def test_missing_files_are_named(copy: Path, tmp_path: Path) -> None:
    copy.with_suffix(".json").unlink()
    with pytest.raises(BadInput, match=r"the card '.*net\.json' cannot be read"):
        load_network(copy)
    with pytest.raises(BadInput, match=r"the weights '.*none\.onnx' cannot be read"):
        load_network(tmp_path / "none.onnx")


def test_files_are_checked_before_they_are_read(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights, "_MAX_BYTES", copy.stat().st_size - 1)
    with pytest.raises(BadInput, match=r"the weights '.*net\.onnx' cannot be read \(.* too large"):
        load_network(copy)
    copy.unlink()
    os.mkfifo(copy)
    with pytest.raises(BadInput, match=r"is not a file\); copy the network again"):
        load_network(copy)


def test_an_unknown_name_is_told_what_there_is() -> None:
    with pytest.raises(BadInput, match="there is no network 'dirct' in this installation"):
        load_network("dirct")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": "something"}, "is not the card of a network"),
        ({"stride": 0}, "gives stride as 0"),
        ({"reach": "far"}, "gives reach as 'far'"),
        ({"channels_in": True}, "gives channels_in as True"),
    ],
)
def test_a_card_that_makes_no_sense_is_refused(copy: Path, change: dict[str, object], words: str) -> None:
    file = copy.with_suffix(".json")
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(BadInput, match=words):
        load_network(copy)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"format": "splitknit-network", "version": 1}'])
def test_a_damaged_card_is_refused(copy: Path, text: str) -> None:
    copy.with_suffix(".json").write_text(text)
    with pytest.raises(BadInput, match="is damaged"):
        load_network(copy)


def test_what_is_no_network_is_refused(copy: Path) -> None:
    copy.write_bytes(b"no network at all")
    card = json.loads(copy.with_suffix(".json").read_text())
    facts = {name: card[name] for name in ("channels_in", "channels_out", "stride", "reach")}
    copy.with_suffix(".json").write_bytes(card_bytes("net", copy.read_bytes(), facts))
    with pytest.raises(BadInput, match="are not a network from one image to one image"):
        load_network(copy)


def test_every_shipped_network_is_whole_and_small() -> None:
    names = shipped_networks()
    assert "direct" in names
    for name in names:
        card, data = read_network(name)
        assert card.name == name
        assert len(data) < 4e6
        for wanted in ("data", "training", "metrics", "licence", "command"):
            assert card.facts[wanted], f"the card of {name} says nothing about its {wanted}"
