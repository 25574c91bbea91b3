"""Makers' part numbers for every line of the board's bill of materials, each with two alternatives.

Nothing was ordered, and not every data sheet was at hand (``docs/guide/rig-circuit.md`` lists which): what a part must
have stands beside its number, to be checked before ordering.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

FUSES_A: Mapping[float, tuple[str, str, str, str]] = {
    0.05: ("0ZRE0005FF", "MF-R005", "RXEF005", "Fuse:Fuse_BelFuse_0ZRE0005FF_L8.3mm_W3.8mm"),
    0.08: ("0ZRE0008FF", "MF-R010", "RXEF010", "Fuse:Fuse_BelFuse_0ZRE0008FF_L8.3mm_W3.8mm"),
    0.12: ("0ZRE0012FF", "MF-R017", "RXEF017", "Fuse:Fuse_BelFuse_0ZRE0012FF_L8.3mm_W3.8mm"),
    0.16: ("0ZRE0016FF", "MF-R017", "RXEF017", "Fuse:Fuse_BelFuse_0ZRE0016FF_L9.9mm_W3.8mm"),
    0.25: ("0ZRE0025FF", "MF-R025", "RXEF025", "Fuse:Fuse_BelFuse_0ZRE0025FF_L9.6mm_W3.8mm"),
    0.33: ("0ZRE0033FF", "MF-R040", "RXEF040", "Fuse:Fuse_BelFuse_0ZRE0033FF_L11.4mm_W3.8mm"),
    0.40: ("0ZRE0040FF", "MF-R040", "RXEF040", "Fuse:Fuse_BelFuse_0ZRE0040FF_L11.5mm_W3.8mm"),
    0.55: ("0ZRE0055FF", "MF-R065", "RXEF065", "Fuse:Fuse_BelFuse_0ZRE0055FF_L14.0mm_W4.1mm"),
}
"""Resettable fuses by the current that they carry for ever at 20 degrees: Bel, Bourns, Littelfuse, footprint."""


@dataclass(frozen=True, slots=True)
class Order:
    """What to order for a line of the bill of materials."""

    part: str
    """Maker and part number."""
    alternatives: tuple[str, str]
    """Two others; ``none`` where none was found."""
    check: str
    """Values that matter: what any part in its place must have."""


def _coded(ohm: float) -> str:
    """Three digits and a power of ten, as Vishay codes 1 % resistors: 27 ohms are 2709, 360 are 3600.

    >>> _coded(27.0), _coded(360.0), _coded(100_000.0)
    ('2709', '3600', '1003')
    """
    power = len(str(int(ohm))) - 3
    digit = power if power >= 0 else {-1: 9, -2: 8}[power]
    return f"{round(ohm / 10.0**power):03d}{digit}"


def resistor(ohm: float, rating_w: float, text: str) -> Order:
    """Return what to order for a resistor; `text` is its value as in 4k7."""
    code, letter = _coded(ohm), text.upper()
    check = f"{text}, 1 %, {rating_w:g} W or more, body not longer than the footprint's"
    if rating_w <= 0.6:  # 0207: those of 0.6 W fit where 0.25 W would do
        return Order(f"Vishay MRS25000C{code}FCT00", (f"TE LR1F{letter}", f"Yageo MF0207FTE52-{letter}"), check)
    size = {1.0: "1", 2.0: "2", 3.0: "3"}[rating_w]
    return Order(
        f"Vishay PR0{size}00020{code}FA100",
        (f"TE ROX{size}S{letter} (5 %: circuit.resistor_spread)", f"Yageo RSF{size}00FB-73-{letter}"),
        check,
    )


_WHITE_STRONG = Order(
    "Lighthouse LEDs 5 mm 0.5 W cool white, clear",
    ("none with 100 mA was found", "none; 25 mA instead: Cree LC513FWH1-60Q-A0 (circuit.white.current_a 0.02)"),
    "5 mm, flange, not diffused, 100 mA for ever, 3.1 to 3.7 V at 100 mA, at most 10 cd, half angle 30 deg",
)
_WHITE_WEAK = Order(
    "Cree LC513FWH1-60Q-A0",
    ("RND 135-00123 (3000 K)", "Cree C513A-WSN"),
    "5 mm, flange, not diffused, 20 mA, 2.8 to 3.6 V, half angle 30 deg, all of one bin",
)
_NIR = Order(
    "Vishay TSHG6400",
    ("ams OSRAM SFH 4556", "Everlight HIR333/H0"),
    "850 nm, 5 mm, 100 mA for ever, 1.4 to 1.8 V at 100 mA, at most 0.12 W/sr, half angle 15 deg or more",
)


def led_order(band: str, current_a: float) -> Order:
    """Return what to order for an LED that carries a current."""
    if band == "nir":
        return _NIR
    return _WHITE_STRONG if current_a > 0.03 else _WHITE_WEAK


def fuse(hold_a: float) -> Order:
    """Return what to order for a fuse of :data:`FUSES_A`."""
    bel, bourns, littelfuse, _ = FUSES_A[hold_a]
    check = f"holds {1000 * hold_a:.0f} mA at 20 degrees, trips at twice that, 16 V or more, leads 5.1 mm apart"
    return Order(f"Bel Fuse {bel}", (f"Bourns {bourns}", f"Littelfuse {littelfuse}"), check)


FIXED: Mapping[str, Order] = {
    "BC337-40": Order(
        "onsemi BC33740TA",
        ("Diotec BC337-40", "Taiwan Semiconductor BC337-40 A1"),
        "NPN, gain 250 to 630 at 100 mA (suffix -40), 0.8 A, 45 V; legs C, B, E seen from the flat side, bent to "
        "2.54 mm",
    ),
    "J1": Order(
        "Wuerth 61204021621",
        ("3M N2540-6002RB", "XKB X9555WV-2x20-6TV01"),
        "box header 2 x 20, 2.54 mm, straight, notch towards pins 1, 3, 5 ...",
    ),
    "J2": Order(
        "Same Sky PJ-102AH",
        ("Wuerth 694106301002", "Switchcraft RAPC722X"),
        "barrel jack 5.5 mm for the adapter's pin of 2.1 mm, centre positive",
    ),
    "D90": Order(
        "onsemi 1N5819RLG", ("STMicroelectronics 1N5819", "Vishay 1N5819-E3/54"), "Schottky, 1 A, 40 V, DO-41"
    ),
    "C1": Order(
        "Panasonic EEU-FR1E471",
        ("Rubycon 25ZLH470MEFC10X12.5", "Nichicon UHE1E471MPD"),
        "470 uF, 25 V or more, at most 10 mm wide, leads 5 mm apart",
    ),
    "C2": Order(
        "Vishay K104K15X7RF5TH5",
        ("TDK FG28X7R1H104KNT06", "KEMET C322C104K5R5TA"),
        "100 nF, X7R, 50 V, leads 5 mm apart",
    ),
}
"""By the part's value or reference."""

OFF_BOARD: tuple[tuple[Callable[[int], int], str, Order], ...] = (
    (
        lambda leds: leds,
        "pin header 1 x 2 for the LED's wires",
        Order("Wuerth 61300211121", ("Harwin M20-9990246", "Samtec TSW-102-07-T-S"), "2.54 mm, straight"),
    ),
    (
        lambda leds: leds,
        "socket 1 x 2 on the LED's wires",
        Order(
            "Harwin M20-1060200 with M20-1160042", ("Molex 22-01-3027 with 08-50-0114", "Wuerth 61900211621"), "2.54 mm"
        ),
    ),
    (
        lambda _: 1,
        "ribbon cable to the Pi, 40 ways",
        Order("Adafruit 1988", ("Pimoroni CAB0501", "3M 3365/40 with two 89140-0101"), "pin 1 to pin 1, 15 cm or more"),
    ),
    (
        lambda _: 1,
        "wall adapter",
        Order(
            "Mean Well GST18A09-P1J",
            ("XP Power VEL12US090", "Same Sky SWI10-9-N-P5"),
            "the board's voltage, 0.5 A or more, plug 5.5 x 2.1 mm, centre positive, regulated within 5 %",
        ),
    ),
)
"""How many for a number of LEDs, what, and its numbers: what the netlist does not hold."""
