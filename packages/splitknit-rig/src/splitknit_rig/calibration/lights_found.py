"""From a table of nail and shadow tips to facts about every LED, and to a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from splitknit import BadInput, Camera, Led, Rig
from splitknit.arguments import text_of
from splitknit.errors import require
from splitknit.imaging.view import plane_points
from splitknit.model import Array
from splitknit_rig.calibration.lights import (
    BANDS,
    LEDS_PER_BAND,
    Circle,
    LedEstimate,
    Tip,
    by_circle,
    listed,
    name_of_led,
    pixels,
)
from splitknit_rig.calibration.nail import STRAY_MM, JointFit, Nail, by_joint_fit
from splitknit_rig.calibration.words import light_lines

_BEYOND = 0.02
"""Part of the image's size by which a pixel may lie beyond its border: clicked beside the last pixel, not elsewhere."""
OK, DISAGREES, COPIED, UNCHECKED, STRAYS = "ok", "disagrees", "copied", "unchecked", "off the circle"
_TRUSTED = (OK, UNCHECKED)  # verdicts of LEDs that are used without a word from the user
LedName = tuple[str, int]
"""Band, and number in it."""


_COPY_MM = 0.4
"""Shadow tips of two nail positions nearer than this on the finger plane repeat; the thesis's copies lie up to 0.22."""
_MOVE_MM = 1.0  # nail positions that are nearer than this are one position
_SAME_NAIL_MM = 1.0  # the nail's pixel may differ so much between the rows of one position


@dataclass(frozen=True, slots=True)
class CalibratedLed:
    """Where an LED is, and how far that can be trusted."""

    band: str
    led: int
    direction: tuple[float, float, float]
    """Unit, towards the LED."""
    position_mm: tuple[float, float, float] | None
    """In the rig's frame; None for a distant light."""
    disagreement_deg: float | None
    """Largest angle between the directions of two nail positions; None where one was measured."""
    verdict: str
    """``ok``, ``disagrees``, ``copied``, ``off the circle``, ``unchecked``, or ``nominal`` for the drawing's."""
    kept: bool
    interval_deg: float | None = None
    """Half of the 95 % interval, of the joint fit; so `interval_mm`."""
    interval_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedLights:
    """Where the lights of a rig are."""

    method: str
    """``circle`` or ``joint`` (a nail's shadows), ``chrome`` or ``grey`` (a ball), or ``geometry`` (the drawing)."""
    leds: tuple[CalibratedLed, ...]
    rig: Rig
    """With these lights, as it is written."""
    warnings: tuple[str, ...]
    facts: Mapping[str, Any]
    """What ``splitknit calibrate lights`` prints as JSON: also each step, plain."""

    def __str__(self) -> str:
        return text_of(light_lines(self.facts))


@dataclass(frozen=True, slots=True)
class Rules:
    """How LEDs are found from a nail's shadows, and which are kept."""

    nail: Nail
    method: str | None = None  # ``circle`` or ``joint``; None: joint from so many nail positions
    joint_from: int = 3
    limit_deg: float = 5.0  # directions further apart are refused
    keep: bool = False  # keep LEDs that would be refused


def find_leds(
    tips: Sequence[Tip], camera: Camera, circle: Circle, rules: Rules, name: str
) -> tuple[dict[LedName, LedEstimate], dict[str, Any], str | None]:
    """Find and judge every LED of a table: LEDs, facts, and why they are refused (None: they are not).
    LEDs whose tips are copies keep the construction's place. Raises BadInput if the table is incomplete or impossible.
    """
    limit_deg, keep, nail = rules.limit_deg, rules.keep, rules.nail
    check_tips(tips, camera.image_size, name)
    try:
        check_nails(tips, camera)
        plain, height = by_circle(tips, camera, circle, known_height_mm=nail.height_mm)
        copied = copied_leds(tips, camera)
        sound = [tip for tip in tips if (tip.band, tip.led) not in copied]
        positions = len({tip.nail for tip in tips})
        joint = by_joint_fit(sound, camera, circle, nail) if positions > 1 and sound else None
    except BadInput as error:
        raise BadInput(f"{name}: {error}") from error
    require(
        rules.method != "joint" or positions > 1, f"{name} has one nail position, but the joint fit needs two at least."
    )
    method = rules.method or ("joint" if positions >= rules.joint_from else "circle")
    used = joint if method == "joint" else None
    first = {(one.band, one.led): one for one in plain}
    chosen = first if used is None else first | {(one.band, one.led): one for one in used.leds}
    verdicts = judge(chosen, copied, frozenset() if used is None else used.strays, limit_deg)
    sentence = refusal(verdicts, chosen, limit_deg)
    leds = []
    fitted: dict[LedName, dict[str, Any]] = {}
    if joint is not None:
        bounds = zip(joint.leds, joint.interval_deg.tolist(), joint.interval_mm.tolist(), strict=True)
        fitted = {(e.band, e.led): {**_place(e), "interval_deg": deg, "interval_mm": mm} for e, deg, mm in bounds}
    for (band, led), best in chosen.items():
        place, verdict = fitted.get((band, led)), verdicts[band, led]
        spread = place if place is not None and used is not None else {}
        leds.append(
            {
                "band": band,
                "led": led,
                **_place(best),
                **{name: spread.get(name) for name in ("interval_deg", "interval_mm")},
                "verdict": verdict,
                "kept": keep or verdict in _TRUSTED,
            }
        )
    facts: dict[str, Any] = {
        "method": method,
        "limit_deg": limit_deg,
        "nail_positions": positions,
        "nail_height_mm": height if used is None else used.nail_height_mm,
        "leds": leds,
        "warnings": _warnings(verdicts, used, sound) + ([f"kept although {sentence}"] if keep and sentence else []),
        "refused": None if keep else sentence,
    }
    return chosen, facts, None if keep else sentence


def rig_of(found: Mapping[LedName, LedEstimate], base: Rig, provenance: Mapping[str, Any]) -> Rig:
    """Return `base` with the LEDs where they were found; what it knows beside their places is kept."""
    places = {
        name: (float(one.position_mm[0]), float(one.position_mm[1]), float(one.position_mm[2]))
        for name, one in found.items()
    }
    leds: list[Led] = []
    counted = dict.fromkeys(BANDS, 0)
    for led in base.leds:
        number = counted.get(led.band, 0)
        counted[led.band] = number + 1
        place = places.pop((led.band, number), None)
        leds.append(led if place is None else replace(led, position_mm=place, direction=None))
    ordered = sorted(places.items(), key=lambda item: (BANDS.index(item[0][0]), item[0][1]))
    leds += [Led(band=band, position_mm=place) for (band, _), place in ordered]
    return replace(base, leds=tuple(leds), provenance={**base.provenance, "lights": dict(provenance)})


def _place(found: LedEstimate) -> dict[str, Any]:
    return {
        "direction": found.direction.tolist(),
        "position_mm": found.position_mm.tolist(),
        "disagreement_deg": found.disagreement_deg,
    }


def _warnings(verdicts: Mapping[LedName, str], joint: JointFit | None, tips: Sequence[Tip]) -> list[str]:
    warnings = []
    if UNCHECKED in verdicts.values():
        warnings.append(
            "the nail stood in one place only, so that nothing checks the directions; photograph it in a second place."
        )
    if joint is not None and joint.outliers:
        astray = [f"{tips[row].name} ({np.linalg.norm(joint.residual_px[row]):.0f} px)" for row in joint.outliers]
        warnings.append(
            f"these shadow tips lie far from where all others put them and were given little weight: "
            f"{', '.join(astray)}."
        )
    bands = {band for band, _ in verdicts}
    if len(verdicts) == LEDS_PER_BAND and len(bands) == 1:
        warnings.append(f"the table has {min(bands)} LEDs only.")
    return warnings


def check_tips(tips: Sequence[Tip], image_size: tuple[int, int], name: str = "the table") -> None:
    """Check that each band has all seven LEDs, each at two nail positions (or the only one), pixels in the image."""
    rows, columns = image_size
    for tip in tips:
        for what, (x, y) in (("nail", tip.nail_px), ("shadow's tip", tip.tip_px)):
            inside = -_BEYOND * columns <= x <= (1 + _BEYOND) * columns and -_BEYOND * rows <= y <= (1 + _BEYOND) * rows
            require(
                inside,
                f"{name}: {tip.name}: the {what} at x = {x:g}, y = {y:g} lies outside the image of {columns} columns "
                f"and {rows} rows; correct the row, or the image size (rows, columns).",
            )
    nails = sorted({tip.nail for tip in tips})
    for band in [band for band in BANDS if any(tip.band == band for tip in tips)]:
        present = {(tip.led, tip.nail) for tip in tips if tip.band == band}
        absent = [led for led in range(LEDS_PER_BAND) if not any(led == one for one, _ in present)]
        require(
            not absent,
            f"{name} has no row for {' and '.join(name_of_led(band, led) for led in absent)}; every LED from 0 to "
            f"{LEDS_PER_BAND - 1} of a band that occurs needs its rows.",
        )
        for led in range(LEDS_PER_BAND):
            seen = [nail for nail in nails if (led, nail) in present]
            lost = [str(nail) for nail in nails if nail not in seen]
            require(
                len(seen) >= min(2, len(nails)),
                f"{name} has {name_of_led(band, led)} at nail {seen[0]} only, and not at nail {' and '.join(lost)}; "
                f"add the row, because one position cannot be checked.",
            )


def copied_leds(tips: Sequence[Tip], camera: Camera) -> set[LedName]:
    """LEDs whose shadow tips repeat although the nail moved: copying errors."""
    nails, ends = (plane_points(camera, part) for part in pixels(tips))
    found = set()
    for i, j in combinations(range(len(tips)), 2):
        moved, apart = (float(np.linalg.norm(places[i] - places[j])) for places in (nails, ends))
        same = (tips[i].band, tips[i].led) == (tips[j].band, tips[j].led)
        if same and apart <= _COPY_MM and moved > _MOVE_MM:
            found.add((tips[i].band, tips[i].led))
    return found


def check_nails(tips: Sequence[Tip], camera: Camera) -> None:
    """Check that a nail number is one place, and two numbers two places."""
    nails = plane_points(camera, pixels(tips)[0])
    middles: dict[tuple[str, int], Array] = {}
    for band, nail in dict.fromkeys((tip.band, tip.nail) for tip in tips):
        places = nails[[(tip.band, tip.nail) == (band, nail) for tip in tips]]
        middle = np.median(places, axis=0)
        spread = float(np.linalg.norm(places - middle, axis=1).max())
        require(
            spread <= _SAME_NAIL_MM,
            f"nail {nail} of the {band} LEDs stands at places {spread:.1f} mm from each other; a nail number is one "
            f"position, so correct its pixels or give each position a number of its own.",
        )
        middles[band, nail] = middle
    for ((band, nail), middle), ((other_band, other), place) in combinations(
        sorted(middles.items(), key=lambda one: one[0]), 2
    ):
        distance = float(np.linalg.norm(middle - place))
        require(
            band != other_band or distance > _MOVE_MM,
            f"nails {nail} and {other} of the {band} LEDs stand {distance:.2f} mm from each other, which is one "
            f"position; move the nail by a centimetre between them, or correct its pixels.",
        )


def judge(
    found: Mapping[LedName, LedEstimate], copied: Set[LedName], strays: Set[LedName], limit_deg: float
) -> dict[LedName, str]:
    """Verdict of every LED, the first that holds; ``unchecked`` is an LED that one position of the nail shows."""

    def verdict(name: LedName, apart_deg: float | None) -> str:
        if name in copied:
            return COPIED
        if name in strays:
            return STRAYS
        if apart_deg is None:
            return UNCHECKED
        return DISAGREES if apart_deg > limit_deg else OK

    return {name: verdict(name, one.disagreement_deg) for name, one in found.items()}


def refusal(verdicts: Mapping[LedName, str], found: Mapping[LedName, LedEstimate], limit_deg: float) -> str | None:
    """One sentence that names every LED that is refused and what to do; None where there is none."""
    named: dict[str, list[str]] = {}
    for name, word in verdicts.items():
        apart = f" ({found[name].disagreement_deg:.1f} deg)" if word == DISAGREES else ""
        named.setdefault(word, []).append(name_of_led(*name) + apart)
    words = {
        DISAGREES: f"two nail positions disagree by more than {limit_deg:g} deg about {{}}",
        COPIED: "the shadow tips of {} are copies: they repeat although the nail moved",
        STRAYS: f"{{}} would stand more than {STRAY_MM:g} mm outside or inside the LED circle",
    }
    parts = [text.format(listed(named[word])) for word, text in words.items() if word in named]
    remedy = "correct the pixels or photograph the nail again under these LEDs, or keep them as they are (`keep`)."
    return f"{', and '.join(parts)}; {remedy}" if parts else None
