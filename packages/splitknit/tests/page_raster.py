"""A small reader of our PDF pages: it follows the table of places and draws what the page says, in
pixels."""

from __future__ import annotations

import re

import cv2
import numpy as np

TOKEN = re.compile(r"\((?:\\.|[^\\()])*\)|/\w+|[-+]?\d*\.?\d+|[A-Za-z]+")
SUB = 4
"""Parts of a pixel in which edges are averaged."""


def objects_of(data: bytes) -> dict[int, bytes]:
    """Every object, found by the table at the end as a reader does it."""
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF", data).group(1))
    assert data[start:].startswith(b"xref\n0 ")
    lines = data[start:].split(b"\n")
    count = int(lines[1].split()[1])
    bodies = {}
    for number, line in enumerate(lines[3 : 2 + count], start=1):
        assert len(line) == 19
        place = int(line[:10])
        assert data[place:].startswith(b"%d 0 obj\n" % number)
        bodies[number] = data[place:].split(b"\nendobj")[0].split(b"obj\n", 1)[1]
    return bodies


def stream_of(item: bytes) -> str:
    length = int(re.search(rb"/Length (\d+)", item).group(1))
    body = item.split(b"stream\n", 1)[1]
    assert body[length:].startswith(b"\nendstream")
    return body[:length].decode("ascii")


def draw(data: bytes, px_per_mm: float) -> tuple[np.ndarray, list[str]]:
    """Grey picture (rows, columns) in 0 to 255 of the page, and its lines of text."""
    objects = objects_of(data)
    page = objects[3].decode("ascii")
    width, height = map(float, re.search(r"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", page).groups())
    shapes = {
        name: stream_of(objects[int(k)])
        for name, k in re.findall(r"/(\w+) (\d+) 0 R", page.split("/XObject")[1])
    }
    scale = px_per_mm * 25.4 / 72
    size = round(height * scale), round(width * scale)
    image = np.full((size[0] * SUB, size[1] * SUB), 255, np.uint8)
    to_pixels = np.array([[scale, 0, 0], [0, -scale, height * scale], [0, 0, 1.0]])
    texts: list[str] = []
    _run(stream_of(objects[4]), to_pixels, image, shapes, texts)
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA), texts


def _run(content, matrix, image, shapes, texts):  # noqa: PLR0912 - one branch an operator
    stack, values, paths, grey, pen, line = [], [], [], 0.0, 0.0, 0.1
    for token in TOKEN.findall(content):
        if token[0] in "(/" or re.fullmatch(r"[-+]?\d*\.?\d+", token):
            values.append(token)
            continue
        n = [float(v) for v in values if v[0] not in "(/"]
        if token == "q":
            stack.append((matrix, grey, pen, line))
        elif token == "Q":
            matrix, grey, pen, line = stack.pop()
        elif token == "cm":
            matrix = matrix @ np.array([[n[0], n[2], n[4]], [n[1], n[3], n[5]], [0, 0, 1]])
        elif token == "Do":
            _run(shapes[values[0][1:]], matrix, image, shapes, texts)
        elif token == "re":
            x, y, w, h = n
            paths.append([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)])
        elif token == "m":
            paths.append([(n[0], n[1])])
        elif token == "l":
            paths[-1].append((n[0], n[1]))
        elif token == "c":
            ends = np.array([paths[-1][-1], n[0:2], n[2:4], n[4:6]])
            t = np.linspace(0, 1, 33)[1:, None]
            curve = (
                (1 - t) ** 3 * ends[0]
                + 3 * (1 - t) ** 2 * t * ends[1]
                + 3 * (1 - t) * t**2 * ends[2]
                + t**3 * ends[3]
            )
            paths[-1].extend(map(tuple, curve))
        elif token == "g":
            grey = n[0]
        elif token == "G":
            pen = n[0]
        elif token == "w":
            line = n[0]
        elif token in ("f", "S"):
            places = [_places(path, matrix) for path in paths]
            if token == "f":
                for place in places:
                    cv2.fillPoly(image, [place], 255 * grey, cv2.LINE_AA, 8)
            else:
                thick = max(1, round(line * abs(matrix[0, 0]) * SUB))
                cv2.polylines(image, places, False, 255 * pen, thick, cv2.LINE_AA, 8)
            paths = []
        elif token == "Tj":
            texts.append(values[-1][1:-1].replace("\\(", "(").replace("\\)", ")"))
        else:
            assert token in ("BT", "ET", "Tf", "Td", "h"), token
        values = []


def _places(path, matrix):
    """Fixed-point pixels (8 bits of fraction) of points; a page's edge is a pixel's edge, not its
    middle."""
    points = np.column_stack([np.array(path), np.ones(len(path))]) @ matrix.T
    return np.round((points[:, :2] * SUB - 0.5) * 256).astype(np.int32)
