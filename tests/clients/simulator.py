"""What a user writes against the simulator, for mypy alone: an ignored error is one that mypy must
find."""

import numpy as np

import splitknit
import splitknit_simulator


def error_um(seed: int) -> float:
    capture, truth = splitknit_simulator.simulate_capture(
        seed, settings={"scale": 0.25}, impression=2
    )
    result = splitknit.reconstruct(capture)
    print(capture.rig.camera.scale_known, capture.bands["white"].leds)
    apart = result.height_mm - truth["height_mm"]
    return float(1000 * np.nanstd(apart))


def wrong(seed: str) -> None:
    splitknit_simulator.simulate_capture(seed)  # type: ignore[arg-type]
    splitknit_simulator.simulate_capture(1, impresion=2)  # type: ignore[call-arg]
    splitknit_simulator.simulate_capture(1).bands  # type: ignore[attr-defined]
    splitknit_simulator.simulate_finger(1)  # type: ignore[attr-defined]
