"""Sinusoids, occluders and the single image: exact on ideal scenes, unbiased variants, closed to sloppy input."""

from __future__ import annotations

import numpy as np
import pytest

from checkerboards import checkerboard_patterns
from splitknit.errors import BadInput
from splitknit.separation.binary import occluder, single_image
from splitknit.separation.sinusoid import PhaseSeparation, sinusoid
from splitknit.separation.stacks import estimate_patterns

SIZE = (48, 60)
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]]
DIRECT = 0.2 * (1 + 0.3 * np.sin(ROWS / 9))
GLOBAL = 0.4 + 0.1 * np.cos(COLUMNS / 17)
PHASE = 2 * np.pi * COLUMNS / 7.3 + 0.2 * np.sin(ROWS / 10)


def turn_between(a, b):
    return np.angle(np.exp(1j * (np.asarray(a, dtype=float) - b)))


def waves(count=3, dark=0.0, phases=None):
    phases = 2 * np.pi * np.arange(count) / count if phases is None else np.asarray(phases)
    states = 0.5 + 0.5 * np.sin(PHASE + phases[:, None, None])
    return (dark + (1 - dark) * states) * DIRECT + (1 + dark) / 2 * GLOBAL


def noisy(stack, sigma, seed=0):
    return stack + np.random.default_rng(seed).normal(0, sigma, stack.shape)


def refused(words, function, *arguments, **keywords):
    with pytest.raises(BadInput) as caught:
        function(*arguments, **keywords)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("dark", [0.0, 0.1])
@pytest.mark.parametrize("count", [3, 4, 8])
def test_sinusoids_give_light_and_phase(count, dark):
    parts = sinusoid(waves(count, dark), dark=dark)
    assert isinstance(parts, PhaseSeparation)
    assert np.abs(parts.direct - DIRECT).max() < 1e-6
    assert np.abs(parts.global_ - GLOBAL).max() < 1e-6
    assert np.abs(turn_between(parts.phase_rad, PHASE)).max() < 1e-5
    assert np.abs(parts.phase_rad).max() <= np.pi + 1e-6
    modulation = DIRECT * (1 - dark) / ((DIRECT + GLOBAL) * (1 + dark))
    assert np.abs(parts.modulation - modulation).max() < 1e-6


def test_uneven_phases_and_colour():
    phases = [0.3, 1.9, 4.0, 5.5]
    tint = np.array([1.0, 0.6, 0.3])
    parts = sinusoid(waves(phases=phases)[..., None] * tint, phases)
    assert np.abs(parts.direct - DIRECT[..., None] * tint).max() < 1e-6
    assert np.abs(parts.global_ - GLOBAL[..., None] * tint).max() < 1e-6
    assert np.abs(turn_between(parts.phase_rad, PHASE)).max() < 1e-5


def test_noise_biases_the_amplitude_and_a_way_out():
    sigma, errors = 0.04, {}
    stacks = [noisy(waves(), sigma, seed) for seed in range(6)]
    for name, keywords in (("plain", {}), ("noise", {"noise_std": sigma})):
        errors[name] = np.mean([(sinusoid(stack, **keywords).direct - DIRECT).mean() for stack in stacks])
    # variance of either component of three images: 2/3 sigma^2; bias of twice the amplitude: that over the amplitude
    expected = np.mean(2 / 3 * sigma**2 / (DIRECT / 2))
    assert errors["plain"] == pytest.approx(expected, rel=0.25)
    assert abs(errors["noise"]) < 0.2 * expected


def test_bad_sinusoids_are_refused():
    good = waves(4)
    refused("at least 3 images", sinusoid, good[:2])
    refused("images 1 and 2 have the same phase", sinusoid, waves(3), [0.0, 2.0, 2.0 + 2 * np.pi])
    refused("images 1 and 2 show the same pattern", sinusoid, noisy(waves(3)[[0, 1, 1]], 0.01))
    refused("too close together", sinusoid, waves(3), [0.0, 0.1, 0.2])
    refused("do not follow their phases", sinusoid, noisy(good[[0, 2, 1, 3]], 0.01))
    refused("must hold 4 finite numbers", sinusoid, good, [0, 1, 2])
    refused("noise_std", sinusoid, good, noise_std=-1.0)
    refused("saturated", sinusoid, np.minimum(2.2 * good, 1.0))
    half = np.where(ROWS < 24, good, 0.3)
    refused("never modulated", sinusoid, half)


def sweep(width=8, step=2, count=None):
    """A line that walks over the columns; 1 = lit."""
    frames = (SIZE[1] + width) // step + 1 if count is None else count
    places = step * np.arange(frames)[:, None, None] - width
    return 1.0 - ((places <= COLUMNS) & (places + width > COLUMNS))


def test_line_and_mesh():
    lit = sweep()
    parts = occluder(lit * DIRECT + GLOBAL)
    assert np.abs(parts.direct - DIRECT).max() < 1e-6
    assert np.abs(parts.global_ - GLOBAL).max() < 1e-6
    holes = np.stack([(ROWS - i) % 6 + (COLUMNS - j) % 6 < 4 for i in range(0, 6, 2) for j in range(0, 6, 2)])
    alpha = float(holes[0].mean())
    parts = occluder(iter(holes * DIRECT + alpha * GLOBAL), "mesh", alpha=alpha)
    assert np.abs(parts.direct - DIRECT).max() < 1e-6
    assert np.abs(parts.global_ - GLOBAL).max() < 1e-6


def test_a_noisy_film():
    lit, sigma = sweep(), 0.02
    film = noisy(lit * DIRECT + GLOBAL, sigma)
    film[5, 10:14, 10:14] = 0.9  # a fly
    kinds = {
        "plain": {},
        "robust": {"shadow_percent": 8.0},
        "known": {"patterns": lit},
        "found": {"patterns": estimate_patterns(film)},
    }
    parts = {name: occluder(film, **keywords) for name, keywords in kinds.items()}
    away = np.ones(SIZE, dtype=bool)
    away[5:20, 5:20] = False
    bias = {name: float((part.direct - DIRECT)[away].mean()) / sigma for name, part in parts.items()}
    assert bias["plain"] > 2.5
    assert 0.3 < bias["robust"] < 0.5 * bias["plain"]
    assert abs(bias["known"]) < 0.05
    assert abs(bias["found"]) < 0.05
    fly = np.abs(parts["robust"].direct - DIRECT)[10:14, 10:14].max()
    assert fly < 0.3 * np.abs(parts["plain"].direct - DIRECT)[10:14, 10:14].max()


def test_bad_films_are_refused():
    film = sweep(count=20) * DIRECT + GLOBAL
    with pytest.raises(BadInput, match=r"(\d+\.\d) % of the bright pixels were never shadowed") as caught:
        occluder(film)
    fraction = np.mean(film.max(axis=0) == film.min(axis=0))
    assert f"{100 * fraction:.1f} %" in str(caught.value)
    whole = sweep() * DIRECT + GLOBAL
    refused("'line' or 'mesh'", occluder, whole, "net")
    refused("a mesh needs alpha", occluder, whole, "mesh")
    refused("shadow_percent", occluder, whole, shadow_percent=60)
    refused("never dark by the patterns", occluder, film, patterns=sweep(count=20))


@pytest.mark.parametrize("dark", [0.0, 0.1])
@pytest.mark.parametrize("check_px", [3, 4, 6, 7.3])
def test_single_image_of_a_plain_scene_is_exact(check_px, dark):
    pattern = checkerboard_patterns((96, 96), check_px, [(0, 0)])[0]
    image = (dark + (1 - dark) * pattern) * 0.3 + (1 + dark) / 2 * 0.4
    parts = single_image(image, 24, check_px=check_px, dark=dark)
    assert parts.direct.shape == (4, 4)
    assert np.abs(parts.direct - 0.3).max() < 1e-6
    assert np.abs(parts.global_ - 0.4).max() < 1e-6


def test_single_image_with_a_known_pattern_has_no_bias():
    pattern = checkerboard_patterns(SIZE, 3, [(0, 0)])[0]
    tint = np.array([1.0, 0.6, 0.3])
    ideal = (pattern * DIRECT + 0.5 * GLOBAL)[..., None] * tint
    means = DIRECT.reshape(4, 12, 5, 12).mean(axis=(1, 3))[..., None] * tint
    plain = single_image(ideal, 12, check_px=3)
    assert plain.direct.shape == (4, 5, 3)
    assert np.abs(plain.direct - means).max() < 0.03
    assert np.abs(single_image(ideal, 12, pattern=pattern).direct - means).max() < 1e-6
    image = noisy(ideal, 0.02)
    assert (single_image(image, 12, check_px=3).direct - means).mean() > 0.03
    assert abs((single_image(image, 12, pattern=pattern).direct - means).mean()) < 0.001


def test_bad_single_images_are_refused():
    pattern = checkerboard_patterns(SIZE, 3, [(0, 0)])[0]
    image = pattern * DIRECT + 0.5 * GLOBAL
    refused("check_px", single_image, image, 12)
    refused("check_px", single_image, image, 12, check_px=7)
    refused("block must be", single_image, image, 100, check_px=3)
    refused("never lit or never dark", single_image, np.full(SIZE, 0.4), 12, check_px=3)
    refused("a block is never lit or never dark", single_image, image, 12, pattern=np.ones(SIZE))
    refused("pattern must have the shape", single_image, image, 12, pattern=pattern[1:])
    refused("larger than", single_image, image[:20, :20], 20, check_px=9.9)
