"""Files in and out: captures, rigs, images, meshes, height maps, prints, and where they came from.

Nothing outside this package and the applications reads or writes a file.
"""

from splitknit.io.atomic import atomic_file, atomic_folder
from splitknit.io.capture import ReadSettings, read_capture, with_rig, write_capture
from splitknit.io.float_tiff import read_height_tiff, write_height_tiff
from splitknit.io.images import ImageSettings, image_size, read_image, write_image
from splitknit.io.mesh import surface_mesh
from splitknit.io.npz import read_npz, write_npz
from splitknit.io.plain import capture_from_plain_images, read_lights_txt
from splitknit.io.ply import Mesh, read_ply, write_ply
from splitknit.io.prints import PrintFile, read_print_png, write_print_png
from splitknit.io.provenance import canonical_json, file_hash, plain_json, provenance, settings_hash
from splitknit.io.rig import read_rig, rig_from_json, rig_to_json, write_rig

__all__ = [
    "ImageSettings",
    "Mesh",
    "PrintFile",
    "ReadSettings",
    "atomic_file",
    "atomic_folder",
    "canonical_json",
    "capture_from_plain_images",
    "file_hash",
    "image_size",
    "plain_json",
    "provenance",
    "read_capture",
    "read_height_tiff",
    "read_image",
    "read_lights_txt",
    "read_npz",
    "read_ply",
    "read_print_png",
    "read_rig",
    "rig_from_json",
    "rig_to_json",
    "settings_hash",
    "surface_mesh",
    "with_rig",
    "write_capture",
    "write_height_tiff",
    "write_image",
    "write_npz",
    "write_ply",
    "write_print_png",
    "write_rig",
]
