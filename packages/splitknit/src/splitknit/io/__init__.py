"""Files in and out: captures, rigs, images, meshes, height maps, prints, and where they came
from."""
