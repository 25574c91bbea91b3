"""Light on eye and skin: what the LEDs give at the drawn distances against the limits of IEC
62471:2006.

A calculation from data sheets, no measurement and no certificate. It takes the worst that can
happen without an optical instrument: an eye in the middle of the finger plane that looks into the
LEDs for 30,000 s, beyond which no limit of the exempt group falls (6.1.1); all LEDs are on, on
their axes, at the largest current of all tolerances. Formulas and assumptions:
``docs/guide/rig-safety.md``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from hardware.sizes import Array
from hardware.stages import Stage
from splitknit.errors import require
from splitknit.model import Rig
from splitknit_simulator.light.films import side_lights

# where lamps that light no rooms are judged (6.1); nearer where the drawing is nearer
EYE_DISTANCE_MM = 200.0
# longest time that the skin's limit is stated for (4.3.8): after it, heat hurts and the hand
# withdraws
_SKIN_EXPOSURE_S = 10.0
# largest angle of a source that counts, rad (4.2.2): larger ones heat the retina no more
_ALPHA_MAX = 0.1
_ALPHA_EFF = 0.011  # angle that eye movements spread a point over within 10 to 100 s, rad (4.2.2)
_KM = 683.0  # lumens of a watt at 555 nm
_WAVELENGTHS_NM = np.arange(300.0, 3001.0)
# IEC 62471:2006, table 4.2: the blue-light hazard from 380 to 500 nm; the burn hazard is ten times
# as large there
_TABLE_NM = np.arange(380.0, 501.0, 5.0)
_TABLE_B = np.array(
    [
        0.01,
        0.013,
        0.025,
        0.05,
        0.1,
        0.2,
        0.4,
        0.8,
        0.9,
        0.95,
        0.98,
        1.0,
        1.0,
        0.97,
        0.94,
        0.9,
        0.8,
        0.7,
        0.62,
        0.55,
        0.45,
        0.4,
        0.22,
        0.16,
        0.1,
    ]
)


def blue_weight(nm: Array) -> Array:
    """Return the blue-light hazard function B at wavelengths in nm (same shape; IEC 62471:2006,
    table 4.2)."""
    short = np.interp(nm, _TABLE_NM, _TABLE_B)
    middle = 10.0 ** ((450.0 - nm) / 50.0)
    long = np.where((nm > 600) & (nm <= 700), 0.001, 0.0)
    return np.where(nm < 300, 0.0, np.where(nm <= 500, short, np.where(nm <= 600, middle, long)))


def burn_weight(nm: Array) -> Array:
    """Return the burn hazard function R at wavelengths in nm (same shape; IEC 62471:2006, table
    4.2)."""
    short = np.maximum(10.0 * np.interp(nm, _TABLE_NM, _TABLE_B), np.where(nm > 495, 1.0, 0.0))
    near = 10.0 ** ((700.0 - nm) / 500.0)
    far = 0.2 * 10.0 ** (0.02 * (1150.0 - nm))
    bounds = [nm < 380, nm <= 500, nm <= 700, nm <= 1050, nm <= 1150, nm <= 1200, nm <= 1400]
    return np.select(
        bounds,
        [np.zeros_like(nm), short, np.ones_like(nm), near, np.full_like(nm, 0.2), far, 0.02],
        0.0,
    )


def _bell(middle_nm: float, sigma_nm: float) -> Array:
    bell = np.exp(-0.5 * ((_WAVELENGTHS_NM - middle_nm) / sigma_nm) ** 2)
    return np.asarray(bell / bell.sum())


_SPECTRA: Mapping[str, Array] = {
    # blue chip and phosphor: 7900 K, 1.03 mW of blue-light hazard a lumen, the upper end of cool
    # white
    "white": 0.3 * _bell(450.0, 10.0) + 0.7 * _bell(560.0, 52.0),
    "nir": _bell(850.0, 17.0),
}
"""Fraction of an LED's light in each nm from 300 to 3000."""


def _luminous(nm: Array) -> Array:
    """V of CIE 1924, as two lobes (C. Wyman, P.-P. Sloan, P. Shirley, JCGT 2 (2), 2013, equation
    4)."""

    def lobe(middle: float, below: float, above: float) -> Array:
        bell: Array = np.exp(-0.5 * ((nm - middle) * np.where(nm < middle, below, above)) ** 2)
        return bell

    return 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)


@dataclass(frozen=True, slots=True)
class Hazard:
    """One hazard of the standard, its value and its limit."""

    band: str  # ``white``, ``nir``, ``side`` or ``all`` LEDs
    name: str
    clause: str  # clause of IEC 62471:2006
    value: float
    limit: float
    unit: str

    @property
    def margin(self) -> float:
        """Limit over value; infinite where there is no such light."""
        return self.limit / self.value if self.value > 0 else float("inf")


def radiant_intensity(part: SimpleNamespace, band: str) -> float:
    """Return an LED's radiant intensity on its axis at its data sheet's current, W/sr; BadInput if
    the data lack it."""
    which, cd, w_sr = f"the {band} LED's", part.intensity_cd, part.intensity_w_sr
    require(
        (cd > 0) != (w_sr > 0)
        and cd >= 0
        and w_sr >= 0
        and np.isfinite(cd + w_sr)
        and (band == "white" or cd == 0),
        f"{which} intensity must be given once, as circuit.{band}.intensity_w_sr"
        + (" or circuit.white.intensity_cd" if band == "white" else "")
        + f" above 0 and 0 for the other, but it is {w_sr:g} W/sr and {cd:g} cd.",
    )
    require(
        0 < part.half_angle_deg < 90 and 0 < part.source_mm <= 50 and part.current_a > 0,
        f"{which} half angle must be above 0 and below 90 deg, its source above 0 to 50 mm and its"
        f" current positive, but they are {part.half_angle_deg:g} deg, {part.source_mm:g} mm and"
        f" {part.current_a:g} A.",
    )
    intensity = w_sr or cd / (_KM * float(_SPECTRA[band] @ _luminous(_WAVELENGTHS_NM)))
    lobe = np.log(0.5) / np.log(np.cos(np.radians(part.half_angle_deg)))
    flux_w = float(2 * np.pi * intensity / (lobe + 1))
    power_w = part.forward_v * part.current_a
    require(
        flux_w <= power_w,
        f"{which} data give {flux_w:.2g} W of light from {power_w:.2g} W of power; check its"
        f" intensity (cd, not mcd; W/sr, not mW/sr) and circuit.{band}.half_angle_deg.",
    )
    return intensity


def band_hazards(
    band: str,
    part: SimpleNamespace,
    current_a: float,
    distance_mm: float,
    *,
    together: int = 1,
    duty: float = 1.0,
) -> tuple[Hazard, ...]:
    """The retina's hazards of LEDs of one band, with limits of the exempt group (IEC 62471:2006,
    4.2.2, 4.3.3 to 4.3.6, table 6.1). `together`: LEDs seen within 0.1 rad; `duty`: fraction of the
    time that each is on, for heat always one, as a single flash may be long enough.
    """
    require(distance_mm > 0, "an exposure needs a distance.")
    irradiance = _irradiance(band, part, current_a, distance_mm)
    alpha = min(part.source_mm / distance_mm, _ALPHA_MAX)
    thermal_alpha = max(alpha, _ALPHA_EFF)
    burn = (
        irradiance
        * float(_SPECTRA[band] @ burn_weight(_WAVELENGTHS_NM))
        / _solid_angle(thermal_alpha)
    )
    if band == "nir":
        return (
            Hazard(
                band, "retina, heat, nothing seen", "4.3.6", burn, 6000.0 / thermal_alpha, "W/m2/sr"
            ),
        )
    blue_irradiance = duty * irradiance * float(_SPECTRA[band] @ blue_weight(_WAVELENGTHS_NM))
    if alpha < _ALPHA_EFF:
        blue = Hazard(
            band,
            "retina, blue light, small source",
            "4.3.4",
            blue_irradiance * together,
            1.0,
            "W/m2",
        )
    else:  # in so long a time the moving eye spreads the light over the largest angle that counts
        radiance = blue_irradiance * together / _solid_angle(_ALPHA_MAX)
        blue = Hazard(band, "retina, blue light", "4.3.3", radiance, 100.0, "W/m2/sr")
    # 50000 / (alpha t^0.25) at 10 s, its longest time: 28000 / alpha of table 6.1
    return blue, Hazard(band, "retina, heat", "4.3.5", burn, 28000.0 / thermal_alpha, "W/m2/sr")


def rig_hazards(
    rig: Rig,
    stages: Mapping[str, Stage],
    *,
    duty: float = 1.0,
    shorted: bool = False,
    passed: float = 1.0,
) -> tuple[Hazard, ...]:
    """Hazards of a rig whose LEDs are on together, with the largest currents of `stages`, by band;
    side lights have ``side``'s, or their band's. `duty`: of the time that an LED is on; `shorted`:
    with a shorted transistor's current; `passed`: of the white LEDs' light, by film; NIR passes it
    all.
    """
    all_hazards: list[Hazard] = []
    infrared = skin = 0.0
    side = side_lights(rig.leds) if "side" in stages else ()
    names = ["side" if k in side else led.band for k, led in enumerate(rig.leds)]
    for name, stage in stages.items():
        near = zip(names, rig.leds, strict=True)
        places = np.array(
            [led.position_mm for own, led in near if own == name and led.position_mm is not None]
        )
        if not len(places):
            continue
        band = stage.band
        current = (stage.shorted_a if shorted else stage.current_a[2]) * (
            passed if band == "white" else 1.0
        )
        distances = np.linalg.norm(places, axis=1)
        nearest = min(float(distances.min()), EYE_DISTANCE_MM)
        towards = places / distances[:, None]
        together = int((towards @ towards.T > np.cos(_ALPHA_MAX)).sum(axis=1).max())
        hazards = band_hazards(band, stage.led, current, nearest, together=together, duty=duty)
        all_hazards += [replace(hazard, band=name) for hazard in hazards]
        everywhere = len(places) * duty * _irradiance(band, stage.led, current, nearest)
        infrared += everywhere * float(_SPECTRA[band][_WAVELENGTHS_NM >= 780].sum())
        skin += everywhere
    all_hazards.append(Hazard("all", "cornea and lens, infrared", "4.3.7", infrared, 100.0, "W/m2"))
    all_hazards.append(
        Hazard("all", "skin, heat, 10 s", "4.3.8", skin, 20000.0 * _SKIN_EXPOSURE_S**-0.75, "W/m2")
    )
    return tuple(all_hazards)


def check_hazards(hazards: tuple[Hazard, ...]) -> None:
    """Refuse light above a limit, naming the hazard that is worst."""
    worst = min(hazards, key=lambda hazard: hazard.margin)
    leds = "the LEDs together" if worst.band == "all" else f"the {worst.band} LEDs"
    require(
        worst.margin >= 1,
        f"{leds} would give {worst.value:.3g} {worst.unit} ({worst.name}), above the"
        f" {worst.limit:.3g} of the exempt group of IEC 62471 ({worst.clause}); take LEDs with a"
        " wider beam or less light, or a smaller current.",
    )


def _irradiance(band: str, part: SimpleNamespace, current_a: float, distance_mm: float) -> float:
    """W/m2 of one LED at a distance on its axis."""
    return radiant_intensity(part, band) * current_a / part.current_a / (distance_mm * 1e-3) ** 2


def _solid_angle(alpha: float) -> float:
    """Solid angle of a round source or field, in sr, from its angle."""
    return np.pi / 4 * alpha**2
