"""Lines of text that report the results of calibrations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splitknit_rig.calibration.camera import TERMS


def camera_lines(facts: Mapping[str, Any]) -> list[str]:
    """Of a camera."""
    return [
        *(_fit_lines(facts) if facts["fit"] else []),
        *(_plane_lines(facts["plane"]) if facts["plane"] else []),
        *(f"Please note: {finding['message']}" for finding in facts["findings"]),
        (
            f"Measured: {', '.join(facts['measured'])}. Taken over:"
            f" {', '.join(facts['nominal']) or 'nothing'}."
        ),
        f"Written: {facts['out']}",
    ]


def _fit_lines(facts: Mapping[str, Any]) -> list[str]:
    fit = facts["fit"]
    per_image, deviations = fit["per_image_px"], fit["deviations"]
    count = (
        len(per_image) + len(fit["rejected_px"]) + len(fit["repeated"]) + len(fit["without_board"])
    )
    worst = max(per_image, key=lambda name: per_image[name])
    fx, fy = fit["focal_length_px"]
    cx, cy = fit["principal_point_px"]
    focal = f"{fx:.2f}" if fx == fy else f"{fx:.2f} x {fy:.2f}"
    around = [
        f" +- {deviations[name]:.2f}" if name in deviations else " (held)" for name in ("cx", "cy")
    ]
    lines = [
        (
            f"Camera calibrated from {fit['images']} of {count} photographs: corners lie"
            f" {fit['rms_px']:.3f} px off (rms), most in {worst} ({per_image[worst]:.3f} px)."
        ),
        (
            f"  focal length {focal} +- {deviations['fx']:.2f} px, "
            f"principal point ({cx:.2f}{around[0]}, {cy:.2f}{around[1]}) px"
        ),
    ]
    terms = zip(TERMS, facts["distortion"], strict=True)
    free = [
        f"{name} = {value:.4g} +- {deviations[name]:.2g}"
        for name, value in terms
        if name in fit["fitted"]
    ]
    lines.append(f"  distortion {', '.join(free) or 'none'}")
    lines += [
        f"  held: {name}{', ' if 'point' in name else ' = '}{why}"
        for name, why in fit["held"].items()
    ]
    lines += [
        f"  left out: {name}, corners {error:.2f} px off"
        for name, error in fit["rejected_px"].items()
    ]
    lines += [
        f"  left out: {name}, the same view as {first}" for name, first in fit["repeated"].items()
    ]
    board = facts["board"]["inner_corners"]
    lines += [
        f"  left out: {name}, no board of {board} inner corners in full view"
        for name in fit["without_board"]
    ]
    return lines


def _plane_lines(plane: Mapping[str, Any]) -> list[str]:
    return [
        (
            f"Finger plane: {plane['height_mm']:.3f} +- {plane['height_mm_deviation']:.3f} mm from"
            f" the camera, {plane['px_per_mm']:.4f} px/mm (marks {plane['rms_px']:.2f} px off)."
        ),
        (
            f"  The camera looks on the base {plane['tilt_deg']:.2f} +-"
            f" {plane['tilt_deg_deviation']:.2f} deg obliquely; the base comes nearer towards the"
            f" picture's {plane['nearer_at']}."
        ),
    ]


def radiometry_lines(facts: Mapping[str, Any], *, base_tilt: bool) -> list[str]:
    """Of the lights' brightness; `base_tilt`: the card is taken to lie as the base does."""
    lines = ["LED        intensity  beam   aim off  residuals rms, largest"]
    for led in facts["leds"]:
        lines.append(
            f"{led['name']:10s} {led['intensity']:9.3f} {led['lobe_exponent']:5.1f}"
            f" {led['aim_off_deg']:6.1f} deg  {led['rms_percent']:.2f} %,"
            f" {led['largest_percent']:.2f} %: {led['verdict']}"
        )
    lines.append(
        f"The lens shows the corners at {100 * facts['lens']['corner']:.0f} % of the middle's"
        " brightness."
    )
    for band, fraction in facts["ambient_percent"].items():
        if fraction is not None:
            lines.append(f"Light from elsewhere: {fraction:.2f} % of the {band} LEDs'.")
    if (response := facts["response"]) is not None:
        (low, high), kind = response["values_percent"], response["encoding"]
        lines.append(
            f"The camera is {kind.replace('srgb', 'sRGB')}: it departs by"
            f" {response[f'{kind}_departure_percent']:.2f} % of full scale at most, between"
            f" {low:.0f} and {high:.0f} % of it."
        )
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    if base_tilt and any(facts["card"]["tilt_deg"]):
        x, y = facts["card"]["tilt_deg"]
        lines.append(
            f"The card is taken to lie as the camera's calibration found the base: {x:.2f}, {y:.2f}"
            " deg."
        )
    lines.append(f"Written: {facts['out']}.")
    return lines


def film_lines(facts: Mapping[str, Any]) -> list[str]:
    """Of polarising films."""
    films = facts["films"]
    lines = ["LED   specular light left  crossed / parallel: red, green, blue  residuals rms"]
    for k, led in enumerate(films["leds"]):
        low, high = facts["leak_interval"][k]
        tint = ", ".join(f"{value:.4f}" for value in films["brightness"][k])
        lines.append(
            f"{led:3d}   {100 * low:.3f} to {100 * high:.3f} %      {tint:37s}"
            f" {facts['residual_rms_percent'][k]:.2f} %"
        )
    x, y = films["shift_px"]
    lines.append(
        f"The crossed image lies {x:+.3f} px right of and {y:+.3f} px below the parallel one (+- "
        f"{max(facts['shift_interval_px']):.3f} px), and is {films['scale']:.5f} times its size."
    )
    lines += [f"Please note: {finding['message']}" for finding in facts["findings"]]
    return [*lines, f"Written: {facts['out']}."]
