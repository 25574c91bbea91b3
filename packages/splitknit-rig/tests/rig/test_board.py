"""The LED board's files: Gerbers read by a package of others, copper followed through pads, KiCad's file parsed.

What joins what is found on the pictures of the layers that pygerber draws, and compared with the netlist.
"""

from __future__ import annotations

import io
import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy import ndimage

from splitknit.model import default_rig
from splitknit_rig.rig.circuit import BC337, WHITE_LED, CircuitSettings
from splitknit_rig.rig.circuit_files import _BOARD, _LAYOUT, circuit_to_folder
from splitknit_rig.rig.part_settings import BoardSettings

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # pygerber's, of its parser
PX_PER_MM = 20
SIZE_MM = (90.0, 70.0)


@dataclass(frozen=True)
class Pad:
    """One pad of KiCad's file, in mm from the board's upper left corner."""

    ref: str
    pin: str
    net: str
    at_mm: tuple[float, float]
    size_mm: float
    drill_mm: float


@pytest.fixture(scope="module")
def kicad() -> list:
    return tree_of((_BOARD / "board.kicad_pcb").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def pads(kicad) -> list[Pad]:
    found = []
    for footprint in find(kicad, "footprint"):
        for name in (node[2] for node in find(footprint, "fp_text") if node[1] == "reference"):
            x, y = numbers(footprint, "at")
            for pad in find(footprint, "pad"):
                (u, v), net = numbers(pad, "at"), find(pad, "net")
                size, drill = numbers(pad, "size")[0], float(find(pad, "drill")[0][1])
                found.append(Pad(name, pad[1], net[0][2] if net else "", (x + u, y + v), size, drill))
    return found


@pytest.fixture(scope="module")
def holes(kicad) -> list[tuple[float, float]]:
    """Of the screws."""
    return [numbers(one, "at") for one in find(kicad, "footprint") if "MountingHole" in one[1]]


@pytest.fixture(scope="module")
def gerbers() -> dict[str, str]:
    with zipfile.ZipFile(_BOARD / "gerber.zip") as archive:
        return {name: archive.read(name).decode("ascii") for name in archive.namelist()}


@pytest.fixture(scope="module")
def nets() -> dict[str, set[tuple[str, str]]]:
    tree = tree_of((_BOARD / "circuit.net").read_text(encoding="utf-8"))
    return {
        find(net, "name")[0][1]: {(find(node, "ref")[0][1], find(node, "pin")[0][1]) for node in find(net, "node")}
        for net in find(find(tree, "nets")[0], "net")
    }


def drawn(gerber: str, size_mm: tuple[float, float]) -> np.ndarray:
    """(rows, columns) bool, copper or ink, upper left corner of the board first; drawn by pygerber."""
    from PIL import Image
    from pygerber.gerberx3.api.v2 import ColorScheme, GerberFile, ImageFormatEnum

    # a frame of the board's size places the layer in the picture; what it hides is not copper
    lines = gerber.replace("M02*", "")
    codes = [int(code) for code in re.findall(r"%ADD(\d+)", lines)]
    frame = f"%ADD{max(codes) + 1}C,0.0100*%\n%LPD*%\nD{max(codes) + 1}*\n"
    corners = [(-1.0, -1.0), (size_mm[0] + 1.0, size_mm[1] + 1.0)]
    frame += "".join(f"X{round(x * 1e6)}Y{round(y * 1e6)}D03*\n" for x, y in corners)
    stream = io.BytesIO()
    GerberFile.from_str(lines + frame + "M02*\n").parse().render_raster(
        stream, color_scheme=ColorScheme.DEFAULT_GRAYSCALE, dpmm=PX_PER_MM, image_format=ImageFormatEnum.PNG
    )
    picture = np.asarray(Image.open(stream).convert("RGBA")).astype(int)
    return picture[..., :3].sum(axis=2) * (picture[..., 3] > 0) > 300


def holes_of(drill: str, size_mm: tuple[float, float]) -> list[tuple[float, float, float]]:
    """x, y from the board's upper left corner, and diameter, of every hole of an Excellon file; read here alone."""
    sizes = {int(k): float(size) for k, size in re.findall(r"^T(\d+)C([\d.]+)$", drill, flags=re.MULTILINE)}
    holes, tool = [], 0
    for line in drill.partition("\n%\n")[2].splitlines():
        if match := re.fullmatch(r"T(\d+)", line):
            tool = int(match[1])
        elif match := re.fullmatch(r"X(-?[\d.]+)Y(-?[\d.]+)", line):
            holes.append((float(match[1]), size_mm[1] - float(match[2]), sizes[tool]))
    return holes


def tree_of(text: str) -> list:
    """S-expressions as nested lists."""
    stack: list[list] = [[]]
    for token in re.findall(r'"(?:[^"\\]|\\.)*"|[()]|[^\s()]+', text):
        if token == "(":
            stack.append([])
        elif token == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token.strip('"'))
    assert len(stack) == 1
    return stack[0][0]


def find(tree: list, name: str) -> list[list]:
    return [node for node in tree if isinstance(node, list) and node and node[0] == name]


def numbers(tree: list, name: str) -> tuple[float, float]:
    x, y = find(tree, name)[0][1:3]
    return float(x), float(y)


@pytest.mark.slow
def test_the_copper_joins_what_the_netlist_joins_and_nothing_else(kicad, nets, pads, gerbers):
    layers = [drawn(gerbers[f"board-{name}_Cu.gbr"], SIZE_MM) for name in ("F", "B")]
    labels = [ndimage.label(layer)[0] for layer in layers]
    group: dict[tuple[int, int], tuple[int, int]] = {}

    def root(node):
        while group.setdefault(node, node) != node:
            node = group[node]
        return node

    def under(side, x, y, away):
        row, column = round((y + 1) * PX_PER_MM), round((x + 1) * PX_PER_MM)
        return int(labels[side][row, column + round(away * PX_PER_MM)])

    drills = holes_of(gerbers["board-PTH.drl"], SIZE_MM)
    assert len(drills) == len(pads) + len(find(kicad, "via"))
    for x, y, size in drills:  # every plated hole has copper around it on both sides, and joins them
        for side in (0, 1):
            assert under(side, x, y, size / 2 + 0.1) > 0, (x, y)
        group[root((0, under(0, x, y, size / 2 + 0.1)))] = root((1, under(1, x, y, size / 2 + 0.1)))
    found: dict[str, set] = {}
    places = {(pad.ref, pad.pin): pad.at_mm for pad in pads}
    for net, nodes in nets.items():
        for node in nodes:
            x, y = places[node]
            assert any(abs(x - u) + abs(y - v) < 1e-3 for u, v, _ in drills)
            found.setdefault(net, set()).add(root((0, under(0, x, y, 0.6))))
    assert all(len(groups) == 1 for groups in found.values()), [net for net, g in found.items() if len(g) > 1]
    assert len({next(iter(groups)) for groups in found.values()}) == len(nets)
    spare = [pad for pad in pads if not pad.net]
    assert not {root((0, under(0, *pad.at_mm, 0.6 * pad.size_mm / 1.6))) for pad in spare} & set().union(
        *found.values()
    )


def rectangles(kicad, pads):
    """Net, sides, first and last corner and half the width of all copper but planes; pads are on both sides."""
    names = {node[1]: node[2] for node in find(kicad, "net")}
    shapes = []
    for one in find(kicad, "segment"):
        assert float(find(one, "width")[0][1]) == 0.5
        net, side = names[find(one, "net")[0][1]], "FB".index(find(one, "layer")[0][1][0])
        shapes.append((net, {side}, numbers(one, "start"), numbers(one, "end"), 0.25))
    for one in find(kicad, "via"):
        at = numbers(one, "at")
        shapes.append((names[find(one, "net")[0][1]], {0, 1}, at, at, 0.4))
    return shapes + [
        (pad.net or f"none {pad.ref}.{pad.pin}", {0, 1}, pad.at_mm, pad.at_mm, pad.size_mm / 2) for pad in pads
    ]


def test_copper_of_two_nets_keeps_its_distance(kicad, pads, holes):
    shapes = rectangles(kicad, pads)
    order = {net: k for k, net in enumerate(dict.fromkeys(shape[0] for shape in shapes))}
    nets = np.array([order[shape[0]] for shape in shapes])
    sides = np.array([[side in shape[1] for side in (0, 1)] for shape in shapes])
    ends = np.array([[a, b] for _, _, a, b, _ in shapes])
    low, high, half = ends.min(axis=1), ends.max(axis=1), np.array([shape[4] for shape in shapes])
    gaps = np.maximum(np.maximum(low[:, None] - high[None], low[None] - high[:, None]), 0.0)
    apart = np.hypot(gaps[..., 0], gaps[..., 1]) - half[:, None] - half[None]
    foreign = (nets[:, None] != nets[None]) & (sides[:, None] & sides[None]).any(axis=2)
    assert apart[foreign].min() >= 0.2 - 1e-6
    assert min((low - half[:, None]).min(), (np.array(SIZE_MM) - high - half[:, None]).min()) >= 0.8
    for hole in holes:
        away = np.maximum(np.maximum(low - hole, hole - high), 0.0)
        assert (np.hypot(away[:, 0], away[:, 1]) - half).min() > 3.0


def test_the_board_fits_the_printed_box_and_parts_do_not_touch(kicad, holes):
    box = BoardSettings()
    assert (box.pcb_x_mm, box.pcb_y_mm) == SIZE_MM == tuple(_LAYOUT["size_mm"])
    across, down = box.pcb_hole_x_mm / 2, box.pcb_hole_y_mm / 2
    assert set(holes) == {(45 + u * across, 35 + v * down) for u in (-1, 1) for v in (-1, 1)}
    assert sorted(map(tuple, _LAYOUT["holes_mm"])) == sorted(holes)
    assert _LAYOUT["vias"] == len(find(kicad, "via"))
    edge = [numbers(line, end) for line in find(kicad, "gr_line") for end in ("start", "end")]
    assert set(edge) == {(0.0, 0.0), (90.0, 0.0), (0.0, 70.0), (90.0, 70.0)}
    boxes = []
    for footprint in find(kicad, "footprint"):
        for outline in find(footprint, "fp_rect"):
            x, y = numbers(footprint, "at")
            (left, top), (right, bottom) = numbers(outline, "start"), numbers(outline, "end")
            boxes.append((footprint[1], x + left, y + top, x + right, y + bottom))
            assert x + left >= -1e-6 and x + right <= 90 + 1e-6 and y + top >= 0 and y + bottom <= 70
    assert len(boxes) == 90
    for k, (ref, left, top, right, bottom) in enumerate(boxes):
        for other, u, v, w, z in boxes[k + 1 :]:
            apart = max(u - right, left - w, v - bottom, top - z)
            assert apart >= -1e-6, (ref, other)


def test_mask_edge_and_screw_holes(pads, holes, gerbers):
    assert holes_of(gerbers["board-NPTH.drl"], SIZE_MM) == [(*hole, 3.2) for hole in holes]
    mask = drawn(gerbers["board-F_Mask.gbr"], SIZE_MM)
    for pad in pads:
        assert mask[round((pad.at_mm[1] + 1) * PX_PER_MM), round((pad.at_mm[0] + 1 + 0.7) * PX_PER_MM)]
    edge = np.argwhere(drawn(gerbers["board-Edge_Cuts.gbr"], SIZE_MM)[4:-4, 4:-4])
    assert (edge.max(axis=0) - edge.min(axis=0)) / PX_PER_MM == pytest.approx((70.1, 90.1), abs=0.11)
    assert len(gerbers) == 8


def test_kicad_reads_the_same_board(kicad, nets, pads):
    assert kicad[0] == "kicad_pcb"
    assert {(pad.ref, pad.pin): pad.net for pad in pads if pad.net} == {
        node: net for net, nodes in nets.items() for node in nodes
    }
    names = {node[1]: node[2] for node in find(kicad, "net")}
    assert {names[find(s, "net")[0][1]] for s in find(kicad, "segment")} <= set(nets)
    assert names[find(find(kicad, "zone")[0], "net")[0][1]] == "GND"
    # pin 1 to 1 of the Raspberry Pi by a ribbon: even pins above the odd ones, counted to the right
    at = {(pad.ref, pad.pin): pad.at_mm for pad in pads}
    assert at["J1", "1"][0] == at["J1", "2"][0] < at["J1", "3"][0]
    assert at["J1", "2"][1] < at["J1", "1"][1]


def test_the_nominal_rig_gets_the_files_as_they_are(tmp_path: Path):
    circuit_to_folder(tmp_path / "board", default_rig(), CircuitSettings())
    for file in _BOARD.iterdir():
        if not file.name.startswith("films"):  # those are of rigs with films
            assert (tmp_path / "board" / file.name).read_bytes() == file.read_bytes(), file.name
        if file.suffix == ".svg" and file.name != "films-hand.svg":
            image = Path(__file__).resolve().parents[4] / "docs" / "images" / file.name
            assert image.read_bytes() == file.read_bytes()


def test_other_values_are_written_beside_their_parts(tmp_path: Path):
    weak = CircuitSettings(white=replace(WHITE_LED, current_a=0.02, limit_a=0.025), supply_v=7.5)
    facts = circuit_to_folder(tmp_path / "board", default_rig(), weak)
    wanted = {
        f"R{100 * k + n}": facts["stages"][band]["resistors"].get(role)
        for k, role in enumerate(("base", "emitter", "series", "pull_down"), start=1)
        for band, stages in (("white", range(1, 8)), ("nir", range(8, 15)))
        for n in stages
    }
    tree = tree_of((tmp_path / "board" / "board.kicad_pcb").read_text())
    netlist = (tmp_path / "board" / "circuit.net").read_text()
    drawing = (tmp_path / "board" / "schematic.svg").read_text()
    seen = 0
    for footprint in find(tree, "footprint"):
        texts = {node[1]: node[2] for node in find(footprint, "fp_text")}
        if chosen := wanted.get(texts.get("reference", "")):
            ref, value = texts["reference"], texts["value"]
            ohm, watt = re.fullmatch(r"(\w+) ([\d.]+) W", value).groups()
            assert float(watt) == chosen["rating_w"]
            letter = next(c for c in ohm if c in "Rk")
            assert float(ohm.replace(letter, ".")) * {"R": 1, "k": 1000}[letter] == chosen["ohm"]
            assert f'(ref "{ref}")\n      (value "{value}")' in netlist
            assert re.search(rf">{ref}(  |</text>\n<text[^>]*>){ohm}( {watt} W)?<", drawing), ref
            seen += 1
    assert seen == len(wanted) == 56
    assert drawing.count("7.5 V") == 2 and "9 V" not in drawing
    white, nir = (facts["stages"][band]["current_ma"] for band in ("white", "nir"))
    for low, middle, high in (white, nir):
        assert drawing.count(f"{middle:.0f} mA ({low:.0f} to {high:.0f})") == 7
    assert "7.5 V adapter" in (tmp_path / "board" / "wiring.svg").read_text()


def test_names_of_parts_are_escaped(tmp_path: Path):
    named = replace(BC337, name='a "<&\\ b')
    circuit_to_folder(tmp_path / "board", default_rig(), CircuitSettings(transistor=named))
    drawing = ElementTree.fromstring((tmp_path / "board" / "schematic.svg").read_text())
    assert sum(element.text == named.name for element in drawing.iter()) == 14
    for name in ("circuit.net", "board.kicad_pcb"):
        text = (tmp_path / "board" / name).read_text()
        assert text.count('value "a \\"<&\\\\ b"') == 14


@pytest.mark.parametrize(
    ("settings", "pins", "reason"),
    [
        (CircuitSettings(topology="switch"), None, "topology sink, not switch"),
        (CircuitSettings(supply_v=12.0, transistor=replace(BC337, limit_w=1.0)), None, "of 0.6 W, but 2 W are needed"),
        (CircuitSettings(), {"white": [5, 6, 13]}, "no place for the LED white 0 on GPIO 5"),
    ],
)
def test_a_circuit_that_the_board_cannot_carry_is_calculated_only(settings, pins, reason, tmp_path: Path):
    rig = default_rig()
    if pins:
        rig = replace(rig, leds=rig.leds[:3], provenance={"pins": pins})
    circuit_to_folder(tmp_path / "board", default_rig(), CircuitSettings())
    facts = circuit_to_folder(tmp_path / "board", rig, settings)
    assert reason in facts["board"]["misfit"]
    assert {file.name for file in (tmp_path / "board").iterdir()} == {"circuit.json", "rig.json", ".splitknit"}
    assert facts["files"] == ["circuit.json", "rig.json"]


def test_the_wiring_picture_names_every_led_and_its_anode():
    picture = ElementTree.fromstring((_BOARD / "wiring.svg").read_text(encoding="utf-8"))
    words = [element.text or "" for element in picture.iter("{http://www.w3.org/2000/svg}text")]
    for k in range(1, 15):
        assert words.count(f"D{k}") == 2  # on the board and on the ring
    assert words.count("A") == 14
    for band in ("white", "nir"):
        assert {f"{band} {k}" for k in range(7)} <= set(words)
