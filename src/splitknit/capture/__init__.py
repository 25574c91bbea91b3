"""Taking pictures: a session of ambient and lit frames with checks, on a Raspberry Pi or on the digital twin."""

from splitknit.capture.enrolment import Enrolment, EnrolmentPlan, Place
from splitknit.capture.exposure import ExposureSettings, Focus, FocusSettings, FocusWatch, measure_focus
from splitknit.capture.pins import DEFAULT_PINS, led_names, pins_of
from splitknit.capture.session import Session, SessionSettings, check_fit, run_session
from splitknit.capture.shots import CheckSettings, Shot

__all__ = [
    "DEFAULT_PINS",
    "CheckSettings",
    "Enrolment",
    "EnrolmentPlan",
    "ExposureSettings",
    "Focus",
    "FocusSettings",
    "FocusWatch",
    "Place",
    "Session",
    "SessionSettings",
    "Shot",
    "check_fit",
    "led_names",
    "measure_focus",
    "pins_of",
    "run_session",
]
