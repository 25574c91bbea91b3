"""What a user writes against the rig, for mypy alone: an ignored error is one that mypy must
find."""

from pathlib import Path

import splitknit_rig


def rig_of(folder: Path) -> list[int]:
    camera = splitknit_rig.calibrate_camera(
        folder / "boards", out=folder / "camera.json", square_mm=2.0
    )
    print(camera.camera.scale_known, sorted(camera.poses))
    lights = splitknit_rig.calibrate_lights(images=folder / "ball", sphere="chrome", rig=camera.out)
    print(lights.method, len(lights.leds), [finding.code for finding in lights.findings])
    card = splitknit_rig.calibrate_radiometry(
        folder / "card", rig=camera.out, out=folder / "rig.json"
    )
    print(str(card))
    return list(range(len(lights.leds)))


def wrong() -> None:
    splitknit_rig.calibrate_camera("boards")  # type: ignore[call-arg]
    splitknit_rig.calibrate_camera("boards", out="rig.json", square=2.0)  # type: ignore[call-arg]
    splitknit_rig.calibrate_lights(images="ball", sphere="brass")  # type: ignore[arg-type]
    splitknit_rig.calibrate_radiometry("card", out="rig.json").lights  # type: ignore[attr-defined]
