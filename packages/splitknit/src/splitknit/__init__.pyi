"""The door: what users (``__all__``) and the other members may import; all else may change
tomorrow."""

from splitknit.capture import Ambient as Ambient
from splitknit.capture import Band as Band
from splitknit.capture import Capture as Capture
from splitknit.errors import BadInput as BadInput
from splitknit.folders import read_photographs as read_photographs
from splitknit.io.capture import read_capture as read_capture
from splitknit.io.capture import write_capture as write_capture
from splitknit.io.results import read_result as read_result
from splitknit.io.rig import read_rig as read_rig
from splitknit.io.rig import write_rig as write_rig
from splitknit.methods.normals import surface_of_normals as surface_of_normals
from splitknit.model import Camera as Camera
from splitknit.model import Led as Led
from splitknit.model import Mirror as Mirror
from splitknit.model import Rig as Rig
from splitknit.pipeline import reconstruct as reconstruct
from splitknit.pipeline import reconstruct_images as reconstruct_images
from splitknit.presets import preset_settings as preset_settings
from splitknit.reconstruction import Reconstruction as Reconstruction

__version__: str

__all__ = [
    "Ambient",
    "BadInput",
    "Band",
    "Camera",
    "Capture",
    "Led",
    "Mirror",
    "Reconstruction",
    "Rig",
    "__version__",
    "preset_settings",
    "read_capture",
    "read_photographs",
    "read_result",
    "read_rig",
    "reconstruct",
    "reconstruct_images",
    "surface_of_normals",
    "write_capture",
    "write_rig",
]
