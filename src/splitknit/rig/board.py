"""The LED board's layout: parts on a grid of 1.27 mm, tracks found by a shortest-path router, ground as a filled plane.

All parts have leads and stand on the front; tracks run on both sides, the plane is on the back. Lengths on the board
are mm from its upper left corner, x right, y down, seen from the front, as KiCad has them.

References
----------
C. Y. Lee, "An algorithm for path connections and its applications", IRE Transactions on Electronic Computers EC-10
(1961), with costs; P. E. Hart, N. J. Nilsson, B. Raphael, "A formal basis for the heuristic determination of minimum
cost paths", IEEE Transactions on Systems Science and Cybernetics 4 (1968).
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.errors import BadInput
from splitknit.model import BoolArray
from splitknit.rig.circuit import Circuit, Component
from splitknit.rig.part_settings import BoardSettings

GRID_MM = 1.27
TRACK_MM, VIA_MM, VIA_DRILL_MM = 0.5, 0.8, 0.4
CLEARANCE_MM = 0.2
"""Between copper of two nets: what every maker of boards can."""
PLANE_CLEARANCE_MM = 0.25
"""Between the plane and what is not ground."""
SPOKE_MM = 0.6
"""Width of the four bridges from a ground pad to the plane: without them it could hardly be soldered."""
EDGE_MM = 0.8
"""Copper stays this far from the board's edge."""
HOLE_MM = 3.2
"""For M3 screws."""
_HEAD_MM = 3.3
"""Radius around a screw without copper."""
_VIA_COST, _BACK_COST = 8.0, 1.6
_TRIES, _PLANES = 40, 5

Node = tuple[int, int, int]
"""Side (0 front, 1 back), column, row of the grid."""


@dataclass(frozen=True, slots=True)
class Pad:
    """A round hole with copper on both sides."""

    ref: str
    pin: str
    net: str
    """Empty where nothing is connected."""
    at_mm: tuple[float, float]
    size_mm: float
    drill_mm: float


@dataclass(frozen=True, slots=True)
class Placed:
    """A part on the board."""

    part: Component
    at_mm: tuple[float, float]
    """Of its first pin."""
    outline_mm: tuple[float, float, float, float]
    """Left, top, right, bottom of its body, from its first pin."""
    pads: tuple[Pad, ...]


@dataclass(frozen=True, slots=True)
class Board:
    """The finished layout."""

    size_mm: tuple[float, float]
    holes_mm: tuple[tuple[float, float], ...]
    """Centres of the screw holes."""
    parts: tuple[Placed, ...]
    tracks: tuple[tuple[str, int, tuple[tuple[float, float], ...]], ...]
    """Net, side (0 front, 1 back) and corners of every track."""
    vias: tuple[tuple[str, tuple[float, float]], ...]

    @property
    def pads(self) -> Iterator[Pad]:
        """All of them."""
        return (pad for placed in self.parts for pad in placed.pads)


@dataclass(frozen=True, slots=True)
class _Shape:
    """Pins in mm from the first, size and drill of the pads, the body around them."""

    pins: Mapping[str, tuple[float, float]]
    size_mm: float
    drill_mm: float
    outline_mm: tuple[float, float, float, float]


def _row(steps: Sequence[int]) -> dict[str, tuple[float, float]]:
    return {str(k + 1): (step * GRID_MM, 0.0) for k, step in enumerate(steps)}


_SHAPES: Mapping[str, _Shape] = {
    "DIN0207": _Shape(_row((0, 8)), 1.6, 0.8, (1.9, -1.25, 8.3, 1.25)),
    "DIN0411": _Shape(_row((0, 12)), 1.6, 0.9, (2.7, -1.8, 12.5, 1.8)),
    "DIN0414": _Shape(_row((0, 12)), 1.6, 0.9, (1.7, -2.25, 13.5, 2.25)),
    "DIN0617": _Shape(_row((0, 16)), 1.6, 1.0, (1.7, -3.0, 18.6, 3.0)),
    "TO-92": _Shape(_row((0, 2, 4)), 1.6, 0.8, (0.1, -2.4, 5.0, 1.7)),  # the flat side below
    "PinHeader_1x02": _Shape(_row((0, 2)), 1.6, 1.0, (-1.2, -1.2, 3.7, 1.2)),
    "DO-41": _Shape(_row((0, 8)), 1.6, 1.0, (2.5, -1.35, 7.7, 1.35)),
    "CP_Radial": _Shape(_row((0, 4)), 1.6, 0.9, (-2.5, -5.0, 7.5, 5.0)),
    "C_Disc": _Shape(_row((0, 4)), 1.6, 0.8, (0.0, -1.25, 5.0, 1.25)),
    "Fuse": _Shape(_row((0, 4)), 1.6, 0.9, (-2.4, -1.9, 7.5, 1.9)),
    # seen from the front with pin 1 at the left the even pins lie above the odd ones, as on the Raspberry Pi
    "IDC-Header_2x20": _Shape(
        {str(n): ((n - 1) // 2 * 2 * GRID_MM, -2 * GRID_MM * ((n - 1) % 2)) for n in range(1, 41)},
        1.6,
        1.0,
        (-5.1, -5.8, 53.4, 3.3),
    ),
    "BarrelJack": _Shape({"1": (0.0, 0.0), "2": (-6.0, 0.0), "3": (-3.0, 4.7)}, 3.8, 3.0, (-13.7, -4.5, 0.8, 4.5)),
}
"""By a word of the footprint's name."""
_RESISTOR_STEPS = {"DIN0207": 2, "DIN0411": 3, "DIN0414": 4, "DIN0617": 5}
"""Grid steps from one resistor of a kind to the next."""


def lay_out(circuit: Circuit) -> Board:
    """Place and route the board of a circuit.

    Parameters
    ----------
    circuit : components and nets; the board has the size and the screw holes that the printed box holds, and is larger
        where the parts need it

    Raises
    ------
    BadInput
        If no way is found for a track, or the plane falls apart.
    """
    chosen = BoardSettings()
    parts, size = _placed(circuit, chosen)
    inset = ((chosen.pcb_x_mm - chosen.pcb_hole_x_mm) / 2, (chosen.pcb_y_mm - chosen.pcb_hole_y_mm) / 2)
    holes = tuple((x, y) for y in (inset[1], size[1] - inset[1]) for x in (inset[0], size[0] - inset[0]))
    joined: tuple[Pad, ...] = ()
    for _ in range(_PLANES):
        tracks, vias = _Router(Board(size, holes, parts, (), ()), joined).route()
        board = Board(size, holes, parts, tracks, vias)
        islands = _off_the_plane(board)
        if not islands or islands < set(joined):
            return board
        # tracks lead to those that the plane does not reach
        lost = [*joined, *sorted(islands - set(joined), key=lambda pad: pad.at_mm)]
        grounds = [pad for pad in board.pads if pad.net == "GND" and pad not in islands]
        nearest = min(grounds, key=lambda pad: (np.hypot(*np.subtract(pad.at_mm, lost[-1].at_mm)), pad.at_mm))
        joined = tuple(dict.fromkeys([nearest, *lost]))
    raise BadInput("the ground plane falls apart between tracks on this board; route the netlist circuit.net in KiCad.")


def _shape_of(part: Component) -> tuple[str, _Shape]:
    return next((name, shape) for name, shape in _SHAPES.items() if name in part.footprint)


def _placed(circuit: Circuit, settings: BoardSettings) -> tuple[tuple[Placed, ...], tuple[float, float]]:
    """Two rows of stages, the header and the jack between them, the rest of the supply above."""
    by_ref = {part.ref: part for part in circuit.components}
    count = len(circuit.channels)
    columns = max(-(-count // 2), 1)
    kinds = {_shape_of(part)[0] for ref, part in by_ref.items() if ref.startswith("R")}
    long = max(*(round(_SHAPES[kind].pins["2"][0] / GRID_MM) for kind in kinds), 8)
    step, pitch = max(_RESISTOR_STEPS[kind] for kind in kinds), long + 2
    rows = max(
        sum(by_ref.get(f"R{100 * role + c.number}") is not None for role in (1, 2, 3, 4)) for c in circuit.channels
    )
    height = 3 + step * (rows - 1)
    # half the board in grid steps: header and its box, a channel for tracks, a row of stages, the strip above
    inner = 9
    half_x = max(settings.pcb_x_mm / 2, ((columns - 1) * pitch + long) / 2 * GRID_MM + 1.7)
    half_y = max(settings.pcb_y_mm / 2, (inner + height) * GRID_MM + 9.5)
    at: dict[str, tuple[float, float]] = {"J1": (-18, 1), "J2": ((13.7 - half_x) / GRID_MM, -1), "C1": (27, 0)}
    top = -(half_y - 3.3) / GRID_MM
    at |= {"F1": (-18, round(top)), "D90": (-4, round(top)), "C2": (16, round(top))}
    for k, channel in enumerate(circuit.channels):
        n, lower = channel.number, k >= columns
        x = -((columns - 1) * pitch + long) // 2 + (k % columns) * pitch
        y, way = (inner + height, -1) if lower else (-inner - height, 1)
        at |= {f"Q{n}": (x, y), f"D{n}": (x + 6, y)}
        y += 3 * way
        for role in (2, 3, 1, 4):  # emitter, series, base, pull-down: the base's end towards the header
            if f"R{100 * role + n}" in by_ref:
                at[f"R{100 * role + n}"] = (x, y)
                y += step * way
    nets = {(node.ref, node.pin): name for name, nodes in circuit.nets.items() for node in nodes}
    placed = []
    for part in circuit.components:
        _, shape = _shape_of(part)
        origin = half_x + at[part.ref][0] * GRID_MM, half_y + at[part.ref][1] * GRID_MM
        pads = tuple(
            Pad(
                part.ref,
                pin,
                nets.get((part.ref, pin), ""),
                (round(origin[0] + dx, 4), round(origin[1] + dy, 4)),
                shape.size_mm,
                shape.drill_mm,
            )
            for pin, (dx, dy) in shape.pins.items()
        )
        placed.append(Placed(part, (round(origin[0], 4), round(origin[1], 4)), shape.outline_mm, pads))
    return tuple(placed), (round(2 * half_x, 2), round(2 * half_y, 2))


class _Router:
    """Finds tracks on the grid; a net for which there is no way is routed first the next time."""

    def __init__(self, board: Board, grounds: Sequence[Pad] = ()) -> None:
        self.board = board
        width, height = board.size_mm
        # the grid goes through the middle of the board
        self.origin = (width / 2) % GRID_MM, (height / 2) % GRID_MM
        self.shape = int((width - self.origin[0]) / GRID_MM) + 1, int((height - self.origin[1]) / GRID_MM) + 1
        x = self.origin[0] + GRID_MM * np.arange(self.shape[0])[:, None] + np.zeros(self.shape)
        y = self.origin[1] + GRID_MM * np.arange(self.shape[1])[None, :] + np.zeros(self.shape)
        edge = EDGE_MM + TRACK_MM / 2
        self.free: BoolArray = (x >= edge) & (x <= width - edge) & (y >= edge) & (y <= height - edge)
        for hx, hy in board.holes_mm:
            self.free &= np.hypot(x - hx, y - hy) >= _HEAD_MM + TRACK_MM / 2
        # pads that keep a track, or a via, off a place: all of them, and by net
        self.near: NDArray[np.int64] = np.zeros((2, *self.shape), dtype=np.int64)
        self.own: dict[str, NDArray[np.int64]] = {}
        self.on: dict[Pad, list[tuple[int, int]]] = {}
        for pad in board.pads:
            away = np.hypot(x - pad.at_mm[0], y - pad.at_mm[1]) - pad.size_mm / 2
            reaches = (TRACK_MM / 2 + CLEARANCE_MM - 1e-6, VIA_MM / 2 + CLEARANCE_MM - 1e-6)
            near = away < np.array(reaches)[:, None, None]
            self.near += near
            self.own[pad.net] = self.own.get(pad.net, 0) + near
            inside = np.argwhere(away <= 1e-6 - TRACK_MM / 2)
            self.on[pad] = [(int(i), int(j)) for i, j in inside]
        terminals: dict[str, list[Pad]] = {"GND": list(grounds)} if grounds else {}
        for pad in board.pads:
            if pad.net and pad.net != "GND":
                terminals.setdefault(pad.net, []).append(pad)
        self.terminals = terminals

    def route(
        self,
    ) -> tuple[
        tuple[tuple[str, int, tuple[tuple[float, float], ...]], ...], tuple[tuple[str, tuple[float, float]], ...]
    ]:
        """Tracks and vias. Raises BadInput if there is no way for a net in any order that was tried."""
        order = sorted(self.terminals, key=lambda net: (self._length(net), net))
        failed = ""
        for _ in range(_TRIES):
            taken: dict[Node, str] = {}
            paths: list[tuple[str, list[Node]]] = []
            failed = ""
            for net in order:
                found = self._connect(net, taken)
                if found is None:
                    failed = net
                    break
                paths += [(net, path) for path in found]
            if not failed:
                return self._drawn(paths)
            order.remove(failed)
            order.insert(0, failed)
        raise BadInput(
            f"no way was found for the track {failed} on a board of {self.board.size_mm[0]:g} x "
            f"{self.board.size_mm[1]:g} mm; make it larger, or route the netlist circuit.net in KiCad."
        )

    def _length(self, net: str) -> float:
        places = np.array([pad.at_mm for pad in self.terminals[net]])
        return float(np.ptp(places, axis=0).sum())

    def _connect(self, net: str, taken: dict[Node, str]) -> list[list[Node]] | None:
        """Paths that join all pads of a net, which are entered in `taken`; None where one cannot be reached."""
        blocked: BoolArray = ~self.free | (self.near > self.own[net])
        pads = list(self.terminals[net])
        tree: set[Node] = {(side, *node) for node in self.on[pads[0]] for side in (0, 1)}
        left, paths = pads[1:], []
        while left:
            goals = {(side, *node): pad for pad in left for node in self.on[pad] for side in (0, 1)}
            path = self._shortest(net, tree, goals, blocked, taken)
            if path is None:
                return None
            reached = goals[path[-1]]
            left.remove(reached)
            tree |= set(path) | {(side, *node) for node in self.on[reached] for side in (0, 1)}
            paths.append(path)
        for path in paths:
            for node in path:
                taken[node] = net
            for (side, *before), (other, *after) in itertools.pairwise(path):
                if side != other and before == after:
                    taken[0, before[0], before[1]] = taken[1, before[0], before[1]] = net
        return paths

    def _shortest(
        self, net: str, tree: set[Node], goals: Mapping[Node, Pad], blocked: BoolArray, taken: Mapping[Node, str]
    ) -> list[Node] | None:
        """Cheapest way from a tree to one of the goals; `blocked` (2, W, H): for tracks, for vias."""
        cost: dict[Node, float] = dict.fromkeys(tree, 0.0)
        came: dict[Node, Node] = {}
        width, height = self.shape
        columns, rows = ([node[k] for node in goals] for k in (1, 2))
        left, right, top, bottom = min(columns), max(columns), min(rows), max(rows)

        def ahead(node: Node) -> float:
            """No way to a goal is shorter: steps to the box around them."""
            _, i, j = node
            return float(max(left - i, i - right, 0) + max(top - j, j - bottom, 0))

        heap = [(ahead(node), 0.0, node) for node in sorted(tree)]
        heapq.heapify(heap)
        while heap:
            _, spent, node = heapq.heappop(heap)
            if spent > cost[node]:
                continue
            if node in goals:
                path = [node]
                while path[-1] in came:
                    path.append(came[path[-1]])
                return path[::-1]
            side, i, j = node
            step = _BACK_COST if side else 1.0
            around: list[tuple[Node, float]] = [
                ((side, i + 1, j), step), ((side, i - 1, j), step), ((side, i, j + 1), step), ((side, i, j - 1), step),
            ]  # fmt: skip
            if not blocked[1, i, j]:
                around.append(((1 - side, i, j), _VIA_COST))
            for following, price in around:
                _, u, v = following
                if not (0 <= u < width and 0 <= v < height) or blocked[0, u, v] or taken.get(following, net) != net:
                    continue
                total = spent + price
                if total < cost.get(following, np.inf):
                    cost[following], came[following] = total, node
                    heapq.heappush(heap, (total + ahead(following), total, following))
        return None

    def _drawn(
        self, paths: Sequence[tuple[str, list[Node]]]
    ) -> tuple[
        tuple[tuple[str, int, tuple[tuple[float, float], ...]], ...], tuple[tuple[str, tuple[float, float]], ...]
    ]:
        """Paths as corners in mm and vias; a change of side on a pad needs none."""
        pad_nodes = {node for nodes in self.on.values() for node in nodes}
        tracks, vias = [], set()
        for net, path in paths:
            run = [path[0]]
            for before, node in itertools.pairwise(path):
                if before[0] != node[0]:
                    tracks.append((net, before[0], self._corners(run)))
                    if before[1:] not in pad_nodes:
                        vias.add((net, self._at(node)))
                    run = [node]
                else:
                    run.append(node)
            tracks.append((net, run[0][0], self._corners(run)))
        return tuple(track for track in tracks if len(track[2]) > 1), tuple(sorted(vias))

    def _at(self, node: Node) -> tuple[float, float]:
        return round(self.origin[0] + node[1] * GRID_MM, 4), round(self.origin[1] + node[2] * GRID_MM, 4)

    def _corners(self, run: Sequence[Node]) -> tuple[tuple[float, float], ...]:
        kept = [
            node
            for k, node in enumerate(run)
            if k in (0, len(run) - 1)
            or (run[k - 1][1] - node[1], run[k - 1][2] - node[2]) != (node[1] - run[k + 1][1], node[2] - run[k + 1][2])
        ]
        return tuple(self._at(node) for node in kept)


def _off_the_plane(board: Board) -> set[Pad]:
    """Ground pads that the largest part of the plane does not reach. Drawn at 0.1 mm."""
    scale = 10.0
    width, height = (round(side * scale) for side in board.size_mm)
    y, x = np.mgrid[0:height, 0:width] / scale
    margin = EDGE_MM
    plane = (x > margin) & (y > margin) & (x < board.size_mm[0] - margin) & (y < board.size_mm[1] - margin)

    def keep_away(first: tuple[float, float], last: tuple[float, float], reach: float) -> None:
        left, right = sorted((first[0], last[0]))
        top, bottom = sorted((first[1], last[1]))
        rows = slice(max(int((top - reach) * scale), 0), int((bottom + reach) * scale) + 2)
        columns = slice(max(int((left - reach) * scale), 0), int((right + reach) * scale) + 2)
        dx = np.maximum(np.maximum(left - x[rows, columns], x[rows, columns] - right), 0)
        dy = np.maximum(np.maximum(top - y[rows, columns], y[rows, columns] - bottom), 0)
        plane[rows, columns] &= np.hypot(dx, dy) > reach

    for hole in board.holes_mm:
        keep_away(hole, hole, _HEAD_MM)
    for net, side, corners in board.tracks:
        for first, last in itertools.pairwise(corners):
            if side == 1 and net != "GND":
                keep_away(first, last, TRACK_MM / 2 + PLANE_CLEARANCE_MM)
    for net, via in board.vias:
        if net != "GND":
            keep_away(via, via, VIA_MM / 2 + PLANE_CLEARANCE_MM)
    for pad in board.pads:
        if pad.net != "GND":
            keep_away(pad.at_mm, pad.at_mm, pad.size_mm / 2 + PLANE_CLEARANCE_MM)
    regions = ndimage.label(plane)[0]
    largest = int(np.bincount(regions.ravel())[1:].argmax()) + 1
    bridged = {
        pad
        for pad, (u, v) in spokes(board)
        if regions[min(round(v * scale), height - 1), min(round(u * scale), width - 1)] == largest
    }
    return {pad for pad in board.pads if pad.net == "GND"} - bridged


def spokes(board: Board) -> Iterator[tuple[Pad, tuple[float, float]]]:
    """Ground pads, each with the ends of its bridges to the plane: those that keep off other nets and the edge."""
    need = SPOKE_MM / 2 + PLANE_CLEARANCE_MM - 1e-6
    others = [(pad.at_mm, pad.at_mm, pad.size_mm / 2) for pad in board.pads if pad.net != "GND"]
    others += [(at, at, VIA_MM / 2) for net, at in board.vias if net != "GND"]
    for net, side, corners in board.tracks:
        if net != "GND" and side == 1:
            others += [(a, b, TRACK_MM / 2) for a, b in itertools.pairwise(corners)]
    first, last = (np.array([shape[k] for shape in others]).reshape(-1, 2) for k in (0, 1))
    half = np.array([shape[2] for shape in others])
    low, high = np.minimum(first, last), np.maximum(first, last)
    for pad in board.pads:
        if pad.net != "GND":
            continue
        reach, (x, y) = pad.size_mm / 2 + PLANE_CLEARANCE_MM + 0.2, pad.at_mm
        for end in ((x + reach, y), (x - reach, y), (x, y + reach), (x, y - reach)):
            gaps = np.maximum(np.maximum(low - end, end - high), 0.0)
            rim = EDGE_MM + SPOKE_MM / 2
            inside = all(rim < end[k] < board.size_mm[k] - rim for k in (0, 1))
            if inside and bool(np.all(np.hypot(gaps[:, 0], gaps[:, 1]) - half >= need)):
                yield pad, end
