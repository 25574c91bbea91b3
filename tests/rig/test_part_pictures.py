"""The renderer of parts: the nearest surface wins, sizes are right, labels are written."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.rig.cad import _Body, _draw, _View

FROM_ABOVE = _View(-90.0, 90.0)


def square(x, y, z, size):
    corners = np.array([[x, y, z], [x + size, y, z], [x + size, y + size, z], [x, y + size, z]], dtype=np.float32)
    return corners[np.array([[0, 1, 2], [0, 2, 3]])]


def fraction(picture, colour):
    """Part of the picture whose dominant channel is `colour`."""
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    wanted, others = (red, np.maximum(green, blue)) if colour == "red" else (green, np.maximum(red, blue))
    return float((wanted > others + 40).mean())


def test_the_nearer_surface_hides_the_farther():
    below = _Body(square(0, 0, 0, 10), (1.0, 0.1, 0.1))
    above = _Body(square(0, 0, 5, 5), (0.1, 1.0, 0.1))
    for bodies in ([below, above], [above, below]):
        picture = _draw(bodies, FROM_ABOVE, (200, 200), margin=0.0)
        assert picture.shape == (200, 200, 3)
        assert fraction(picture, "red") == pytest.approx(0.75, abs=0.02)
        assert fraction(picture, "green") == pytest.approx(0.25, abs=0.02)
        assert picture[150, 50, 1] > picture[150, 50, 0]  # x to the right, y up
    picture = _draw([below, above], _View(-90.0, -90.0), (200, 200), margin=0.0)
    assert fraction(picture, "green") == 0  # from below


def test_small_triangles_hide_each_other_too():
    n = 60
    x, y = (grid.ravel() * 10 / n for grid in np.meshgrid(np.arange(n), np.arange(n)))
    for high, low in ((5.0, 0.0), (0.0, 5.0)):
        first, second = (
            np.concatenate([square(a, b, z, 10 / n) for a, b in zip(x, y, strict=True)]) for z in (high, low)
        )
        picture = _draw(
            [_Body(first, (1.0, 0.1, 0.1)), _Body(second, (0.1, 1.0, 0.1))], FROM_ABOVE, (120, 120), margin=0.0
        )
        assert fraction(picture, "red") == pytest.approx(float(high > low), abs=0.05)


def test_turning_the_viewer_shows_another_side():
    body = _Body(np.concatenate([square(0, 0, 0, 10), square(0, 0, 0, 10)[..., [0, 2, 1]]]), (1.0, 0.1, 0.1))
    flat = _draw([body], _View(-90.0, 0.0), (100, 100), margin=0.0)  # along +y: the upright square fills it
    assert fraction(flat, "red") > 0.95
    lying = _draw([_Body(square(0, 0, 0, 10), (1.0, 0.1, 0.1))], _View(-90.0, 30.0), (100, 100), margin=0.0)
    assert fraction(lying, "red") == pytest.approx(0.5, abs=0.05)  # half as high: sin 30 deg


def test_large_and_small_triangles_meet():
    """A square of 2 triangles and the same of 20,000 give the same picture."""
    n = 100
    x, y = np.meshgrid(np.arange(n) / n * 10, np.arange(n) / n * 10)
    fine = np.concatenate([square(a, b, 0, 10 / n) for a, b in zip(x.ravel(), y.ravel(), strict=True)])
    coarse, many = (
        _draw([_Body(t, (1.0, 0.1, 0.1))], _View(-70.0, 40.0), (150, 150)) for t in (square(0, 0, 0, 10), fine)
    )
    assert np.mean(np.abs(coarse.astype(int) - many) > 8) < 0.01


def test_labels_keep_their_place_and_their_distance():
    bodies = [_Body(square(0, 0, 0, 10), (1.0, 0.1, 0.1), name, (9.0, 5.0, 0.0)) for name in ("one", "two")]
    plain = _draw(bodies, FROM_ABOVE, (200, 300), labels=0.3)
    written = np.flatnonzero((plain[:, 220:] < 120).all(axis=-1).any(axis=1))
    assert written.size > 10
    assert np.ptp(written) > 26  # two lines of text
