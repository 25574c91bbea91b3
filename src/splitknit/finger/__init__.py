"""From linear images to the pixels that are the finger: mask, orientation, phalange, contrast, quality, motion.

Every function takes and returns arrays on the input's pixel grid. Decisions are made on reduced copies; each docstring
says at which scale.
"""

from splitknit.finger.contrast import ClaheSettings, clahe
from splitknit.finger.mask import (
    MaskSettings,
    check_borders,
    finger_mask,
    finger_outline,
    finger_region,
    touched_borders,
)
from splitknit.finger.motion import MotionSettings, ShotMotion, motion_warnings, shot_motion
from splitknit.finger.orientation import Upright, find_upright
from splitknit.finger.phalange import Crease, find_crease, phalange_mask
from splitknit.finger.quality import QualitySettings, capture_quality, photometric_mask, quality_warnings
from splitknit.finger.registration import Registration, RegistrationSettings, register_shots, without_glare
from splitknit.finger.registration_band import BandRegistration, Seen, register_band

__all__ = [
    "BandRegistration",
    "ClaheSettings",
    "Crease",
    "MaskSettings",
    "MotionSettings",
    "QualitySettings",
    "Registration",
    "RegistrationSettings",
    "Seen",
    "ShotMotion",
    "Upright",
    "capture_quality",
    "check_borders",
    "clahe",
    "find_crease",
    "find_upright",
    "finger_mask",
    "finger_outline",
    "finger_region",
    "motion_warnings",
    "phalange_mask",
    "photometric_mask",
    "quality_warnings",
    "register_band",
    "register_shots",
    "shot_motion",
    "touched_borders",
    "without_glare",
]
