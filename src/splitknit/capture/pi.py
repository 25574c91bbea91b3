"""The Raspberry Pi: its camera and its LEDs, opened together. The only place that loads their libraries."""

from __future__ import annotations

import warnings
from contextlib import ExitStack
from typing import Any

from splitknit.capture.pi_camera import PiCamera, PiCameraSettings
from splitknit.capture.pi_lights import PiLightBank
from splitknit.capture.pins import pins_of
from splitknit.errors import BadInput
from splitknit.model import Rig

INSTALL = "on the Raspberry Pi: sudo apt install python3-picamera2 python3-gpiozero, and make the virtual environment "
INSTALL += "with --system-site-packages"


def open_lights(rig: Rig) -> PiLightBank:
    """Take the GPIO lines of the rig's LEDs, all off.

    Raises
    ------
    BadInput
        If gpiozero is missing, this is no Raspberry Pi, or a line is in use.
    """
    pins = pins_of(rig)
    try:
        import gpiozero  # type: ignore[import-untyped]  # noqa: PLC0415 - only a Pi has it
    except ImportError as error:
        raise BadInput(f"gpiozero, which switches the LEDs, is not installed; {INSTALL}.") from error
    try:
        with warnings.catch_warnings():  # it tells of every library that it tries; one sentence is enough
            warnings.simplefilter("ignore", gpiozero.PinFactoryFallback)
            return PiLightBank(pins, gpiozero.DigitalOutputDevice)
    except gpiozero.BadPinFactory as error:
        raise BadInput(
            "the LEDs cannot be switched: this computer has no GPIO lines that gpiozero can use; run this on the "
            "Raspberry Pi, or take --device twin."
        ) from error
    except (gpiozero.GPIOZeroError, OSError) as error:
        reason = " ".join(str(error).split())
        raise BadInput(f"the LEDs cannot be switched ({reason}); close other programs that use GPIO lines.") from error


def open_camera(settings: PiCameraSettings | None = None) -> PiCamera:
    """Open and start the camera.

    Raises
    ------
    BadInput
        If picamera2 is missing or there is no camera.
    """
    try:
        import picamera2  # type: ignore[import-not-found]  # noqa: PLC0415 - only a Pi has it
    except ImportError as error:
        raise BadInput(f"picamera2, which drives the camera, is not installed; {INSTALL}.") from error
    maker: Any = picamera2.Picamera2
    return PiCamera(maker, settings)


def open_pi(stack: ExitStack, rig: Rig, settings: PiCameraSettings | None = None) -> tuple[PiCamera, PiLightBank]:
    """Open LEDs, which go dark, and camera; `stack` closes both, the LEDs last.

    Raises
    ------
    BadInput
        In one sentence, with all LEDs off.
    """
    lights = stack.enter_context(open_lights(rig))
    return stack.enter_context(open_camera(settings)), lights
