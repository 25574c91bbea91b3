"""From a table of nail and shadow tips to the position of every LED, a verdict on it, and a rig."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence, Set
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, Camera, Led, Rig
from splitknit.arguments import text_of
from splitknit.errors import Refused, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.imaging.view import plane_points
from splitknit.io.provenance import plain_json, provenance
from splitknit.model import Array
from splitknit.nominal import side_lights
from splitknit_rig.calibration.lights import (
    BANDS,
    LEDS_PER_BAND,
    CalibratedLed,
    Circle,
    Tip,
    by_circle,
    led_name,
    listed,
    name_of_led,
    pixels,
)
from splitknit_rig.calibration.nail import STRAY_LED_MM, JointFit, Nail, by_joint_fit

LedName = tuple[str, int]
"""Band, and number in it."""
OK, DISAGREES, COPIED, UNCHECKED, STRAYS = (
    "ok",
    "disagrees",
    "copied",
    "unchecked",
    "off the circle",
)


@dataclass(frozen=True, eq=False)
class CalibratedLights(ABC):
    """Positions of a rig's lights."""

    method: str
    """``circle`` or ``joint`` (a nail's shadows), ``chrome`` or ``grey`` (a ball)."""
    leds: tuple[CalibratedLed, ...]
    rig: Rig
    """The rig with these lights, as written."""
    findings: tuple[Finding, ...] = ()
    out: Path | None = None
    """The file that was written."""

    @property
    def facts(self) -> Any:
        """What ``splitknit calibrate lights`` prints as JSON."""
        document = {field: value for field, value in vars(self).items() if field != "rig"}
        findings = [finding.facts for finding in self.findings]
        return plain_json({**document, "findings": findings, "written": self.out is not None})

    @abstractmethod
    def lines(self) -> list[str]:
        """Lines of text that report what was measured."""

    def written_line(self) -> str:
        """Line that names the file that was written, or says how to get one."""
        if self.out is not None:
            return f"Written to {self.out}."
        return (
            "Nothing was written; name a rig file (.json) or a list of lights (.txt) with `out`"
            " FILE."
        )

    def __str__(self) -> str:
        return text_of(self.lines())


@dataclass(frozen=True, eq=False)
class LightsOfNail(CalibratedLights):
    """Lights measured with the shadows of a nail."""

    limit_deg: float = 0.0
    nail_positions: int = 0
    nail_height_mm: float | None = None
    circle: Circle | None = None
    refused: str | None = None
    """Why LEDs are refused and nothing is written."""
    show: Path | None = None
    """Picture of the tips in photographs."""
    tips_out: Path | None = None
    """Table of the tips in photographs."""
    shadows_out_of_the_picture: tuple[str, ...] = ()

    def lines(self) -> list[str]:
        """See :meth:`CalibratedLights.lines`."""
        lines = [
            f"{len(self.leds)} LEDs from {self.nail_positions} nail position(s), method"
            f" {self.method}:"
        ]
        for led in self.leds:
            x, y, z = led.direction
            apart = "      -" if led.disagreement_deg is None else f"{led.disagreement_deg:7.2f}"
            bound = "" if led.interval_deg is None else f" +-{led.interval_deg:.2f} deg"
            lines.append(
                f"  {led.band:5s} {led.led}  towards ({x:+.4f}, {y:+.4f}, {z:+.4f}){bound},"
                f" positions disagree by {apart} deg:"
                f" {led.verdict}{'' if led.kept else ', left out'}"
            )
        if self.nail_height_mm is not None:
            lines.append(f"The nail is {self.nail_height_mm:.1f} mm high, from its shadows.")
        lines += [f"Please note: {finding}" for finding in self.findings]
        lines.append(self.written_line())
        if self.show:
            lines.append(
                f"Please look at {self.show}: nail (cross), shadow tip (ring), ray to the LED"
                " (line)."
            )
        if self.tips_out:
            lines.append(f"Correct {self.tips_out} where it is wrong, and give it to `table`.")
        return lines


@dataclass(frozen=True, slots=True)
class Rules:
    """How LEDs are estimated from a nail's shadows, and which are kept."""

    nail: Nail
    method: str | None = None  # ``circle`` or ``joint``; None: joint from so many nail positions
    joint_from: int = 3
    limit_deg: float = 5.0  # directions further apart are refused
    keep: bool = False  # keep LEDs that would be refused


def lights_of_tips(
    tips: Sequence[Tip],
    base: Rig,
    circle: Circle,
    rules: Rules,
    hashes: Mapping[str, str],
    *,
    name: str,
) -> LightsOfNail:
    """Find and judge every LED of a table, of SHA-256 `hashes` by file. LEDs whose tips are copies
    keep their position from the thesis's construction. Raises BadInput if the table is incomplete
    or impossible, Refused if an LED must be refused.
    """
    camera = base.camera
    check_tips(tips, camera.image_size, name)
    positions = len({tip.nail for tip in tips})
    method = rules.method or ("joint" if positions >= rules.joint_from else "circle")
    joint = None
    try:
        check_nails(tips, camera)
        by_hand, height = by_circle(tips, camera, circle, known_height_mm=rules.nail.height_mm)
        copied = copied_leds(tips, camera)
        sound = [tip for tip in tips if tip.lit not in copied]
        if method == "joint":
            require(
                positions > 1, "one nail position is there, but the joint fit needs two at least."
            )
            joint = by_joint_fit(sound, camera, circle, rules.nail) if sound else None
    except BadInput as error:
        raise BadInput(f"{name}: {error}") from error
    estimates = {(led.band, led.led): led for led in by_hand}
    strays: frozenset[LedName] = frozenset()
    if joint is not None:
        estimates |= {(led.band, led.led): led for led in joint.leds}
        strays = joint.strays
        height = joint.nail_height_mm
    verdicts = judge(estimates, copied, strays, rules.limit_deg)
    sentence = refusal(verdicts, estimates, rules.limit_deg)
    leds = []
    for led, estimate in estimates.items():
        kept = rules.keep or verdicts[led] in (OK, UNCHECKED)
        leds.append(replace(estimate, verdict=verdicts[led], kept=kept))
    findings = _findings(verdicts, joint, sound)
    if rules.keep and sentence:
        findings.append(Finding("kept-leds", f"kept although {sentence}", Severity.DOUBT))
    origin = provenance(
        {"method": method, "circle": circle, "limit_deg": rules.limit_deg, "nail": rules.nail},
        hashes,
    )
    stored = ("band", "led", "verdict", "disagreement_deg", "interval_deg", "interval_mm")
    judged = [{field: asdict(led)[field] for field in stored} for led in leds]
    rig = rig_of(estimates, base, {"leds": plain_json(judged), "provenance": plain_json(origin)})
    beside = [led_name(rig.leds, k) for k in side_lights(rig.leds)]
    if beside:
        note = (
            f"the side lights {listed(beside)} keep the places that the rig file had; a ball"
            " measures them"
        )
        findings.append(Finding("side-lights-kept", note))
    lights = LightsOfNail(
        method,
        tuple(leds),
        rig,
        worst_first(findings),
        limit_deg=rules.limit_deg,
        nail_positions=positions,
        nail_height_mm=height,
        circle=circle,
        refused=None if rules.keep else sentence,
    )
    if lights.refused:
        raise Refused(f"{name}: {sentence}", lights.facts)
    return lights


def rig_of(
    estimates: Mapping[LedName, CalibratedLed], base: Rig, provenance: Mapping[str, Any]
) -> Rig:
    """Return `base` with the estimated positions of the LEDs; all else is kept."""
    places = {name: estimate.position_mm for name, estimate in estimates.items()}
    leds: list[Led] = []
    for led in base.leds:
        number = sum(earlier.band == led.band for earlier in leds)
        place = places.pop((led.band, number), None)
        leds.append(led if place is None else replace(led, position_mm=place, direction=None))
    ordered = sorted(places.items(), key=lambda item: (BANDS.index(item[0][0]), item[0][1]))
    leds += [Led(band=band, position_mm=place) for (band, _), place in ordered]
    return replace(
        base, leds=tuple(leds), provenance={**base.provenance, "lights": dict(provenance)}
    )


def _findings(
    verdicts: Mapping[LedName, str], joint: JointFit | None, tips: Sequence[Tip]
) -> list[Finding]:
    findings = []
    if UNCHECKED in verdicts.values():
        words = (
            "the nail stood in one place only, so that nothing checks the directions; photograph it"
            " in a second place."
        )
        findings.append(Finding("one-nail-position", words))
    if joint is not None and joint.outliers:
        astray = [
            f"{tips[row].name} ({np.linalg.norm(joint.residual_px[row]):.0f} px)"
            for row in joint.outliers
        ]
        words = (
            "these shadow tips lie far from where all others put them and were given little"
            f" weight: {', '.join(astray)}."
        )
        findings.append(Finding("stray-tips", words))
    bands = {band for band, _ in verdicts}
    if len(bands) == 1:
        findings.append(Finding("one-band", f"the table has {min(bands)} LEDs only."))
    return findings


_BEYOND_BORDER = 0.02
"""Fraction of the image's size: a click just beyond the last pixel is accepted."""


def check_tips(tips: Sequence[Tip], image_size: tuple[int, int], name: str = "the table") -> None:
    """Check that each band has all seven LEDs, each at two nail positions (or the only one), and
    that pixels lie in the image."""
    rows, columns = image_size
    for tip in tips:
        for what, (x, y) in (("nail", tip.nail_px), ("shadow's tip", tip.tip_px)):
            inside = (
                -_BEYOND_BORDER <= x / columns <= 1 + _BEYOND_BORDER
                and -_BEYOND_BORDER <= y / rows <= 1 + _BEYOND_BORDER
            )
            require(
                inside,
                f"{name}: {tip.name}: the {what} at x = {x:g}, y = {y:g} lies outside the image of"
                f" {columns} columns and {rows} rows; correct the row, or the image size (rows,"
                " columns).",
            )
    nails = sorted({tip.nail for tip in tips})
    for band in dict.fromkeys(tip.band for tip in tips):
        absent = [
            name_of_led(band, k)
            for k in range(LEDS_PER_BAND)
            if (band, k) not in {t.lit for t in tips}
        ]
        require(
            not absent,
            f"{name} has no row for {' and '.join(absent)}; every LED from 0 to {LEDS_PER_BAND - 1}"
            " of a band that occurs needs its rows.",
        )
        for led in range(LEDS_PER_BAND):
            present = [tip.nail for tip in tips if tip.lit == (band, led)]
            lost = [str(nail) for nail in nails if nail not in present]
            require(
                len(present) >= min(2, len(nails)),
                f"{name} has {name_of_led(band, led)} at nail {present[0]} only, and not at nail"
                f" {' and '.join(lost)}; add the row, because one position cannot be checked.",
            )


_COPY_MM = 0.4
"""Tips of two nail positions that lie nearer to each other on the finger plane are copies; those of
the thesis lie up to 0.22 mm apart. Chosen on: real photographs (the thesis's own table)."""
_MOVE_MM = 1.0  # nail positions that are nearer are one position


def copied_leds(tips: Sequence[Tip], camera: Camera) -> set[LedName]:
    """LEDs whose shadow tips repeat although the nail moved: copying errors."""
    nails, ends = (plane_points(camera, part) for part in pixels(tips))
    copied = set()
    for i, j in combinations(range(len(tips)), 2):
        moved, apart = (float(np.linalg.norm(places[i] - places[j])) for places in (nails, ends))
        if tips[i].lit == tips[j].lit and apart <= _COPY_MM and moved > _MOVE_MM:
            copied.add(tips[i].lit)
    return copied


def check_nails(tips: Sequence[Tip], camera: Camera) -> None:
    """Check that a nail number stands for one position, and two numbers for two."""
    nails = plane_points(camera, pixels(tips)[0])
    middles: dict[tuple[str, int], Array] = {}
    for band, nail in dict.fromkeys((tip.band, tip.nail) for tip in tips):
        places = nails[[(tip.band, tip.nail) == (band, nail) for tip in tips]]
        middle = np.median(places, axis=0)
        spread = float(np.linalg.norm(places - middle, axis=1).max())
        require(
            spread <= 1.0,  # mm
            f"nail {nail} of the {band} LEDs stands at places {spread:.1f} mm from each other; a"
            " nail number is one position, so correct its pixels or give each position a number of"
            " its own.",
        )
        middles[band, nail] = middle
    for first, second in combinations(sorted(middles), 2):
        distance = float(np.linalg.norm(middles[first] - middles[second]))
        require(
            first[0] != second[0] or distance > _MOVE_MM,
            f"nails {first[1]} and {second[1]} of the {first[0]} LEDs stand {distance:.2f} mm from"
            " each other, which is one position; move the nail by a centimetre between them, or"
            " correct its pixels.",
        )


def judge(
    estimates: Mapping[LedName, CalibratedLed],
    copied: Set[LedName],
    strays: Set[LedName],
    limit_deg: float,
) -> dict[LedName, str]:
    """Verdict on every LED, the first that applies; ``unchecked`` is an LED that was measured with
    one position of the nail."""
    verdicts = {}
    for name, estimate in estimates.items():
        apart_deg = estimate.disagreement_deg
        if name in copied:
            verdicts[name] = COPIED
        elif name in strays:
            verdicts[name] = STRAYS
        elif apart_deg is None:
            verdicts[name] = UNCHECKED
        else:
            verdicts[name] = DISAGREES if apart_deg > limit_deg else OK
    return verdicts


def refusal(
    verdicts: Mapping[LedName, str], estimates: Mapping[LedName, CalibratedLed], limit_deg: float
) -> str | None:
    """One sentence that names every refused LED and what to do; None if none is refused."""
    named: dict[str, list[str]] = {}
    for name, verdict in verdicts.items():
        apart = f" ({estimates[name].disagreement_deg:.1f} deg)" if verdict == DISAGREES else ""
        named.setdefault(verdict, []).append(name_of_led(*name) + apart)
    sentences = {
        DISAGREES: f"two nail positions disagree by more than {limit_deg:g} deg about {{}}",
        COPIED: "the shadow tips of {} are copies: they repeat although the nail moved",
        STRAYS: f"{{}} would stand more than {STRAY_LED_MM:g} mm outside or inside the LED circle",
    }
    parts = [
        text.format(listed(named[verdict]))
        for verdict, text in sentences.items()
        if verdict in named
    ]
    remedy = (
        "correct the pixels or photograph the nail again under these LEDs, or keep them as they are"
        " (`keep`)."
    )
    return f"{', and '.join(parts)}; {remedy}" if parts else None
