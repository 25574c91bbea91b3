"""Captures of fingers that move, simulated once and kept in ``validation/out/motion``."""

from __future__ import annotations

from pathlib import Path

from splitknit.io.capture import write_capture
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

OUT = Path(__file__).resolve().parents[1] / "out" / "motion"
SEEDS = tuple(range(7001, 7009))
"""Fingers of the table; those of 9101 to 9104 served to choose the settings."""
AMPLITUDES_MM = (0.5, 0.25, 0.8, 0.1)
SCALE = 0.35


def capture_folder(seed: int, amplitude_mm: float, scale: float, out: Path = OUT) -> Path:
    """Folder of a capture with truth; it is simulated where it is missing."""
    folder = out / f"{seed}_{amplitude_mm:g}_{scale:g}"
    if not (folder / "truth.npz").is_file():
        motion = HandMotion(amplitude_mm=amplitude_mm)
        settings = TwinSettings(scale=scale, motion=motion, render=RenderSettings(workers=1))
        capture, truth = simulate_capture(seed, None, settings)
        kept = {
            name: value for name, value in truth.items() if not name.startswith(("glare", "relief"))
        }
        write_capture(capture, folder, kept, overwrite=True)
    return folder
