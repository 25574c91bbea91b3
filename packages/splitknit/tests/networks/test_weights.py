import hashlib
import json
import os
import shutil
from pathlib import Path

import pytest

from refusals import bad_input
from splitknit.networks import unet
from splitknit.networks.unet import FORMAT, load_network, read_network

TINY = Path(__file__).parent / "tiny.onnx"


@pytest.fixture
def copy(tmp_path):
    for suffix in (".onnx", ".json"):
        shutil.copy(TINY.with_suffix(suffix), tmp_path / f"net{suffix}")
    return tmp_path / "net.onnx"


def write_card(weights, **sizes):
    digest = hashlib.sha256(weights.read_bytes()).hexdigest()
    card = {"format": FORMAT, "version": 1, "name": "net", "sha256": digest, **sizes}
    weights.with_suffix(".json").write_text(json.dumps(card))


def test_a_network_is_read_with_its_card():
    card, data = read_network(TINY)
    assert (card.name, card.channels_in, card.channels_out, card.stride) == ("tiny", 3, 3, 8)
    assert len(data) == TINY.stat().st_size
    assert load_network(str(TINY)).card == card


def test_weights_with_a_changed_byte_are_refused(copy):
    data = bytearray(copy.read_bytes())
    data[len(data) // 2] ^= 1
    copy.write_bytes(data)
    with bad_input(r"damaged or not those of their card .* copy the network again"):
        load_network(copy)


def message(*fields):
    """A message of Protocol Buffers, of numbers and parts below 2^14."""
    encoded = b""
    for number, value in fields:
        body = (
            value.encode() if isinstance(value, str) else b"" if isinstance(value, int) else value
        )
        count = value if isinstance(value, int) else len(body)
        encoded += (
            bytes(
                [number << 3 | (0 if isinstance(value, int) else 2), count & 127 | 128, count >> 7]
            )
            + body
        )
    return encoded


def test_data_outside_the_file_are_refused(copy, tmp_path, monkeypatch):
    """Values in a file that the card's hash does not cover, looked for where the program was
    started."""
    sides = [(1, side) for side in (1, 1, 64, 64)]
    image = message((1, message((1, 1), (2, message(*[(1, message(side)) for side in sides])))))
    place = message((1, "location"), (2, "values"))
    outside = message(*sides, (2, 1), (8, "w"), (13, place), (14, 1))
    node = message((1, "x"), (1, "w"), (2, "y"), (4, "Add"))
    ends = [(11, message((1, "x"), (2, image))), (12, message((1, "y"), (2, image)))]
    graph = message((1, node), (2, "g"), (5, outside), *ends)
    data = message((1, 8), (7, graph), (8, message((1, ""), (2, 17))))
    copy.write_bytes(data)
    write_card(copy, channels_in=1, channels_out=1, stride=1, reach=0)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "values").write_bytes(bytes(4 * 64 * 64))
    with bad_input("may refer to data outside its file"):
        load_network(copy)


def test_missing_files_are_named(copy, tmp_path):
    copy.with_suffix(".json").unlink()
    with bad_input(r"the card '.*net\.json' cannot be read"):
        load_network(copy)
    with bad_input(r"the weights '.*none\.onnx' cannot be read"):
        load_network(tmp_path / "none.onnx")


def test_weights_that_are_no_regular_file_are_refused(copy):
    copy.unlink()
    os.mkfifo(copy)
    with bad_input(r"is not a file\); copy the network again"):
        load_network(copy)


def test_an_unknown_network_name_is_refused():
    with bad_input("there is no network 'dirct' in this installation"):
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
def test_a_card_with_an_invalid_value_is_refused(copy, change, words):
    file = copy.with_suffix(".json")
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with bad_input(words):
        load_network(copy)


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"format": "splitknit-network", "version": 1}'])
def test_a_damaged_card_is_refused(copy, text):
    copy.with_suffix(".json").write_text(text)
    with bad_input("is damaged"):
        load_network(copy)


def test_weights_that_are_not_onnx_are_refused(copy):
    copy.write_bytes(b"no network at all")
    card = json.loads(copy.with_suffix(".json").read_text())
    sizes = ("channels_in", "channels_out", "stride", "reach")
    write_card(copy, **{name: card[name] for name in sizes})
    with bad_input("are not a network from one image to one image"):
        load_network(copy)


def test_shipped_networks_match_their_cards_and_stay_below_4_mb():
    names = [file.stem for file in Path(unet.__file__).parent.glob("**/*.onnx")]
    assert "direct" in names
    for name in names:
        card, data = read_network(name)
        assert card.name == name
        assert len(data) < 4e6
        for wanted in ("data", "training", "metrics", "licence", "command"):
            assert card.facts[wanted], f"the card of {name} says nothing about its {wanted}"
