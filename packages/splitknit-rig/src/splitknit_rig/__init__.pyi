"""The door: what users (``__all__``) and the other members may import; all else may change
tomorrow."""

from splitknit_rig.calibrate import calibrate_camera as calibrate_camera
from splitknit_rig.calibrate import calibrate_lights as calibrate_lights
from splitknit_rig.calibrate import calibrate_radiometry as calibrate_radiometry

__version__: str

__all__ = ["__version__", "calibrate_camera", "calibrate_lights", "calibrate_radiometry"]
