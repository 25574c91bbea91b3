"""Constants of records that could have been chosen otherwise, by module."""

# --- finger_image

MAX_PIXELS = 64_000_000
"""Pixels of all images of a file together, at most.

Unit: px. Chosen on: judgement. Range: not known.
"""

MAX_IMAGES = 1000
"""Images of a file, at most.

Unit: images. Chosen on: judgement. Range: not known.
"""

# --- fmr_bytes

MAX_RECORD_BYTES = 20_000_000
"""Longest record of minutiae: 176 full views with full extended data take 12 MB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

ENVELOPE_BYTES = 4096
"""Bytes in which a record is sought inside an envelope.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- itl

MAX_RECORDS = 1000
"""Records of a transaction, at most.

Unit: records. Chosen on: judgement. Range: not known.
"""

MAX_PPI = 5080.0
"""Highest resolution of a print.

Unit: ppi. Chosen on: judgement. Range: not known.
"""

# --- print_formats

MAX_WSQ_BYTES = 100_000_000
"""Longest WSQ file.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

MAX_IMAGE_RECORD_BYTES = 200_000_000
"""Longest record of images.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- templates

LARGEST_TEMPLATE_BYTES = 16_000_000
"""Longest payload of a template.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- what

WHAT_BYTES = 4096
"""First bytes of a file that is described.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

# --- wsq_image

WSQ_SIDE_PX = 96
"""Smallest side of a picture that is coded, for five levels of wavelets: images below 81 pixels
come back in another brightness, below 65 as garbage.

Unit: px. Chosen on: judgement. Range: 81 or more.
"""

LARGEST_SIDE_PX = 5000
"""Largest side of a picture that is coded.

Unit: px. Chosen on: judgement. Range: not known.
"""

TIMEOUT_S = 60.0
"""How long the codec may take.

Unit: s. Chosen on: judgement. Range: not known.
"""

CODEC_BYTES = 200_000_000
"""Memory of the codec's process, beside that of the pixels: Python and the file take 13 MB.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

CODEC_BYTES_PER_PIXEL = 30
"""Memory of the codec for each pixel; it takes 10.

Unit: bytes. Chosen on: judgement. Range: not known.
"""

CODEC_S = 2
"""Time of a processor that the codec may take, beside that of the pixels.

Unit: s. Chosen on: judgement. Range: not known.
"""

CODEC_PIXELS_PER_S = 1_000_000
"""Pixels in a second that the codec is expected to decode at least; a desktop's core decodes 18
million.

Unit: px/s. Chosen on: judgement. Range: not known.
"""

MAX_WSQ_PIXELS = 25_000_000
"""Pixels of a WSQ file, at most.

Unit: px. Chosen on: judgement. Range: not known.
"""
