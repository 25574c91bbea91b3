"""Training of the network that separates direct light: the public names of the parts.

The thesis, 3.3.1.4: a U-Net of three encoder and three decoder blocks, trained on 72 x 72 patches of 50 palms whose
direct light was measured with 25 shifted checkerboards. Arrays in, arrays and bytes out; what reads and writes files is
``splitknit train separation``.
"""

from splitknit.training.batches import Patches
from splitknit.training.data import Enhance, Photograph, levelled, photographs, surface_of
from splitknit.training.loop import Trainer, learning_factor
from splitknit.training.network import export_onnx, load_torch, unet, unet_reach
from splitknit.training.settings import MAY_CHANGE, DataSettings, TrainSettings, wide_skin

__all__ = [
    "MAY_CHANGE",
    "DataSettings",
    "Enhance",
    "Patches",
    "Photograph",
    "TrainSettings",
    "Trainer",
    "export_onnx",
    "learning_factor",
    "levelled",
    "load_torch",
    "photographs",
    "surface_of",
    "unet",
    "unet_reach",
    "wide_skin",
]
