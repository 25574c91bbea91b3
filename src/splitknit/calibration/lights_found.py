"""From a table of nail and shadow tips to facts about every LED, and to a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from splitknit.calibration.light_table import (
    BANDS,
    LEDS_PER_BAND,
    Judged,
    LightLimits,
    Tip,
    check_nails,
    check_tips,
    copied_leds,
    judge,
    refusal,
)
from splitknit.calibration.lights import Circle, LedEstimate, by_circle
from splitknit.calibration.nail import STRAY_MM, JointFit, NailSettings, by_joint_fit
from splitknit.errors import BadInput, require
from splitknit.model import Camera, Led, Rig

METHODS = ("circle", "joint")
LedName = tuple[str, int]


@dataclass(frozen=True, slots=True)
class LightSettings:
    """All settings of the calibration of lights, for ``--set``."""

    limits: LightLimits = field(default_factory=LightLimits)
    nail: NailSettings = field(default_factory=NailSettings)


@dataclass(frozen=True, slots=True, eq=False)
class LightCalibration:
    """What was found."""

    method: str
    judged: tuple[Judged, ...]
    chosen: Mapping[LedName, LedEstimate]
    facts: dict[str, Any]
    """For ``--json``."""
    sentence: str | None
    """Why it is refused, None where it is not."""


def calibrate_lights(
    tips: Sequence[Tip],
    camera: Camera,
    circle: Circle,
    *,
    name: str,
    method: str | None = None,
    settings: LightSettings | None = None,
    keep: bool = False,
    calibrated: bool = False,
) -> LightCalibration:
    """Find and judge every LED of a table.

    `method` None is the joint fit for three positions of the nail or more (two, with a `calibrated` camera), and else
    the thesis's construction. The joint fit leaves LEDs out whose tips are copies; they keep the construction's place.

    Raises
    ------
    BadInput
        If the table `name` is incomplete or impossible, see :func:`check_tips`, :func:`check_nails`, :func:`by_circle`.
    """
    settings = settings or LightSettings()
    check_tips(tips, camera.image_size, name)
    try:
        check_nails(tips, camera, settings.limits)
        known, seen = settings.nail.nail_height_mm, settings.nail.nail_seen
        plain, height = by_circle(tips, camera, circle, known_height_mm=known, seen=seen)
        copied = copied_leds(tips, camera, settings.limits)
        sound = [tip for tip in tips if (tip.band, tip.led) not in copied]
        positions = len({tip.nail for tip in tips})
        joint = by_joint_fit(sound, camera, circle, settings.nail) if positions > 1 and sound else None
    except BadInput as error:
        raise BadInput(f"{name}: {error}") from error
    require(method != "joint" or positions > 1, f"{name} has one nail position, but the joint fit needs two at least.")
    method = method or ("joint" if positions > (1 if calibrated else 2) else "circle")
    chosen: dict[LedName, LedEstimate] = {(one.band, one.led): one for one in plain}
    if method == "joint" and joint is not None:
        chosen |= {(one.band, one.led): one for one in joint.leds}
    strays = joint.strays if joint is not None and method == "joint" else frozenset()
    found = [(band, led, one.disagreement_deg) for (band, led), one in chosen.items()]
    judged = judge(found, copied, strays, settings.limits.limit_deg)
    sentence = refusal(judged, settings.limits.limit_deg, STRAY_MM)
    by_name = {(one.band, one.led): one for one in plain}
    leds = [_led_facts(one, chosen, by_name, joint, keep=keep) for one in judged]
    facts: dict[str, Any] = {
        "method": method,
        "limit_deg": settings.limits.limit_deg,
        "nail_positions": positions,
        "nail_height_mm": joint.nail_height_mm if method == "joint" and joint is not None else height,
        "leds": leds,
        "totals": _totals(judged, leds),
        "joint": None if joint is None else _joint_facts(joint, sound),
        "warnings": _warnings(judged, joint, sound, method)
        + ([f"kept although {sentence}"] if keep and sentence else []),
        "refused": None if keep else sentence,
    }
    return LightCalibration(method, judged, chosen, facts, None if keep else sentence)


def rig_of(
    found: Mapping[LedName, LedEstimate], camera: Camera, base: Rig | None, provenance: Mapping[str, Any]
) -> Rig:
    """Return a rig with the LEDs where they were found; what `base` knows beside their places is kept."""
    places = {
        name: (float(one.position_mm[0]), float(one.position_mm[1]), float(one.position_mm[2]))
        for name, one in found.items()
    }
    leds: list[Led] = []
    counted = dict.fromkeys(BANDS, 0)
    for led in base.leds if base is not None else ():
        number = counted.get(led.band, 0)
        counted[led.band] = number + 1
        place = places.pop((led.band, number), None)
        leds.append(led if place is None else replace(led, position_mm=place, direction=None))
    leds += [Led(band=band, position_mm=place) for (band, _), place in sorted(places.items(), key=_order)]
    before = dict(base.provenance) if base is not None else {}
    mirrors = base.mirrors if base is not None else ()
    return Rig(camera, tuple(leds), {**before, "lights": dict(provenance)}, mirrors)


def _led_facts(
    judged: Judged,
    chosen: Mapping[LedName, LedEstimate],
    plain: Mapping[LedName, LedEstimate],
    joint: JointFit | None,
    *,
    keep: bool,
) -> dict[str, Any]:
    name = (judged.band, judged.led)
    best, first = chosen[name], plain[name]
    fitted = None
    if joint is not None:
        places = [k for k, one in enumerate(joint.leds) if (one.band, one.led) == name]
        if places:
            one = joint.leds[places[0]]
            fitted = {
                "direction": one.direction.tolist(),
                "position_mm": one.position_mm.tolist(),
                "disagreement_deg": one.disagreement_deg,
                "interval_deg": float(joint.interval_deg[places[0]]),
                "interval_mm": float(joint.interval_mm[places[0]]),
            }
    by_fit = fitted is not None and best is not first
    return {
        "band": judged.band,
        "led": judged.led,
        "direction": best.direction.tolist(),
        "position_mm": best.position_mm.tolist(),
        "disagreement_deg": judged.disagreement_deg,
        "interval_deg": fitted["interval_deg"] if by_fit and fitted else None,
        "interval_mm": fitted["interval_mm"] if by_fit and fitted else None,
        "verdict": judged.verdict,
        "kept": keep or not judged.refused,
        "nails": list(best.nails),
        "circle": {
            "direction": first.direction.tolist(),
            "position_mm": first.position_mm.tolist(),
            "disagreement_deg": first.disagreement_deg,
            "positions_mm": first.singles.tolist(),
        },
        "joint": fitted,
    }


def _joint_facts(joint: JointFit, tips: Sequence[Tip]) -> dict[str, Any]:
    return {
        "nail_height_mm": joint.nail_height_mm,
        "nail_height_interval_mm": joint.nail_height_interval_mm,
        "circle": {
            "radius_mm": joint.circle.radius_mm,
            "height_mm": joint.circle.height_mm,
            "centre_mm": list(joint.circle.centre_mm),
        },
        "rms_px": None if np.isnan(joint.rms_px) else joint.rms_px,
        "tips": [
            {"band": tip.band, "led": tip.led, "nail": tip.nail, "residual_px": residual.tolist(), "outlier": bool(out)}
            for tip, residual, out in zip(
                tips, joint.residual_px, np.isin(np.arange(len(tips)), joint.outliers), strict=True
            )
        ],
    }


def _totals(judged: Sequence[Judged], leds: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    words = [one.verdict for one in judged]
    return {
        "leds": len(judged),
        "ok": words.count("ok"),
        "disagrees": words.count("disagrees"),
        "copied": words.count("copied"),
        "off_the_circle": words.count("off the circle"),
        "unchecked": words.count("unchecked"),
        "refused": sum(one.refused for one in judged),
        "kept": sum(one["kept"] for one in leds),
    }


def _warnings(judged: Sequence[Judged], joint: JointFit | None, tips: Sequence[Tip], method: str) -> list[str]:
    warnings = []
    if any(one.verdict == "unchecked" for one in judged):
        warnings.append(
            "the nail stood in one place only, so that nothing checks the directions; photograph it in a second place."
        )
    if joint is not None and joint.outliers and method == "joint":
        astray = ", ".join(
            f"{tips[row].name} ({np.linalg.norm(joint.residual_px[row]):.0f} px)" for row in joint.outliers
        )
        warnings.append(
            f"these shadow tips lie far from where all others put them and were given little weight: {astray}."
        )
    bands = {one.band for one in judged}
    if len(judged) == LEDS_PER_BAND and len(bands) == 1:
        warnings.append(f"the table has {min(bands)} LEDs only.")
    return warnings


def _order(item: tuple[LedName, Any]) -> tuple[int, int]:
    return BANDS.index(item[0][0]), item[0][1]
