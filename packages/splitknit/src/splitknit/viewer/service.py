"""What the server answers: an address below the token, and what comes back."""

from __future__ import annotations

import contextlib
import json
import threading
from collections import OrderedDict
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.registry import MATCH, VIEWS, extension
from splitknit.viewer.catalogue import Catalogue, CatalogueEntry, Reply, open_below, print_of, read_below
from splitknit.viewer.surface import TILE, Reading, ResultSurface, export, pick, read_surface, section

STATIC = Path(__file__).parent / "static"
_TEXTS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_TYPES = {**{suffix: f"{kind}; charset=utf-8" for suffix, kind in _TEXTS.items()}, ".svg": "image/svg+xml"}
_PICTURES = ("normals.png", "albedo.png", "specular.png", "print.png", "preview.png")
_KEPT_BYTES = 200_000_000  # memory of kept surfaces; two are kept whatever their size, since a pair is shown by turns
_THUMB_PX = 360
_MAX_PICTURE_BYTES = 400_000_000  # largest picture that is sent as it is; the rig's full frames have 40 MB at most
_NOT_FOUND = "there is nothing at this address."

Query = Mapping[str, str]


@lru_cache(maxsize=1)
def static_files() -> frozenset[str]:
    """The files of the pages, by their addresses."""
    return frozenset(file.relative_to(STATIC).as_posix() for file in STATIC.rglob("*") if file.suffix in _TYPES)


def static_file(name: str) -> Reply:
    """One of :func:`static_files`."""
    return _bytes((STATIC / name).read_bytes(), _TYPES[Path(name).suffix], {"Cache-Control": "no-cache"})


class Service:
    """Answers about one catalogue; several threads may call it at once."""

    def __init__(self, catalogue: Catalogue, gallery: Any = None) -> None:
        """`gallery` is a :class:`splitknit_match.viewer.people.People`, or None."""
        self.catalogue = catalogue
        self.gallery = gallery
        self._surfaces: OrderedDict[str, ResultSurface] = OrderedDict()
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()
        self._large = threading.Lock()  # held by what needs several times the memory of a surface
        self._marks = lru_cache(maxsize=8)(self._read_marks)
        self._aligned = lru_cache(maxsize=8)(self._align)
        self._differed = lru_cache(maxsize=4)(self._differ)

    def answer(self, path: str, query: Query) -> Reply:
        """Answer a request. Raises BadInput if there is nothing there, or what is there cannot be used.

        `path`: below the token, as sent; no address needs an escape, so none is undone. `query`: name to value.
        """
        if path in static_files():
            return static_file(path)
        match path.split("/"):
            case [""]:
                return static_file("index.html")
            case ["api", "catalogue"]:
                return json_reply(self._list())
            case ["api", "people", row] if self.gallery is not None:
                return _bytes(self.gallery.picture(row), "image/png")
            case ["api", "pair", first, second, *rest]:
                return self._pair(first, second, rest, query)
            case ["api", "result", key, *rest]:
                return self._result(self.catalogue.entry(key), rest, query)
        raise BadInput(_NOT_FOUND)

    def surface(self, entry: CatalogueEntry) -> ResultSurface:
        """Return a result's heights; the last results are kept in memory."""
        with self._lock:
            lock = self._locks.setdefault(entry.key, threading.Lock())
        with lock:
            with self._lock:
                if entry.key in self._surfaces:
                    self._surfaces.move_to_end(entry.key)
                    return self._surfaces[entry.key]
            surface = read_surface(entry.folder)
            with self._lock:
                self._surfaces[entry.key] = surface
                while len(self._surfaces) > 2 and sum(kept.nbytes for kept in self._surfaces.values()) > _KEPT_BYTES:
                    self._surfaces.popitem(last=False)
            return surface

    def check(self, entry: CatalogueEntry) -> None:
        """Read a result's heights, or what photographs there are. Raises BadInput if that cannot be done."""
        if entry.result:
            self.surface(entry)
        else:
            _describe_photographs(entry)

    def _result(self, entry: CatalogueEntry, rest: list[str], query: Query) -> Reply:  # noqa: PLR0911
        match rest:
            case []:
                known = _describe(entry, self.surface(entry)) if entry.result else _describe_photographs(entry)
                return json_reply(known)
            case ["first"]:
                return _bytes(self.surface(entry).first_view(), "application/octet-stream")
            case ["tile", stride, row, column]:
                numbers = (_whole(stride), _whole(row), _whole(column))
                return _bytes(self.surface(entry).tile(*numbers), "application/octet-stream")
            case ["pick"]:
                return json_reply(self._pick(entry, query))
            case ["section"]:
                return json_reply(_cut(self.surface(entry), query))
            case ["minutiae"]:
                return json_reply(self._minutiae(entry))
            case ["picture", name] if name in _PICTURES:
                return _file(entry.folder, name, "image/png")
            case ["thumb"]:
                return _bytes(_thumb(entry.folder), "image/jpeg")
            case ["photo", number]:
                from splitknit.viewer.photographs import photo_jpeg

                width = _whole(query.get("width", "1200"))
                return _bytes(photo_jpeg(entry, _whole(number), width), "image/jpeg")
            case ["export", kind]:
                with self._large:
                    return export(entry, self.surface(entry), kind, _whole(query.get("step", "1")))
        raise BadInput(_NOT_FOUND)

    def _list(self) -> dict[str, Any]:
        return {
            "title": _shown(self.catalogue.title),
            "chosen": list(self.catalogue.chosen),
            "results": [_listed(entry) for entry in self.catalogue.entries],
            "people": None if self.gallery is None else self.gallery.document(),
        }

    def _pick(self, entry: CatalogueEntry, query: Query) -> dict[str, Any]:
        ray = np.array([_number(query, name) for name in ("ox", "oy", "oz", "dx", "dy", "dz")])
        exaggeration = _number(query, "relief", 1.0)
        require(0 <= exaggeration <= 100, "an exaggeration must lie between 0 and 100.")
        return {"point_mm": pick(self.surface(entry), ray[:3], ray[3:], exaggeration)}

    def _minutiae(self, entry: CatalogueEntry) -> dict[str, Any]:
        try:
            return {"minutiae": self._marks(entry.key).document()}
        except BadInput as error:
            return {"minutiae": None, "why_not": str(error)}

    def _read_marks(self, key: str) -> Any:
        marks_of = extension(VIEWS, "marks", "the view of minutiae", MATCH)
        return marks_of(self.catalogue.entry(key).folder, self._surface_of(key))

    def _surface_of(self, key: str) -> ResultSurface:
        return self.surface(self.catalogue.entry(key))

    def _align(self, first: str, second: str) -> Any:
        one, two = self.catalogue.entry(first), self.catalogue.entry(second)
        with self._large:
            return _pair().align_results(one, self.surface(one), two, self.surface(two))

    def _differ(self, first: str, second: str) -> tuple[NDArray[np.uint8], dict[str, float]]:
        one, two = map(self._surface_of, (first, second))
        found = self._aligned(first, second)
        with self._large:
            picture, figures = _pair().difference(one, two, found)
            return picture, figures

    def _pair(self, first: str, second: str, rest: list[str], query: Query) -> Reply:
        match rest:
            case []:
                return json_reply(self._both(first, second))
            case ["difference"]:
                from splitknit.io.images import encode_image

                return _bytes(encode_image(self._differed(first, second)[0], ".png"), "image/png")
            case ["section"]:
                return json_reply(self._section_of_both(first, second, query))
        raise BadInput(_NOT_FOUND)

    def _both(self, first: str, second: str) -> dict[str, Any]:
        for key in (first, second):
            self.surface(self.catalogue.entry(key))
        try:
            found = self._aligned(first, second)
        except BadInput as error:
            return {"alignment": None, "why_not": str(error)}
        if found.how == "none":
            return {"alignment": None, "why_not": "they have too few ridges in common"}
        pairs, apart = [], None
        with contextlib.suppress(BadInput):
            pairs = _pair().matched_marks(self._marks(first), self._marks(second), found)
        with contextlib.suppress(BadInput):
            _, apart = self._differed(first, second)
        return {"alignment": found.document(), "pairs": pairs, "difference": apart}

    def _section_of_both(self, first: str, second: str, query: Query) -> dict[str, Any]:
        """Both cut at the same places of the first one's frame."""
        one, two = map(self._surface_of, (first, second))
        found = _pair().Alignment("none")
        with contextlib.suppress(BadInput):
            found = self._aligned(first, second)
        return {"cuts": [_cut(one, query, read) for read in (None, found.read(two))]}


def _pair() -> Any:
    """The comparison of two results. Raises BadInput where it is not installed."""
    return extension(VIEWS, "pair", "the comparison of two results", MATCH)


@lru_cache(maxsize=512)
def _thumb(folder: Path) -> bytes:
    import cv2

    from splitknit.io.images import decode_image

    stored = decode_image(read_below(folder, "preview.png", 100_000_000), "preview.png")
    require(stored.dtype == np.uint8, "preview.png has more than 8 bits.")
    picture: Any = np.ascontiguousarray(stored[..., ::-1])
    scale = _THUMB_PX / max(picture.shape[:2])
    if scale < 1:
        size = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())


def json_reply(document: Any) -> Reply:
    """Plain JSON. Raises BadInput where a number is none."""
    try:
        text = json.dumps(document, allow_nan=False, separators=(",", ":"))
    except ValueError as error:
        cure = "reconstruct the capture again."
        raise BadInput(f"a figure of this answer is NaN or infinite: the result is damaged; {cure}") from error
    return _bytes(text.encode("utf-8"), "application/json; charset=utf-8")


def _bytes(content: bytes, kind: str, headers: Mapping[str, str] | None = None) -> Reply:
    return Reply(kind, len(content), content, headers or {})


def _file(folder: Path, name: str, kind: str) -> Reply:
    reply = Reply.of_file(open_below(folder, name), kind)
    if reply.size > _MAX_PICTURE_BYTES:
        reply.close()
        raise BadInput(f"{name} is too large: {reply.size} bytes, at most {_MAX_PICTURE_BYTES} are sent.")
    return reply


def _whole(text: str) -> int:
    require(text.isascii() and text.isdigit() and len(text) < 8, f"{text[:20]!a} is not a whole number.")
    return int(text)


def _number(query: Query, name: str, default: float | None = None) -> float:
    try:
        value = float(query[name]) if name in query or default is None else default
    except (KeyError, ValueError) as error:
        raise BadInput(f"the request needs a number '{name}'.") from error
    require(bool(np.isfinite(value)), f"'{name}' must be finite.")
    return value


def _cut(surface: ResultSurface, query: Query, read: Reading | None = None) -> dict[str, Any]:
    x0, y0, x1, y1 = (_number(query, name) for name in ("x0", "y0", "x1", "y1"))
    try:
        cut = section(surface, (x0, y0), (x1, y1), read)
    except BadInput as error:
        return {"why_not": str(error)}
    step = max(1, len(cut.along_mm) // 4000)
    names = ("along_mm", "x_mm", "y_mm", "height_mm", "relief_um")
    return {**{name: _list(getattr(cut, name)[::step]) for name in names}, "figures": cut.figures}


def _list(values: Any) -> list[float | None]:
    return [round(float(value), 5) if np.isfinite(value) else None for value in values]


# What the page shows of a result: text and numbers.

_MARKS = (0x061C, 0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
_TURNING = dict.fromkeys(_MARKS, "\N{REPLACEMENT CHARACTER}")


def _shown(text: str) -> str:
    """Return a name as the page shows it: no mark in it turns the text around it to the left."""
    return text.translate(_TURNING)


def _listed(entry: CatalogueEntry) -> dict[str, Any]:
    """One line of the list."""
    subject = _mapping(_mapping(entry.report.get("capture")).get("subject"))
    return {
        "key": entry.key,
        "result": entry.result,
        "name": _shown(entry.name),
        "preset": _text(entry.report.get("preset")),
        "subject": _text(subject.get("id")),
        "finger": _text(subject.get("finger")).replace("_", " "),
        "session": _text(subject.get("session")),
        "warnings": len(_sequence(entry.report.get("warnings"))),
        "thumb": (entry.folder / "preview.png").is_file(),
    }


def _describe(entry: CatalogueEntry, surface: ResultSurface) -> dict[str, Any]:
    """All that the page needs of a result before it requests pieces of it."""
    return {
        **_listed(entry),
        "pitch_mm": surface.pitch_mm,
        "points": surface.count,
        "low_mm": surface.low_mm,
        "high_mm": surface.high_mm,
        "highest_relief_mm": surface.highest_relief_mm,
        "units": [surface.unit.name, surface.unit.small, surface.unit.small_per_mm],
        "relief_range_um": _relief_range_um(surface),
        "input_size": surface.size,
        "turn": surface.turn.tolist(),
        "tile": TILE,
        "strides": surface.strides,
        "tiles": {str(stride): surface.filled_tiles(stride) for stride in surface.strides},
        "pictures": [name for name in _PICTURES[:3] if (entry.folder / name).is_file()],
        "print": _print(entry),
        "photos": _photos(entry),
        "facts": _facts(entry, surface),
        "notes": [_text(note) for note in _sequence(entry.report.get("warnings"))],
    }


def _relief_range_um(surface: ResultSurface) -> float:
    """Relief that nearly all of the skin keeps within: the ends of the colour scale, um or 0.1 pixel."""
    step = max(1, round(0.1 / surface.pitch_mm)) if surface.unit.known else 4
    relief = np.abs(surface.ridge_mm[::step, ::step][surface.mask[::step, ::step]])
    widest = float(np.percentile(relief, 98)) if relief.size else 0.0
    finest = 1.0 if surface.unit.known else 0.1
    return max(finest, finest * float(np.ceil(surface.unit.small_per_mm * widest / finest)))


def _print(entry: CatalogueEntry) -> dict[str, Any] | None:
    try:
        file = print_of(entry.folder)
    except BadInput:
        return None
    return {"rows": file.image.shape[0], "columns": file.image.shape[1], "ppi": file.resolution_ppi or 500.0}


def _describe_photographs(entry: CatalogueEntry) -> dict[str, Any]:
    """All that the page needs of a folder of photographs. Raises BadInput if it cannot be read."""
    from splitknit.viewer.photographs import photographs_of

    found = photographs_of(entry.folder)
    return {
        **_listed(entry),
        "photos": _photos(entry),
        "facts": [(name, _shown(value)) for name, value in found.facts if value],
        "notes": [_shown(note) for note in found.notes],
        "command": _shown(found.command),
        "plain": found.plain,
    }


def _photos(entry: CatalogueEntry) -> list[dict[str, Any]]:
    if entry.capture is None:
        return []
    from splitknit.viewer.photographs import photographs_of  # the first view waits for no image library

    try:
        found = photographs_of(entry.capture).photos
    except BadInput:
        return []
    return [{"name": _shown(p.name), "band": p.band, "number": p.number, "light": p.light} for p in found]


def _facts(entry: CatalogueEntry, surface: ResultSurface) -> list[tuple[str, str]]:
    report, listed = entry.report, _listed(entry)
    about, software = _mapping(report.get("capture")), _mapping(report.get("software"))
    count = f"{surface.count:,}".replace(",", "\N{NO-BREAK SPACE}")
    size = [high - low for low, high in zip(surface.low_mm, surface.high_mm, strict=True)]
    known, what = surface.unit.known, "Surface" if about.get("material") == "opaque" else "Skin"
    wide, long, deep = (f"{one:.1f}" if known else f"{one:.0f}" for one in size)
    extent = f"{wide} x {long} x {deep} {'mm' if known else 'pixels, scale unknown'}"
    facts = [
        ("Preset", _text(report.get("preset"))),
        ("Size", f"{extent} (across, along, deep)"),
        (f"{what} in projection", f"{surface.count * surface.pitch_mm**2:.0f} mm²" if known else ""),
        ("Values", f"{count} heights, one every " + (f"{1000 * surface.pitch_mm:.1f} µm" if known else "pixel")),
        ("Material", _text(about.get("material"))),
        ("Finger", f"{listed['subject']} {listed['finger']}".strip()),
        ("Session", listed["session"]),
        ("Captured", _text(about.get("captured_at"))),
        ("Reconstructed", _text(report.get("written_at"))),
        ("Software", f"{_text(software.get('name'))} {_text(software.get('version'))}".strip()),
    ]
    return [(name, value) for name, value in facts if value]


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _sequence(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _text(value: Any) -> str:
    return _shown(str(value)[:300]) if isinstance(value, (str, int, float)) and not isinstance(value, bool) else ""
