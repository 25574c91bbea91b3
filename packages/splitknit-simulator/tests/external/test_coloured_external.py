"""Crosstalk of coloured LEDs against the IMX219's published quantum efficiency."""

import numpy as np
import pytest

from splitknit.nominal import CROSSTALK
from splitknit_simulator.camera.sensor import RESPONSE

pytestmark = pytest.mark.external


def test_crosstalk_and_response_follow_from_the_quantum_efficiency(data_dir):
    sensor = np.genfromtxt(data_dir / "imx219" / "IMX219.csv", delimiter=",", skip_header=2)
    nm, efficiency = sensor[:, 0], sensor[:, 1:]
    signal = np.empty((3, 3))
    for led, (centre, width) in enumerate(((625, 20), (525, 33), (465, 24))):
        line = np.exp(-4 * np.log(2) * ((nm - centre) / width) ** 2)
        signal[:, led] = line @ efficiency / line.sum()
    np.testing.assert_allclose(CROSSTALK, signal / np.diag(signal)[:, None], atol=1e-3)
    np.testing.assert_allclose(RESPONSE["coloured"], np.diag(signal) / signal.max(), atol=5e-3)
