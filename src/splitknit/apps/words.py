"""What the names in a report mean, for readers who do not know the code."""

from __future__ import annotations

EXPLAINED = {
    "ridge_contrast": "How much the ridges change the brightness, relative. Good: above 0.006; more is better.",
    "ridge_contrast_per_image": "The same for every image. Good: all alike.",
    "sharpness": "Focus: fine detail relative to brightness. Compare it between captures of one rig.",
    "dark_specks": "Share of the finger under dark specks, as dust makes them. Good: below 0.002.",
    "bright_specks": "Share of the finger under bright specks, as scales of dry skin make them. Good: below 0.005.",
    "saturated_per_image": "Share of the finger that is too bright to measure, for every image. Good: below 0.02.",
    "brightness": "Median brightness of the finger, 1 = full scale. Good: 0.1 to 0.6.",
    "brightness_per_image": "The same for every image.",
    "ambient_share": "Light that is not from the LEDs, relative to theirs. Good: below 0.3.",
    "area_mm2": "Area of the skin in the image.",
    "length_mm": "Length of the finger in view.",
    "width_mm": "Width of the finger in view.",
    "frame_share": "Share of the image that the finger fills.",
    "borders": "Borders of the image that the finger touches. Good: one.",
    "led_relative": "Brightness of every image relative to what the rig file promises. Good: all near 1.",
    "yaw_deg": "Turn of the finger in the image, counter-clockwise; it is taken out.",
    "crease_line": "Ends of the flexion crease at which the finger was cut (column, row).",
    "motion_mm": "How far the finger moved against the other shots, in every image. Good: below 0.05 mm.",
    "motion_reliability": "How well that is known, for every image: 1 = certain.",
    "moved_mm": "How far the finger moved against the reference image, for every image; it was undone.",
    "shift_mm": "The same to the right and upwards.",
    "turn_deg": "By how much it turned, counter-clockwise.",
    "centre_mm": "About which point, to the right and downwards from the first pixel.",
    "unexplained_before": "Details of every image that no matt surface explains, before the motion was undone.",
    "unexplained_after": "The same afterwards. Good: below 0.2.",
    "likeness_before": "Correlation of every image's details with the expected ones, before the motion was undone.",
    "likeness_after": "The same afterwards.",
    "scattering_per_mm": "How often light is scattered in the skin, a millimetre; assumed for the shape.",
    "relief_by": "network: ridges drawn by the trained network; colour: told from glare by colour alone.",
    "separation": "What was done about glare and about light that spreads inside the skin.",
}
"""Name in ``quality`` or ``facts`` to what it says and what good looks like."""


def label(name: str) -> str:
    """Return a name as words."""
    return name.replace("_", " ")


def sentence(text: str) -> str:
    """Return `text` with a capital first letter."""
    return text[:1].upper() + text[1:]
