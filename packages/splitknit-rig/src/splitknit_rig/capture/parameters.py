"""Constants of the capture that could have been chosen otherwise, by module."""

# --- exposure

FINGER_PERCENTILE = 99.9
"""Percentile of the finger's pixels, in the brightest channel, that measures its brightness.

Unit: percentile. Chosen on: not known. Range: not known.
"""

START_S = 0.01
"""Exposure time of the first preview, at gain 1; above 0.

Unit: s. Chosen on: speed. Range: not known.
"""

CLIPPED_PREVIEW = 0.97
"""From this fraction of full scale on a preview only shows that less is needed.

Unit: fraction. Chosen on: not known. Range: not known.
"""

LEVEL_TOLERANCE = 0.06
"""The search ends when the level is as near to the target as this fraction of it.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_PREVIEWS = 12
"""Previews of the brightest LED at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

MIN_LEVEL = 0.3
"""The finger is too dark if it does not even reach this fraction of the target with all that the
camera can.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

DETAIL_MM = 0.02
"""Smoothing before the Laplacian (sigma, at least 0.7 px): 1.5 px of the full frame; finer shows
focus, and noise.

Unit: mm. Chosen on: judgement. Range: not known.
"""

FOCUS_PATIENCE = 8
"""The live measurement of the focus ends after this many values in a row that do not rise above the
best so far.

Unit: none. Chosen on: judgement. Range: not known.
"""

FOCUS_RISE = 0.02
"""A measurement rises that exceeds the best so far by this fraction of it.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_FOCUS_MEASUREMENTS = 400
"""Live measurements of the focus at most.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- pi

SETTLE_S = 0.02
"""Time after which an LED is taken to be at full brightness: far above what an LED (microseconds),
its phosphor (under a millisecond) and its supply (milliseconds) need.

Unit: s. Chosen on: judgement. Range: not known.
"""

TURN_S = 0.4
"""Time for a turn of the analyser: twice what a small servo needs for a quarter turn without load
(0.1 s for 60 degrees at 4.8 V).

Unit: s. Chosen on: judgement. Range: not known.
"""

WHITE_GAINS = (1.11, 2.13)
"""Gains of red and blue that make a white card white under white LEDs of 5000 K.

Unit: none. Chosen on: judgement. Range: not known.
"""

NIR_GAINS = (1.0, 1.0)
"""Gains of red and blue under NIR, where the colour filters are transparent.

Unit: none. Chosen on: judgement. Range: not known.
"""

LONGEST_S = 0.2
"""Longest exposure time that the camera is asked for.

Unit: s. Chosen on: judgement. Range: not known.
"""

PREVIEW_COLUMNS = 800
"""Width of a preview, about.

Unit: px. Chosen on: speed. Range: not known.
"""

MAX_FRAMES = 30
"""Frames that are thrown away, at most, while waiting for a good one.

Unit: none. Chosen on: judgement. Range: not known.
"""

# --- session

BRIGHT_PERCENTILE = 99.5
"""Percentile that stands for a calibration target's light: most of its picture may be black.

Unit: percentile. Chosen on: not known. Range: not known.
"""

MIN_SNR = 0.1
"""Below this the finger shows no detail above the noise: the picture is refused as out of focus.

Unit: none. Chosen on: not known. Range: not known.
"""

MIN_PX_PER_MM = 18.0
"""Coarser pictures are not refused: ridges are so small in them that they pass for noise.

Unit: px/mm. Chosen on: not known. Range: not known.
"""

MIN_RELATIVE = 0.12
"""An LED did not light if, in the previews, it gives less than this fraction of the median LED of
its band.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_AMBIENT = 0.3
"""Light with all LEDs off, relative to the median LED, above which the lid is open.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

FOCUS_FIELD_MM = 10.0
"""Side of the field in the finger's middle in which the focus is measured.

Unit: mm. Chosen on: not known. Range: not known.
"""

# --- shots

MAX_SATURATED = 0.05
"""A shot is overexposed if more of the finger is at full scale in two channels.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

DRIFTED_MM = 0.12
"""A finger that moved by more against all shots of its band, where the light's part is taken off,
has drifted.

Unit: mm. Chosen on: simulated fingers (four at half scale; a light that changes place looks like up
to 0.07 mm). Range: not known.
"""

MIN_PROMISED_LIGHT = 0.4
"""An LED did not light if the finger gets less than this fraction of what the preview promised.

Unit: fraction. Chosen on: judgement. Range: not known.
"""

MAX_CROSSED = 0.93
"""Crossed images have at most this fraction of the parallel ones' light where the finger shines.
Simulated fingers behind films have 0.47 (wet) to 0.91 (matt), a path-traced one 0.76; 1 is a film
that is missing or did not turn.

Unit: fraction. Chosen on: simulated fingers (behind films, wet to matt; a path-traced one). Range:
0.91 to 1.
"""

SHINE_PERCENTILE = 99.5
"""Percentile of the finger's pixels that its specular reflections reach.

Unit: percentile. Chosen on: not known. Range: not known.
"""

# --- preview

PREVIEW_PORT = 8765
"""Port of the preview's page, on 127.0.0.1.

Unit: none. Chosen on: judgement. Range: any that is free.
"""

PREVIEW_S = 600.0
"""For how long the preview goes on, and its LED is lit.

Unit: s. Chosen on: judgement. Range: not known.
"""

PREVIEW_PX = 640
"""Columns of the preview's pictures at most.

Unit: px. Chosen on: judgement. Range: not known.
"""

HISTOGRAM_BINS = 64
"""Of the preview's histogram.

Unit: none. Chosen on: judgement. Range: not known.
"""

PATIENCE_S = 2.0
"""A connection that asks nothing is closed after this.

Unit: s. Chosen on: judgement. Range: not known.
"""
