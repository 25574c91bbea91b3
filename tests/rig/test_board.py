"""The board's layout: Gerbers read by a package of others, copper followed through pads and vias, KiCad's file parsed.

What joins what is found on the pictures of the layers that pygerber draws, not on the layout.
"""

from __future__ import annotations

import io
import itertools
import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from splitknit.errors import BadInput
from splitknit.model import default_rig
from splitknit.rig.board import Board, _Router, lay_out
from splitknit.rig.board_files import _gerbers, gerber_zip, kicad_board, wiring_svg
from splitknit.rig.circuit import Circuit, CircuitSettings
from splitknit.rig.circuit_files import design_circuit

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # pygerber's, of its parser
PX_PER_MM = 20


@pytest.fixture(scope="module")
def circuit() -> Circuit:
    return design_circuit(default_rig())


@pytest.fixture(scope="module")
def board(circuit: Circuit) -> Board:
    return lay_out(circuit)


@pytest.fixture(scope="module")
def heavy() -> Board:
    """With resistors of 2 W."""
    return lay_out(design_circuit(default_rig(), CircuitSettings(topology="switch")))


def drawn(gerber: str, size_mm: tuple[float, float]) -> np.ndarray:
    """(rows, columns) bool, copper or ink, upper left corner of the board first; drawn by pygerber."""
    from PIL import Image
    from pygerber.gerberx3.api.v2 import ColorScheme, GerberFile, ImageFormatEnum

    # a frame of the board's size places the layer in the picture; what it hides is no copper
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


def pads_in_kicad(text: str) -> dict[tuple[str, str], tuple[float, float, str]]:
    """(reference, pin) to place and net, from KiCad's file."""
    pads = {}
    for footprint in find(tree_of(text), "footprint"):
        names = [node[2] for node in find(footprint, "fp_text") if node[1] == "reference"]
        x, y = map(float, find(footprint, "at")[0][1:3])
        for pad in find(footprint, "pad"):
            if names:
                u, v = map(float, find(pad, "at")[0][1:3])
                net = find(pad, "net")
                pads[names[0], pad[1]] = (x + u, y + v, net[0][2] if net else "")
    return pads


@pytest.mark.slow
def test_the_copper_joins_what_the_netlist_joins_and_nothing_else(circuit, board):
    files = _gerbers(board)
    layers = [drawn(files[f"board-{name}_Cu.gbr"], board.size_mm) for name in ("F", "B")]
    labels = [ndimage.label(layer)[0] for layer in layers]
    group: dict[tuple[int, int], tuple[int, int]] = {}

    def root(node):
        while group.setdefault(node, node) != node:
            node = group[node]
        return node

    def under(side, x, y, away):
        row, column = round((y + 1) * PX_PER_MM), round((x + 1) * PX_PER_MM)
        return int(labels[side][row, column + round(away * PX_PER_MM)])

    drills = holes_of(files["board-PTH.drl"], board.size_mm)
    assert len(drills) == len(list(board.pads)) + len(board.vias)
    for x, y, size in drills:  # every plated hole has copper around it on both sides, and joins them
        for side in (0, 1):
            assert under(side, x, y, size / 2 + 0.1) > 0, (x, y)
        group[root((0, under(0, x, y, size / 2 + 0.1)))] = root((1, under(1, x, y, size / 2 + 0.1)))
    found: dict[str, set] = {}
    pads = pads_in_kicad(kicad_board(board, "1"))
    for net, nodes in circuit.nets.items():
        for node in nodes:
            x, y, _ = pads[node.ref, node.pin]
            assert any(abs(x - u) + abs(y - v) < 1e-3 for u, v, _ in drills)
            found.setdefault(net, set()).add(root((0, under(0, x, y, 0.6))))
    assert all(len(groups) == 1 for groups in found.values()), [net for net, g in found.items() if len(g) > 1]
    assert len({next(iter(groups)) for groups in found.values()}) == len(circuit.nets)
    spare = [pad for pad in board.pads if not pad.net]
    assert not {root((0, under(0, *pad.at_mm, 0.6 * pad.size_mm / 1.6))) for pad in spare} & set().union(
        *found.values()
    )


def rectangles(board):
    """Net, side, first and last corner and half the width of all copper that is no plane; pads are on both sides."""
    shapes = []
    for net, side, corners in board.tracks:
        shapes += [(net, {side}, a, b, 0.25) for a, b in itertools.pairwise(corners)]
    shapes += [(net, {0, 1}, at, at, 0.4) for net, at in board.vias]
    shapes += [
        (pad.net or f"none {pad.ref}.{pad.pin}", {0, 1}, pad.at_mm, pad.at_mm, pad.size_mm / 2) for pad in board.pads
    ]
    return shapes


@pytest.mark.parametrize("which", ["board", "heavy"])
def test_copper_of_two_nets_keeps_its_distance(which, request):
    board = request.getfixturevalue(which)
    shapes = rectangles(board)
    numbers = {net: k for k, net in enumerate(dict.fromkeys(shape[0] for shape in shapes))}
    nets = np.array([numbers[shape[0]] for shape in shapes])
    sides = np.array([[side in shape[1] for side in (0, 1)] for shape in shapes])
    ends = np.array([[a, b] for _, _, a, b, _ in shapes])
    low, high, half = ends.min(axis=1), ends.max(axis=1), np.array([shape[4] for shape in shapes])
    gaps = np.maximum(np.maximum(low[:, None] - high[None], low[None] - high[:, None]), 0.0)
    apart = np.hypot(gaps[..., 0], gaps[..., 1]) - half[:, None] - half[None]
    foreign = (nets[:, None] != nets[None]) & (sides[:, None] & sides[None]).any(axis=2)
    assert apart[foreign].min() >= 0.2 - 1e-6
    assert min((low - half[:, None]).min(), (np.array(board.size_mm) - high - half[:, None]).min()) >= 0.8
    for hole in board.holes_mm:
        away = np.maximum(np.maximum(low - hole, hole - high), 0.0)
        assert (np.hypot(away[:, 0], away[:, 1]) - half).min() > 3.0


def test_the_board_fits_the_printed_box_and_parts_do_not_touch(board):
    assert board.size_mm == (90.0, 70.0)
    assert set(board.holes_mm) == {(3.0, 3.0), (87.0, 3.0), (3.0, 67.0), (87.0, 67.0)}  # 84 x 64 mm apart
    boxes = []
    for placed in board.parts:
        (x, y), (left, top, right, bottom) = placed.at_mm, placed.outline_mm
        boxes.append((placed.part.ref, x + left, y + top, x + right, y + bottom))
        assert x + left >= -1e-6 and x + right <= 90 + 1e-6 and y + top >= 0 and y + bottom <= 70
    for k, (ref, left, top, right, bottom) in enumerate(boxes):
        for other, u, v, w, z in boxes[k + 1 :]:
            apart = max(u - right, left - w, v - bottom, top - z)
            assert apart >= -1e-6, (ref, other)


def test_mask_edge_and_screw_holes(board):
    files = _gerbers(board)
    assert holes_of(files["board-NPTH.drl"], board.size_mm) == [(*hole, 3.2) for hole in board.holes_mm]
    mask = drawn(files["board-F_Mask.gbr"], board.size_mm)
    for pad in board.pads:
        assert mask[round((pad.at_mm[1] + 1) * PX_PER_MM), round((pad.at_mm[0] + 1 + 0.7) * PX_PER_MM)]
    edge = np.argwhere(drawn(files["board-Edge_Cuts.gbr"], board.size_mm)[4:-4, 4:-4])
    assert (edge.max(axis=0) - edge.min(axis=0)) / PX_PER_MM == pytest.approx((70.1, 90.1), abs=0.11)


def test_kicad_reads_the_same_board(circuit, board):
    text = kicad_board(board, "1")
    tree = tree_of(text)
    assert tree[0] == "kicad_pcb"
    wanted = {(node.ref, node.pin): net for net, nodes in circuit.nets.items() for node in nodes}
    pads = pads_in_kicad(text)
    assert {key: net for key, (_, _, net) in pads.items() if net} == wanted
    numbers = {node[1]: node[2] for node in find(tree, "net")}
    segments = find(tree, "segment")
    assert len(segments) == sum(len(corners) - 1 for _, _, corners in board.tracks)
    assert {numbers[find(s, "net")[0][1]] for s in segments} <= set(circuit.nets)
    assert len(find(tree, "via")) == len(board.vias)
    assert numbers[find(find(tree, "zone")[0], "net")[0][1]] == "GND"
    # pin 1 to 1 of the Raspberry Pi by a ribbon: even pins above the odd ones, counted to the right
    assert pads["J1", "1"][0] == pads["J1", "2"][0] < pads["J1", "3"][0]
    assert pads["J1", "2"][1] < pads["J1", "1"][1]


def test_equal_circuits_give_equal_bytes(board):
    again = lay_out(design_circuit(default_rig()))
    assert gerber_zip(again) == gerber_zip(board)
    assert kicad_board(again, "1") == kicad_board(board, "1")
    with zipfile.ZipFile(io.BytesIO(gerber_zip(board))) as archive:
        assert sorted(archive.namelist()) == sorted(_gerbers(board))
        assert len(archive.namelist()) == 8


def test_other_boards_are_laid_out(heavy):
    rig = default_rig()
    few = replace(rig, leds=rig.leds[:3], provenance={"pins": {"white": [5, 6, 13]}})
    assert lay_out(design_circuit(few)).size_mm == (90.0, 70.0)
    assert heavy.size_mm[0] > 100
    assert max(x for x, _ in heavy.holes_mm) == pytest.approx(heavy.size_mm[0] - 3)


def test_a_track_without_a_way_is_named(circuit, board, monkeypatch):
    monkeypatch.setattr("splitknit.rig.board._TRIES", 2)
    monkeypatch.setattr("splitknit.rig.board.CLEARANCE_MM", 1.3)
    with pytest.raises(BadInput, match=r"no way was found for the track \w+ on a board of 90 x 70 mm"):
        _Router(replace(board, tracks=(), vias=())).route()


def test_the_wiring_picture_names_every_led_and_its_anode(circuit, board):
    from xml.etree import ElementTree

    picture = ElementTree.fromstring(wiring_svg(board, circuit, default_rig()))
    words = [element.text or "" for element in picture.iter("{http://www.w3.org/2000/svg}text")]
    for k in range(1, 15):
        assert words.count(f"D{k}") == 2  # on the board and on the ring
    assert words.count("A") == 14
    for band in ("white", "nir"):
        assert {f"{band} {k}" for k in range(7)} <= set(words)
