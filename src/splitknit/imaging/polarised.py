"""Photographs behind linear films: light as without them, and the light that the surface itself reflects."""

from __future__ import annotations

from dataclasses import replace

from splitknit.model import Capture


def without_films(capture: Capture) -> Capture:
    """The capture whose white light is the mean of its parallel and its crossed series, where it has both.

    Half of unpolarised light passes either analyser, so that the mean has half its brightness, and its shading.
    The mean is taken where images are made linear (:func:`splitknit.imaging.band.linear_channels`).

    Examples
    --------
    >>> import splitknit
    >>> capture = without_films(splitknit.read_capture("polarised"))  # doctest: +SKIP
    """
    crossed = capture.bands.get("white_crossed")
    if crossed is None:
        return capture
    return replace(capture, bands={**capture.bands, "white": replace(capture.bands["white"], crossed=crossed)})
