"""Tuned constants of files: what is read at most, and which photographs are refused."""

# --- atomic

MANIFEST_BYTES = 16_000_000
"""Bytes of a folder's list of files that are read: 300,000 names.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- capture

AS_NEAR = 0.01
"""Difference of cosines below which a light is equally near to two others.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- content

DARK_FRACTION = 0.01
"""An image is black where its bright pixels, black level and ambient light off, stay below 2 of 255
levels, where 8 bits hold no shading.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
RELATIVE_DARK = 0.03
"""An image is unlit where its bright pixels are below this part of the band's median image; LEDs of
a rig differ by a factor of 3 at most.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
BRIGHT_QUANTILE = 0.999
"""Quantile of an image's bright pixels: all but the brightest thousandth, as hot pixels are not
light.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
FULL_SCALE = 0.995
"""Part of the full scale from which stored values are clipped: 254 of 255; 10- and 12-bit data in
16 bits end above.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
LIT_FRACTION = 0.02
"""Pixels above this part of the full scale, black level taken off, are lit: the finger, not its
black background.

Unit: fraction. Chosen on: not known. Range: not known.
"""
SATURATED_FRACTION = 0.2
"""An image is overexposed where more of its lit pixels is clipped; glare on wet skin clips a few
per cent, which robust weights take.

Unit: fraction. Chosen on: not known. Range: not known.
"""
SATURATED_AREA = 0.005
"""What is clipped must be more than this part of the whole image too: a dark object with a small
highlight is not overexposure.

Unit: fraction. Chosen on: not known. Range: not known.
"""
GREY_PART = 0.7
"""Part of what is not black that is not white either, from which a mask is a picture: up to 0.12 of
360 drawn masks sharp, of JPEG or noisy; 5 of 240 feathered or enlarged ones are above the limit;
0.72 and more of 272 photographs.

Unit: fraction. Chosen on: not known. Range: 0.12 to 0.72.
"""
SAMPLE_PIXELS = 200_000
"""About so many pixels are looked at in an image, on a regular grid; enough for a thousandth to be
200 pixels.

Unit: px. Chosen on: speed. Range: not known.
"""

# --- fields

MAX_JSON_BYTES = 16_000_000
"""A document of 16 MB takes up to 0.5 GB once parsed; the largest written here, minutiae in space,
have 10 MB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- images

MAX_PIXELS = 200_000_000
"""Pixels of one image at most: nothing of a rig is larger, and a small file can claim any.

Unit: px. Chosen on: judgement. Range: not known.
"""
MAX_BYTES = 600_000_000
"""Bytes of one image's file at most.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
DECODED_BYTES = 400_000_000
"""Bytes of one decoded image, at most: 130 million pixels of 8-bit RGB. Decoders of C hold a second
copy beside it.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
LARGEST_RATIO = 50_000
"""Bytes that one byte of a file can become: of a WEBP or a palette of one bit, the densest.

Unit: none. Chosen on: judgement. Range: not known.
"""
MAPPED_BYTES = 1_000_000_000
"""Beyond so many the images of a capture lie on disk while they are worked on; a full frame of 16
bits takes 0.7 GB.

Unit: bytes. Chosen on: speed. Range: not known.
"""
STACK_BYTES = 4_000_000_000
"""Bytes of all images of a capture once decoded, at most: 80 of the rig's camera in 16-bit colour.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
MAX_SCANS = 100
"""Scans of a JPEG file at most: each costs a pass through the whole image; a progressive image has
about ten.

Unit: none. Chosen on: judgement. Range: not known.
"""
TEXT_BYTES = 1_000_000
"""Characters of a TIFF file's description that are read.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- mesh

MESH_CHUNK = 1 << 16
"""Vertices or triangles that fit into a core's cache.

Unit: none. Chosen on: speed. Range: not known.
"""

# --- npz

RESULT_BYTES = 600_000_000
"""Bytes of arrays that are read at once, at most: a result of 25 million pixels, three times the
rig's.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
ARRAYS_FILE_BYTES = 1 << 32
"""Bytes of a file of arrays at most.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
LONG_FIELDS_BYTES = 1 << 30
"""Bytes of an array from which its member of the ZIP archive gets the format's longer fields.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- photograph_files

MAX_PHOTOGRAPHS = 1000
"""Photographs of a folder at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- photographs

SCALE_LIMITS = (1e-3, 1e5)
"""Smallest and largest scale that can be stated of photographs.

Unit: px/mm. Chosen on: judgement. Range: not known.
"""

# --- pictures

DIVERGING = ((5, 48, 97), (67, 147, 195), (247, 247, 247), (253, 174, 97), (165, 60, 10))
"""Colours of a scale: blue for low, white for zero, orange for high.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- plain

JUDGED_PHOTOGRAPHS = 24
"""Photographs whose shading shows their encoding, at most.

Unit: none. Chosen on: speed. Range: not known.
"""
JUDGED_PIXELS = 20_000
"""Pixels of each that are looked at.

Unit: px. Chosen on: speed. Range: not known.
"""
NEGATIVE = 0.02
"""Values below minus this part of the brightest are more than noise, if more than this part of all
values are.

Unit: fraction. Chosen on: judgement. Range: not known.
"""
BRIGHTEST_FLOAT = 0.9
"""What the brightest of floating-point values becomes, of the full scale of 16 bits.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

# --- prints

PRINT_PIXELS = 64_000_000
"""Pixels of a print or a page of prints at most: A4 at 1000 ppi, nearly; larger ones fill the
memory.

Unit: px. Chosen on: judgement. Range: not known.
"""
COLOUR_LEVELS = 12
"""Levels of 8 bits by which channels of grey RGB may differ, as JPEG rounds.

Unit: none. Chosen on: not known. Range: not known.
"""
COLOURED_PART = 0.01
"""Fraction of the pixels that may differ more.

Unit: fraction. Chosen on: not known. Range: not known.
"""

# --- results

LARGEST_MM = 1000.0
"""Longest side of a result's frame.

Unit: mm. Chosen on: judgement. Range: not known.
"""

# --- surface_files

MODEL_VERTICES = 100_000
"""Vertices of a model with a texture, about: so many a browser turns without a pause; finer detail
is in its normal map.

Unit: none. Chosen on: judgement. Range: not known.
"""
TEXTURE_PX = 4096
"""Longest side of a texture, which nearly all graphics cards take.

Unit: px. Chosen on: judgement. Range: not known.
"""

# --- targets

HEAD_BYTES = 16_000_000
"""Bytes from which the kind of a file is known.

Unit: bytes. Chosen on: judgement. Range: not known.
"""
