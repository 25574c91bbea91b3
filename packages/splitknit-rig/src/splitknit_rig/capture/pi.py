"""The Raspberry Pi: its camera modules by picamera2, LEDs by gpiozero; both are imported only here.

Frames are selected by their metadata. A new exposure takes effect some frames after it was
requested, and frames exposed before an LED was switched may still wait in the pipeline. So frames
are discarded until one states the locked exposure time, gain and colour gains, *and* its exposure
began after the call: its sensor timestamp minus its exposure time is later than the call. (A sensor
exposes its first row before the timestamp.)
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, Rig
from splitknit.devices import CameraDevice, Closing, ExposureRange, Frame, LightBank, Opened
from splitknit.errors import importing, require
from splitknit.findings import Finding
from splitknit.nominal import nominal_rig
from splitknit.settings import Checked, check_fields
from splitknit_rig.capture.pins import RigFilms, pins_of, rig_films


@dataclass(frozen=True, slots=True)
class _Sensor:
    """One camera module: limits of its sensor, layout of its raw values, and noise."""

    module: str  # as it is sold
    size: tuple[int, int]  # rows, columns
    image_size: tuple[int, int]  # what is used of them by default
    pixel_um: float
    bits: int
    black: int  # stored value of no light, of 2 ** bits - 1
    mono: bool
    # time in which the sensor reads one row at full resolution: exposures are whole numbers of it
    line_s: float
    frame_s: float  # shortest time from frame to frame
    global_shutter: bool  # all rows are exposed at once; else one after the other
    max_gain: float  # largest analogue gain
    # largest step between two gains near a gain g: the first, plus the second times g, plus the
    # third times g * g
    gain_step: tuple[float, float, float]
    tuning: str  # libcamera's tuning of it, by file name; what would bend light is left out of it
    full_well_e: float  # electrons of a pixel at full scale and gain 1
    read_noise_e: float  # standard deviation of reading out, electrons

    @property
    def readout_s(self) -> float:
        """Time from the end of the first row's exposure to that of the last."""
        return 0.0 if self.global_shutter else self.size[0] * self.line_s


SENSORS: Mapping[str, _Sensor] = {
    "imx219": _Sensor(
        "camera module 2, NoIR",
        (2464, 3280),
        (2200, 3200),
        1.12,
        10,
        64,
        False,
        18.904e-6,
        0.0477,
        False,
        10.6,
        (0.0, 0.0, 1 / 256),
        "imx219_noir.json",
        4700.0,
        2.5,
    ),
    "imx477": _Sensor(
        "HQ camera, its infrared filter taken out",
        (3040, 4056),
        (3040, 4032),
        1.55,
        12,
        256,
        False,
        28.572e-6,
        0.1001,
        False,
        22.2,
        (0.0, 0.0, 1 / 1024),
        "imx477_noir.json",
        8000.0,
        3.0,
    ),
    "imx708": _Sensor(
        "camera module 3, NoIR",
        (2592, 4608),
        (2592, 4608),
        1.4,
        10,
        64,
        False,
        26.0e-6,
        0.0698,
        False,
        16.0,
        (0.0, 0.0, 1 / 1024),
        "imx708_noir.json",
        6000.0,
        2.5,
    ),
    "ov9281": _Sensor(
        "OV9281 module, mono, no infrared filter",
        (800, 1280),
        (800, 1280),
        3.0,
        10,
        64,
        True,
        9.1e-6,
        0.0083,
        True,
        15.9,
        (1 / 16, 0.0, 0.0),
        "ov9281_mono.json",
        7000.0,
        4.0,
    ),
    "imx296": _Sensor(
        "Global Shutter camera, its infrared filter taken out",
        (1088, 1456),
        (1088, 1440),
        3.45,
        10,
        60,
        False,
        14.815e-6,
        0.0166,
        True,
        15.8,
        (0.0, 0.0116, 0.0),
        "imx296.json",
        10_700.0,
        2.2,
    ),
}
"""Camera modules by their names in libcamera. Modes, times and gains are those of the sensors'
drivers in Linux and libcamera. Full-well capacities are rounded from published measurements and
makers' data sheets of the same sensor, for simulations (``sensor.full_well_e``); this program has
not been run with any of these modules.
"""
SETTLE_S = 0.02
"""Time until an LED has full brightness: far longer than an LED (microseconds), its phosphor (under
a millisecond) and its supply (milliseconds) need."""


class PiLightBank(LightBank):
    """LEDs on GPIO lines, active high, off from the moment when the lines become outputs."""

    def __init__(
        self,
        pins: Sequence[int],
        make_line: Callable[..., Any],
        *,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Take the lines `pins`, BCM numbers in the order of the rig file's LEDs, by `make_line`,
        as ``gpiozero.DigitalOutputDevice``.
        """
        self._lines: list[Any] = []
        self._sleep = sleep
        try:
            for pin in pins:
                self._lines.append(make_line(pin, active_high=True, initial_value=False))
            super().__init__(len(self._lines), SETTLE_S)
        except BaseException:
            self._release()
            raise

    def _switch(self, led: int, lit: bool) -> None:
        if lit:
            self._lines[led].on()
        else:
            self._lines[led].off()

    def _wait(self, seconds: float) -> None:
        self._sleep(seconds)

    def _release(self) -> None:
        while self._lines:
            # gpiozero makes it an input: the base resistor's pull-down holds the LED off
            self._lines.pop(0).close()


class PiAnalyser(Closing):
    """The film before the camera on a servo; without pulses between turns, so that it does not
    vibrate."""

    def __init__(
        self,
        films: RigFilms,
        make_servo: Callable[..., Any],
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Take the servo's line; `make_servo`: ``gpiozero.Servo``, or what behaves like it;
        `sleep`: lets time pass."""
        short, long = sorted(films.pulses_ms)
        self._sleep = sleep
        self._crossed = 1.0 if films.pulses_ms[1] == long else -1.0
        widths = {"min_pulse_width": 1e-3 * short, "max_pulse_width": 1e-3 * long}
        self._servo = make_servo(films.servo, initial_value=None, **widths)

    def __call__(self, position: str) -> None:
        """Turn to ``parallel`` or ``crossed`` and wait until it is there."""
        self._servo.value = self._crossed if position == "crossed" else -self._crossed
        # twice what a small servo needs for a quarter turn without load (0.1 s for 60 deg at 4.8 V)
        self._sleep(0.4)
        self._servo.detach()

    def close(self) -> None:
        """See :class:`splitknit.devices.Closing`."""
        self._servo.close()


NOMINAL = Finding(
    "nominal-leds",
    "no rig file was given: the LEDs' nominal positions are assumed; calibrate the rig and name its"
    " file by `rig`.",
)
UNTESTED = (
    "not tested on hardware, only on substitutes of cameras and GPIO lines; look at the first"
    " frames."
)
"""Printed and stored with every capture until somebody has tested the rig."""


@dataclass(frozen=True, slots=True)
class PiCameraSettings(Checked):
    """Settings of the Raspberry Pi's camera."""

    _group = "pi"

    camera: Literal["imx219", "imx477", "imx708", "ov9281", "imx296"] = "imx219"
    """A camera module by its sensor."""
    image_size: tuple[int, int] | None = None
    """Rows, columns: the middle of the sensor, one to one. Even numbers; columns a multiple of 32.
    None: 2200 x 3200 of the imx219, as good as all of the others."""
    raw: bool = False
    """Raw images with the sensor's own bit depth, demosaiced here to 16 bits, instead of the image
    processor's 8-bit images."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.image_size is None:
            return
        rows, columns = self.image_size
        most = self.sensor.size
        require(
            0 < rows <= most[0] and 0 < columns <= most[1] and rows % 2 == 0 and columns % 32 == 0,
            f"pi.image_size must be even rows up to {most[0]} and columns up to {most[1]} that are"
            f" a multiple of 32, but it is {list(self.image_size)}.",
        )

    @property
    def sensor(self) -> _Sensor:
        """Profile of a camera module."""
        return SENSORS[self.camera]


_NIR_GAINS = (1.0, 1.0)  # of red and blue: the colour filters are transparent
_MAX_FRAMES = 30  # thrown away while waiting for a good one


class PiCamera(CameraDevice):
    """A :class:`splitknit.devices.CameraDevice` on picamera2."""

    def __init__(
        self,
        picamera2: Any,
        settings: PiCameraSettings,
        *,
        now_ns: Callable[[], int] | None = None,
    ) -> None:
        """Open and start a camera of the class ``picamera2.Picamera2``. Raises BadInput if there is
        none, or it is in use."""
        self._settings = settings
        self._sensor = self._settings.sensor
        self.image_size = self._settings.image_size or self._sensor.image_size
        self.exposures = ExposureRange(4 * self._sensor.line_s, 0.2, 1.0, self._sensor.max_gain)
        self._now_ns = now_ns or (lambda: time.clock_gettime_ns(time.CLOCK_BOOTTIME))
        self._wanted = 0, 0.0, _NIR_GAINS
        self._camera: Any = None
        models = [str(info.get("Model", "")) for info in picamera2.global_camera_info()]
        require(
            len(models) > 0,
            "no camera was found; switch the Pi off, reseat the camera's ribbon cable, and look for"
            " the camera with 'rpicam-hello --list-cameras'.",
        )
        require(
            any(model.startswith(self._settings.camera) for model in models),
            f"the camera is a {', '.join(models)}, not the {self._settings.camera} that was asked"
            " for; set pi.camera.",
        )
        try:
            tuning = _linear_tuning(picamera2.load_tuning_file(self._sensor.tuning))
            self._camera = picamera2(tuning=tuning)
            self._camera.configure(self._configuration())
            self._camera.start()
        except Exception as error:
            self.close()
            if isinstance(error, (BadInput, MemoryError)):
                raise
            raise BadInput(
                f"the camera could not be started ({' '.join(str(error).split())}); close other"
                " programs that use it."
            ) from error
        self.lock(0.01, 1.0)

    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        """See :class:`splitknit.devices.CameraDevice`."""
        self.exposures.check(exposure_s, gain)
        require(band in ("white", "nir"), f"the bands are white and nir, not '{band}'.")
        # red and blue: a white card is white under white LEDs of 5000 K
        gains = (1.11, 2.13) if band == "white" else _NIR_GAINS
        exposure_us = round(exposure_s * 1e6)
        # as fast as exposure and reading of the sensor allow
        frame_us = max(exposure_us + 1000, round(self._sensor.frame_s * 1e6))
        self._opened().set_controls(
            {
                "ExposureTime": exposure_us,
                "AnalogueGain": float(gain),
                "ColourGains": gains,
                "FrameDurationLimits": (frame_us, frame_us),
            }
        )
        self._wanted = (exposure_us, float(gain), gains)

    def preview(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`."""
        frame = self.capture()
        rows, columns, channels = frame.pixels.shape
        factor = max(1, round(columns / 800))
        size = (columns // factor, rows // factor)
        # means of whole blocks
        small: Any = cv2.resize(frame.pixels, size, interpolation=cv2.INTER_AREA)
        return replace(frame, pixels=small.reshape(*size[::-1], channels))

    def close(self) -> None:
        """See :class:`splitknit.devices.CameraDevice`."""
        camera, self._camera = self._camera, None
        if camera is not None:
            try:
                camera.stop()
            finally:
                camera.close()

    def _opened(self) -> Any:
        require(self._camera is not None, "the camera is closed; open it again.")
        return self._camera

    def _configuration(self) -> Any:
        (rows, columns), whole, bits = self.image_size, self._sensor.size, self._sensor.bits
        crop = ((whole[1] - columns) // 4 * 2, (whole[0] - rows) // 4 * 2, columns, rows)
        return self._camera.create_still_configuration(
            # "BGR888" of libcamera lies in memory as red, green, blue
            main={"size": (columns, rows), "format": "BGR888"},
            raw={
                "size": whole[::-1],
                "format": f"R{bits}" if self._sensor.mono else f"SBGGR{bits}",
            },
            buffer_count=3,
            queue=False,  # a request that waits in a queue is stale
            display=None,
            encode=None,
            controls={
                "AeEnable": False,
                "AwbEnable": False,
                "NoiseReductionMode": 0,
                "Sharpness": 0.0,
                "Contrast": 1.0,
                "Saturation": 1.0,
                "Brightness": 0.0,
                "ScalerCrop": crop,
            },
        )

    def capture(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`: wait for a frame that was exposed after now
        and as locked."""
        camera, since_ns = self._opened(), self._now_ns()
        metadata: Mapping[str, Any] = {}
        for discarded in range(_MAX_FRAMES):
            request = camera.capture_request()
            try:
                metadata = request.get_metadata()
                began_ns = int(metadata.get("SensorTimestamp", 0)) - 1000 * int(
                    metadata.get("ExposureTime", 0)
                )
                if self._as_locked(metadata) and began_ns >= since_ns:
                    return self._read(request, metadata, discarded)
            finally:
                request.release()
        raise BadInput(
            f"the camera did not take its settings: {self._wanted[0]} us at gain"
            f" {self._wanted[1]:g} were asked for, but after {_MAX_FRAMES} frames it reports"
            f" {metadata.get('ExposureTime')} us at gain {metadata.get('AnalogueGain')}; restart"
            f" the Pi, and see that its camera is the {self._settings.camera}."
        )

    def _as_locked(self, metadata: Mapping[str, Any]) -> bool:
        """Whether a frame was taken as requested, within the sensor's step size."""
        exposure_us, gain, gains = self._wanted
        colours = gains if self._sensor.mono else metadata.get("ColourGains", (0.0, 0.0))
        constant, linear, square = self._sensor.gain_step
        line_us = 1e6 * self._sensor.line_s
        step = constant + (linear + 0.005) * gain + square * gain**2
        return (
            abs(float(metadata.get("ExposureTime", 0)) - exposure_us)
            <= max(1.5 * line_us, 0.005 * exposure_us)
            and abs(float(metadata.get("AnalogueGain", 0.0)) - gain) <= step
            and abs(float(metadata.get("DigitalGain", 1.0)) - 1.0) <= 0.02
            and all(
                abs(float(a) - b) <= 0.01 * b + 0.005 for a, b in zip(colours, gains, strict=True)
            )
        )

    def _read(self, request: Any, metadata: Mapping[str, Any], discarded: int) -> Frame:
        if self._settings.raw:
            values, order, bits = self._raw(request)
            black = self._sensor.black << (16 - self._sensor.bits)
            pixels: Any = developed(values, bits, black, order, self._wanted[2])
        else:
            pixels, black = np.ascontiguousarray(request.make_array("main")), 0
        if self._sensor.mono:
            pixels = np.ascontiguousarray(pixels[..., :1])
        return Frame(
            pixels=pixels,
            exposure_s=float(metadata["ExposureTime"]) * 1e-6,
            gain=float(metadata["AnalogueGain"]) * float(metadata.get("DigitalGain", 1.0)),
            black_level=float(black),
            at_s=float(metadata["SensorTimestamp"]) * 1e-9 + self._sensor.readout_s,
            discarded=discarded,
        )

    def _raw(self, request: Any) -> tuple[NDArray[np.uint16], str, int]:
        """(H, W) raw values of the sensor's middle, order of colours, and bits: 16 of the Pi 5,
        else the sensor's."""
        (rows, columns), whole = self.image_size, self._sensor.size
        name = str(self._camera.camera_configuration()["raw"]["format"])
        order, bits = name.lstrip("S").rstrip("0123456789"), name.lstrip("SRGBrgb")
        require(
            bits.isdigit() and order in (*_BAYER, "R"),
            f"the camera gives raw images as {name}, which cannot be read; set pi.raw to false.",
        )
        values = np.ascontiguousarray(request.make_array("raw")).view(np.uint16)
        top, left = (whole[0] - rows) // 4 * 2, (whole[1] - columns) // 4 * 2
        return (
            np.asarray(values[top : top + rows, left : left + columns], dtype=np.uint16),
            order,
            int(bits),
        )


# Pictures in proportion to light: the Pi's image processor straightened, or its sensor's raw values
# developed.

# OpenCV names a pattern by its second row and column: blue green / green red is "BayerRG", and RGB
# its order
_BAYER: Mapping[str, int] = {
    "BGGR": cv2.COLOR_BayerRG2RGB,
    "GBRG": cv2.COLOR_BayerGR2RGB,
    "GRBG": cv2.COLOR_BayerGB2RGB,
    "RGGB": cv2.COLOR_BayerBG2RGB,
}
"""Named by the colours of the first two pixels of the first two rows."""


def developed(
    raw: NDArray[np.uint16],
    bits: int,
    black: int,
    order: str,
    gains: tuple[float, float] = (1.0, 1.0),
) -> NDArray[np.uint16]:
    """White-balanced linear colours (H, W, 3) uint16, or grey (H, W, 1), of `raw` values (H, W) of
    `bits`. `black`: 16-bit value of no light, which is kept; `order`: one of :data:`_BAYER`, else
    grey; `gains`: of red, blue.
    """
    shift = 16 - bits
    if order not in _BAYER:
        grey = np.left_shift(raw, shift, dtype=np.uint16)
        return np.asarray(np.where(raw >= (1 << bits) - 1, 65535, grey), dtype=np.uint16)[..., None]
    colours = np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), _BAYER[order]), dtype=np.uint16)
    levels = (np.arange(1 << bits, dtype=np.float64) * (1 << shift)) - black
    result = np.empty_like(colours)
    for c, gain in enumerate((gains[0], 1.0, gains[1])):
        table = np.clip(np.rint(levels * gain + black), 0, 65535)
        table[-1] = 65535  # what the sensor clips is clipped in every channel
        result[..., c] = table.astype(np.uint16)[np.minimum(colours[..., c], (1 << bits) - 1)]
    return result


def _linear_tuning(tuning: Mapping[str, Any]) -> dict[str, Any]:
    """A tuning (version 2) of the Pi's image processor with identity tone curve and colour matrix,
    and without lens shading correction, which would differ between captures.
    """
    straight = {
        "rpi.contrast": {"ce_enable": 0, "gamma_curve": [0, 0, 65535, 65535]},
        "rpi.ccm": {"ccms": [{"ct": 5000, "ccm": [1, 0, 0, 0, 1, 0, 0, 0, 1]}]},
    }
    algorithms = []
    for algorithm in tuning.get("algorithms", []):
        algorithms += [
            {name: straight.get(name, value)}
            for name, value in algorithm.items()
            if name != "rpi.alsc"
        ]
    require(
        any("rpi.contrast" in algorithm for algorithm in algorithms),
        "the camera's tuning file is of an unknown version; update libcamera (apt full-upgrade).",
    )
    return {**tuning, "algorithms": algorithms}


INSTALL = (
    "on the Raspberry Pi: sudo apt install python3-picamera2 python3-gpiozero, and make the virtual"
    " environment with --system-site-packages"
)


@contextmanager
def _gpio(what: str) -> Iterator[Any]:
    """Import and yield gpiozero; its errors become BadInput with one sentence, that `what` cannot
    be done."""
    with importing(f"gpiozero, which switches the LEDs, is not installed; {INSTALL}."):
        import gpiozero  # type: ignore[import-untyped]  # only a Pi has it
    try:
        # of every library that it tries, and of pulses that tremble in some releases
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", gpiozero.PinFactoryFallback)
            warnings.simplefilter("ignore", gpiozero.PWMSoftwareFallback)
            yield gpiozero
    except gpiozero.BadPinFactory as error:
        raise BadInput(
            f"{what}: this computer has no GPIO lines that gpiozero can use; run this on the"
            " Raspberry Pi, or take `device` twin."
        ) from error
    except (gpiozero.GPIOZeroError, OSError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"{what} ({reason}); close other programs that use GPIO lines.") from error


def _open_camera(settings: PiCameraSettings) -> PiCamera:
    """Open and start the camera. Raises BadInput if picamera2 cannot be imported or there is no
    camera."""
    try:
        import picamera2  # type: ignore[import-not-found]  # only a Pi has it
    except (ImportError, ValueError) as error:
        reason = " ".join(str(error).split())
        if "numpy" in reason:  # what was compiled for numpy 1 raises either of them
            raise BadInput(
                "picamera2, which drives the camera, uses packages that were compiled for numpy 1"
                f" and cannot run with numpy {np.__version__}; take Raspberry Pi OS Trixie or later"
                " (Bookworm: docs/guide/capture.md)."
            ) from error
        raise BadInput(
            f"picamera2, which drives the camera, cannot be imported ({reason}); {INSTALL}."
        ) from error
    return PiCamera(picamera2.Picamera2, settings)


def _open_analyser(rig: Rig) -> PiAnalyser | None:
    """Take the line of the servo that turns the rig's analyser, after its LEDs' lines; None where
    it has no servo."""
    films = rig_films(rig)
    if films is None or films.kind != "servo":
        return None
    with _gpio("the analyser's servo cannot be driven") as gpiozero:
        return PiAnalyser(films, gpiozero.Servo)


@contextmanager
def opened_pi(rig: Rig | None, settings: PiCameraSettings) -> Iterator[Opened]:
    """Open the LEDs, which go dark, and the camera of the settings, and close them afterwards.
    Raises BadInput if there is none."""
    untested = Finding("untested-camera", f"the {settings.camera} camera was {UNTESTED}")
    findings = (untested,) if rig is not None else (NOMINAL, untested)
    chosen = rig or replace(nominal_rig(), provenance={"source": "as drawn, not calibrated"})
    pins = pins_of(chosen)
    with ExitStack() as stack:
        with _gpio("the LEDs cannot be switched") as gpiozero:
            lights = PiLightBank(pins, gpiozero.DigitalOutputDevice)
        stack.enter_context(lights)  # closed last
        camera = stack.enter_context(_open_camera(settings))
        analyser = _open_analyser(chosen)
        if analyser is not None:
            stack.enter_context(analyser)
        yield Opened(
            "pi", camera, lights, chosen, {"pi": settings}, findings=findings, turn=analyser
        )
