"""Camera modules of the Raspberry Pi: what each sensor can, how its raw values lie, how noisy it is.

Modes, times and gains are those of the sensors' drivers in Linux and libcamera. Electrons are of published
measurements and makers' sheets of the same sensor, rounded, for simulations (``sensor.full_well_e``); none was measured
here, and none of these modules has been run by this program.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sensor:
    """One camera module."""

    module: str
    """As it is sold."""
    size: tuple[int, int]
    """Rows, columns."""
    image_size: tuple[int, int]
    """What is used of them by default."""
    pixel_um: float
    bits: int
    black: int
    """Stored value of no light, of 2 ** bits - 1."""
    mono: bool
    line_s: float
    """Time in which the sensor reads one row at full resolution: exposures are whole numbers of it."""
    frame_s: float
    """Shortest time from frame to frame."""
    global_shutter: bool
    """All rows are exposed at once; else one after the other."""
    max_gain: float
    """Largest analogue gain."""
    gain_step: tuple[float, float, float]
    """Largest step between two gains near a gain g: the first, plus the second times g, plus the third times g * g."""
    tuning: str
    """Libcamera's tuning of it, by file name; what would bend light is left out of it."""
    full_well_e: float
    """Electrons of a pixel at full scale and gain 1."""
    read_noise_e: float
    """Standard deviation of reading out, electrons."""

    @property
    def readout_s(self) -> float:
        """From the end of the first row's exposure to that of the last."""
        return 0.0 if self.global_shutter else self.size[0] * self.line_s


SENSORS: Mapping[str, Sensor] = {
    "imx219": Sensor(
        "camera module 2, NoIR", (2464, 3280), (2200, 3200), 1.12, 10, 64, False, 18.904e-6, 0.0477, False, 10.6,
        (0.0, 0.0, 1 / 256), "imx219_noir.json", 4700.0, 2.5,
    ),
    "imx477": Sensor(
        "HQ camera, its infrared filter taken out", (3040, 4056), (3040, 4032), 1.55, 12, 256, False, 28.572e-6, 0.1001,
        False, 22.2, (0.0, 0.0, 1 / 1024), "imx477_noir.json", 8000.0, 3.0,
    ),
    "imx708": Sensor(
        "camera module 3, NoIR", (2592, 4608), (2592, 4608), 1.4, 10, 64, False, 26.0e-6, 0.0698, False, 16.0,
        (0.0, 0.0, 1 / 1024), "imx708_noir.json", 6000.0, 2.5,
    ),
    "ov9281": Sensor(
        "OV9281 module, mono, no infrared filter", (800, 1280), (800, 1280), 3.0, 10, 64, True, 9.1e-6, 0.0083, True,
        15.9, (1 / 16, 0.0, 0.0), "ov9281_mono.json", 7000.0, 4.0,
    ),
    "imx296": Sensor(
        "Global Shutter camera, its infrared filter taken out", (1088, 1456), (1088, 1440), 3.45, 10, 60, False,
        14.815e-6, 0.0166, True, 15.8, (0.0, 0.0116, 0.0), "imx296.json", 10_700.0, 2.2,
    ),
}  # fmt: skip
"""By the name that libcamera lists them under."""
