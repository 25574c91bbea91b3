"""Film before side lights: turned, so that a facet's reflection stays out of the crossed image."""

import numpy as np
import pytest

from splitknit.nominal import default_rig
from splitknit_simulator.light.films import FilmSettings, reflected_through, turned_film_rad
from splitknit_simulator.rigs import with_side_lights
from splitknit_simulator.scene import TwinSettings, films_of


@pytest.mark.parametrize("analyser", [0.0, 0.6])
def test_turned_film_keeps_the_reflection_out_of_the_crossed_image(analyser):
    """Film along the analyser would leak up to half of what a facet half way between light and
    camera mirrors."""
    leaks = []
    for led in with_side_lights(default_rig(), 7).leds[14:]:
        light = np.array(led.position_mm) / np.linalg.norm(led.position_mm)
        turned = turned_film_rad(led.position_mm, analyser)
        ways = [
            (axis, analyser + quarter)
            for axis in (turned, analyser)
            for quarter in (0.0, np.pi / 2)
        ]
        parallel, crossed, plain, leaked = (
            float(reflected_through(light, (0.0, 0.0, 1.0), film, camera, 0.0))
            for film, camera in ways
        )
        assert crossed < 1e-9 * parallel
        leaks.append(leaked / (plain + leaked))
    assert max(leaks) > 0.4


def test_the_twin_turns_the_film_before_side_lights():
    rig = with_side_lights(default_rig(0.1), 7)
    films = films_of(TwinSettings(rig=rig, films=FilmSettings(kind="analyser")), rig)
    assert films is not None and films.polariser_rad.shape == (2, 14)
    assert not films.polariser_rad[:, :7].any()
    turned = [turned_film_rad(led.position_mm) for led in rig.leds[14:]]
    assert np.allclose(films.polariser_rad[:, 7:], turned)
