"""The twin's handful of coefficients against published tables."""

import numpy as np
import pytest

from splitknit_simulator.camera.sensor import RESPONSE
from splitknit_simulator.light.skin import CHANNELS, EFFECTIVE

pytestmark = pytest.mark.external


def sensor_and_led(data_dir):
    """Wavelengths in nm, quantum efficiency of red, green and blue, and quanta of the white LED."""
    sensor = np.genfromtxt(data_dir / "imx219" / "IMX219.csv", delimiter=",", skip_header=2)
    file = data_dir / "led_spectra" / "cie_led_illuminants.csv"
    led = np.genfromtxt(file, delimiter=",", names=True)
    nm = sensor[:, 0]
    return nm, sensor[:, 1:], np.interp(nm, led["nm"], led["LEDB3"]) * nm


@pytest.mark.parametrize("channel", CHANNELS)
def test_absorption_of_blood_and_water_agrees_with_published_tables(data_dir, channel):
    band = EFFECTIVE[channel]
    blood = np.genfromtxt(data_dir / "skin_optics" / "haemoglobin.txt", skip_header=2)
    per_mm = 2.303 * 150.0 / 64_500.0 / 10.0
    oxygenated, deoxygenated = (
        np.interp(band.absorption_nm, blood[:, 0], blood[:, k]) * per_mm for k in (1, 2)
    )
    assert band.oxygenated == pytest.approx(oxygenated, rel=0.02)
    assert band.deoxygenated == pytest.approx(deoxygenated, rel=0.02)
    water = np.genfromtxt(data_dir / "skin_optics" / "hale73.txt", skip_header=5)
    assert band.water == pytest.approx(
        np.interp(band.absorption_nm, water[:, 0], water[:, 1]) / 10.0, rel=0.1
    )


def test_response_and_wavelengths_follow_from_sensor_and_led(data_dir):
    nm, efficiency, quanta = sensor_and_led(data_dir)
    signal = (efficiency * quanta[:, None]).sum(axis=0)
    assert RESPONSE["white"] == pytest.approx(tuple(signal / signal[1]), abs=0.01)
    blue = nm < 500
    assert nm[blue][np.argmax(quanta[blue])] == pytest.approx(
        EFFECTIVE["blue"].absorption_nm, abs=5
    )
    # the band the red channel sees under the LED, less the green that a colour correction takes out
    centroid = np.average(nm, weights=efficiency[:, 0] * quanta)
    assert centroid == pytest.approx(EFFECTIVE["red"].scattering_nm, abs=15)


def test_band_averages_bracket_the_effective_wavelengths(data_dir):
    """How far one wavelength a channel stands from the channel's own average, as
    docs/explain/simulator.md states it."""
    nm, efficiency, quanta = sensor_and_led(data_dir)
    blood = np.genfromtxt(data_dir / "skin_optics" / "haemoglobin.txt", skip_header=2)
    weight = efficiency * quanta[:, None]
    weight /= weight.sum(axis=0)
    mixed = sum(
        fraction * np.interp(nm, blood[:, 0], blood[:, k]) * 2.303 * 150.0 / 645_000.0
        for k, fraction in ((1, 0.75), (2, 0.25))
    )
    average = weight.T @ mixed
    used = [
        0.75 * EFFECTIVE[c].oxygenated + 0.25 * EFFECTIVE[c].deoxygenated
        for c in ("red", "green", "blue")
    ]
    ratio = np.array(used) / average
    assert np.all(ratio < [0.4, 2.0, 1.4])
    assert np.all(ratio > [0.1, 1.2, 0.8])
