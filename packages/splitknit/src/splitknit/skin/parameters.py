"""Constants of the `metric` method on skin that could have been chosen otherwise, by module."""

# --- diffusion

SCATTERING_SD = 0.3
"""Relative standard deviation of the scattering between people; it enters the relief's uncertainty.

Unit: fraction. Chosen on: judgement. Range: 0.15 to 0.6 (validation/parameters).
"""

COLOUR_TRUST = 0.6
"""How much the absorption in green and blue follows this finger's colour: 0 not at all, 1 fully.

Unit: fraction. Chosen on: not known. Range: 0.42 to 0.84 (validation/parameters).
"""

# --- grid

WORKING_PITCH_MM = 0.0264
"""Pitch of the fine grid. The skin's blur leaves less than 2 % of any finer detail, and the
networks were trained near it.

Unit: mm. Chosen on: judgement. Range: not known.
"""

COARSE_PITCH_MM = 0.106
"""Pitch of the coarse grid.

Unit: mm. Chosen on: not known. Range: 0.0742 to 0.106 (validation/parameters).
"""

# --- images

NETWORK_TILE_PX = 704
"""Side of a square as large as a tile of the networks; memory grows with its square.

Unit: px. Chosen on: speed. Range: not known.
"""

GRID_MARGIN_MM = 0.1
"""Width of the working grid beside the finger's outline.

Unit: mm. Chosen on: speed. Range: 0.05 to 0.2 (validation/parameters).
"""

# --- learned

RIDGE_BAND_MM = 0.3
"""Standard deviation of the Gaussian mean that the relief is free of; the networks were trained
with it.

Unit: mm. Chosen on: not known. Range: 0.21 to 0.6 (validation/parameters).
"""

LEVEL_MM = 0.6
"""Standard deviation of the Gaussian mean that brightness is relative to; the networks were trained
with it.

Unit: mm. Chosen on: not known. Range: 0.3 to 1.2 (validation/parameters).
"""

MIN_LIGHTS = 6
"""Fewer lights leave too little beside the slopes to measure specular reflection by.

Unit: lights. Chosen on: judgement. Range: 3 to 6 (validation/parameters).
"""

LITTLE_GLOSS = 0.015
"""Mean specular reflection over the diffuse light, as the network estimates it, below which there
may be none.

Unit: fraction. Chosen on: simulated fingers (boundaries of all kinds). Range: not known.
"""

GAIN_UNCERTAINTY = 0.175
"""Standard deviation of the common factor of all heights where shading shows the ridges.

Unit: fraction. Chosen on: path-traced fingers (three of validation/path_traced/make.py, eight of
its ``--drawn 8 --seed 1``) and four simulated ones. Range: not known.
"""

RED_SHADING = (0.15, 0.4)
"""Shading by ridges in red over that in blue, where it says nothing of the ridges' height, and
where all. Refracted light gave -0.1 to 0.2, diffused light 0.25 to 0.35, the simulator 0.37 to
0.48; skin that scatters little gives less.

Unit: none. Chosen on: the same fingers. Range: not known.
"""

HIDDEN_RIDGES_UM = 15.0
"""Standard deviation of the ridges that shading does not show.

Unit: um, rms. Chosen on: the same fingers. Range: not known.
"""

OWN_ERROR = (0.8, 0.8, 0.8, 0.8, 0.8, 1.0)
"""Deviation of the relief without that of its gain, over the one with it, by slant (`SLANT_DEG`).

Unit: fraction. Chosen on: the same fingers. Range: not known.
"""

SLANT_DEG = (0, 15, 30, 45, 60, 70)
"""Slants at which `SLANT_ERROR` is given.

Unit: deg. Chosen on: simulated fingers (ten, and two path-traced ones, validation/path_traced).
Range: not known.
"""

SLANT_ERROR = (0.74, 0.84, 1.1, 1.12, 1.02, 2.3)
"""Error of the relief over what the network states, by slant; it is smallest where the skin faces
lights and camera. The simulated fingers have 0.7 to 0.9 up to 60 degrees and 2.3 beyond, the
path-traced ones 0.6 to 0.8 below 15 degrees and 0.8 to 1.5 above.

Unit: none. Chosen on: simulated fingers (ten, and two path-traced ones, validation/path_traced).
Range: none within 0.7 to 1.4 (validation/parameters).
"""

MAX_UNEVEN = 10.0
"""Condition of the harmonics up to the second at the lights' azimuths; one for a regular ring.

Unit: none. Chosen on: judgement. Range: not known.
"""

NETWORK_PITCH_MM = (0.017, 0.041)
"""Smallest and largest pixels that the networks are applied to: about those that they were trained
on.

Unit: mm. Chosen on: not known. Range: not known.
"""

RIDGE_SLOPES_MM = 0.6
"""Standard deviation of the Gaussian mean of the ridges' slopes; the shape network was trained with
it.

Unit: mm. Chosen on: not known. Range: 0.3 to 1.2 (validation/parameters).
"""

# --- light

REFRACTIVE_INDEX = 1.42
"""Refractive index of the stratum corneum, about.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

ROUGHNESSES = (0.12, 0.16, 0.20, 0.25, 0.30, 0.36, 0.42)
"""Roughnesses (GGX alpha) of the specular reflection that are tried.

Unit: none. Chosen on: not known. Range: 1 to 1.4 times these values (validation/parameters).
"""

# --- polarised

TYPICAL_RIDGES_PER_MM = 14.0
"""Angular frequency of ridges.

Unit: rad/mm. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

EDGE_PX = 3
"""Pixels nearer to the outline are not fitted.

Unit: px. Chosen on: judgement. Range: 2 to 4 (validation/parameters).
"""

START_ROUGHNESS = 0.25
"""Roughness (GGX alpha) at which the fit starts.

Unit: none. Chosen on: judgement. Range: 0.125 to 0.25 (validation/parameters).
"""

START_PATH_PX = 2.0
"""Blur (sigma) by the paths of scattered light at which the fit starts.

Unit: px. Chosen on: judgement. Range: 1 to 4 (validation/parameters).
"""

START_BLUR_PX = 0.8
"""Blur (sigma) of lens and pixels at which the fit starts.

Unit: px. Chosen on: judgement. Range: 0.4 to 0.8 (validation/parameters).
"""

SLOW_MM = 0.5
"""Length over which the start's mean slope is known to `SLOW_SLOPE`.

Unit: mm. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

SLOW_SLOPE = 0.2
"""Standard deviation of that mean slope.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

PRIOR_FACTOR_FRONT = 5.0
"""Factor on the stated deviation of the start's relief, whose error is one of gain too.

Unit: none. Chosen on: not known. Range: 3.5 to 10 (validation/parameters).
"""

PRIOR_FACTOR_SIDE = 20.0
"""The same with lights to the side, which show the flanks.

Unit: none. Chosen on: not known. Range: 10 to 40 (validation/parameters).
"""

STEEP = 1.0
"""Strength, roughness, path and blur are fitted where the start is less steep than this.

Unit: slope. Chosen on: judgement. Range: 0.5 to 2 (validation/parameters).
"""

LOCAL_RHO = 0.3
"""Relative standard deviation of rho about its mean over `SLOW_MM`: valleys are darker.

Unit: fraction. Chosen on: not known. Range: 0.21 to 0.6 (validation/parameters).
"""

FILMS_MODEL_ERROR = 0.03
"""Error of the prediction, as a fraction of the image.

Unit: fraction. Chosen on: not known. Range: 0.021 to 0.03 (validation/parameters).
"""

SCATTERED_ERROR = 0.1
"""Error of the prediction's scattered part, as a fraction of that part.

Unit: fraction. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

FIRST_ERROR = 0.8
"""Error of the prediction in the first step with lights to the side: facets far from their slope
are no outliers.

Unit: fraction. Chosen on: not known. Range: 0.4 to 1.12 (validation/parameters).
"""

ERROR_FACTOR = 0.66
"""Factor on that error from step to step, down to `FILMS_MODEL_ERROR`.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

GRAZING = 0.004
"""Square of the cosine of incidence at which half the light enters that is scattered once.
Fresnel's transmittance and the longer path below the skin would give 0.01 on a smooth surface, but
such light also comes from beside the facet.

Unit: none. Chosen on: not known. Range: 0.002 to 0.008 (validation/parameters).
"""

LIT_FRONT = (0.1, 0.3)
"""Cosine of incidence from which a facet is used, and how much more gives it all its weight.

Unit: none. Chosen on: not known. Range: 0.5 to 2 times these values (validation/parameters).
"""

LIT_SIDE = (0.05, 0.2)
"""The same with lights to the side.

Unit: none. Chosen on: not known. Range: 0.7 to 1.4 times these values (validation/parameters).
"""

SEEN_FRONT = (0.3, 0.2)
"""Cosine to the camera from which a facet is used, and how much more gives it all its weight.

Unit: none. Chosen on: not known. Range: 0.5 to 1.4 times these values (validation/parameters).
"""

SEEN_SIDE = (0.1, 0.2)
"""The same with lights to the side.

Unit: none. Chosen on: not known. Range: 0.5 to 1 times these values (validation/parameters).
"""

FILMS_STEPS = 10
"""Gauss-Newton steps.

Unit: none. Chosen on: speed. Range: 10 to 14 (validation/parameters).
"""

SOLVER_STEPS = 40
"""Conjugate gradients in each step.

Unit: none. Chosen on: speed. Range: none within 0.7 to 1.4 (validation/parameters).
"""

MAX_SLOPE_STEP = 0.6
"""Largest change of a slope in one step, but for a few pixels.

Unit: slope. Chosen on: judgement. Range: 0.42 to 1.2 (validation/parameters).
"""

LOWEST = (1e-9, 0.06, 0.3, 0.3, -8.0)
"""Lower bounds of the fields of `SpecularModel`.

Unit: those of the fields. Chosen on: judgement. Range: not known.
"""

HIGHEST = (1e9, 0.8, 8.0, 1.5, 8.0)
"""Upper bounds of the fields of `SpecularModel`.

Unit: those of the fields. Chosen on: judgement. Range: not known.
"""

PRIOR_WEIGHTS = (1e-6, 1e-6, 1.0, 1.0, 0.1)
"""Weights of the priors on the model's change, relative to the images.

Unit: none. Chosen on: not known. Range: 0.5 to 2 times these values (validation/parameters).
"""

MAX_CHANGE = (0.25, 0.25, 0.25, 0.25, 1.5)
"""Largest change of the model in one step: logarithms of its first four fields, and the lift.

Unit: none, and mm. Chosen on: judgement. Range: 0.7 to 2 times these values
(validation/parameters).
"""

RAISED_MM = 1.0
"""Step of the derivative by the finger's lift.

Unit: mm. Chosen on: judgement. Range: 0.5 to 2 (validation/parameters).
"""

STRIPES = 12
"""Chunks of rows from which the model is fitted, about.

Unit: none. Chosen on: speed. Range: not known.
"""

LIGHT_ROWS = 8
"""Rows over which light changes little.

Unit: px. Chosen on: speed. Range: 4 to 16 (validation/parameters).
"""

FACET_FIELDS = 2
"""Chunks are smaller by this factor: a facet has many numbers.

Unit: none. Chosen on: speed. Range: any (the result is the same).
"""

SHADOW_STEPS = 4
"""Steps after which cast shadows are computed again.

Unit: none. Chosen on: speed. Range: 2 to 8 (validation/parameters).
"""

PENUMBRA = 0.05
"""Half the tangent over which shadows are soft: the LED's size, and the surface's error.

Unit: none. Chosen on: not known. Range: 0.025 to 0.1 (validation/parameters).
"""

SHADOW_PX = (*range(1, 13), 14, 16, 19, 22, 26, 31, 38, 47, 60, 80, 110, 160)
"""Distances at which the surface may block the light.

Unit: px. Chosen on: speed. Range: not known.
"""

PRIOR_GAIN = 0.02
"""Weight of a brightness of one, over that of the images.

Unit: none. Chosen on: not known. Range: 0.01 to 0.04 (validation/parameters).
"""

GAINS = (0.15, 3.0)
"""Bounds of a light's brightness.

Unit: none. Chosen on: judgement. Range: not known.
"""

FIRST_MISFIT = 0.8
"""Residual of a light to the side, over its image (rms), from which it waits: glints of oily skin
fit later. Those of a path-traced finger leave 0.36 at first and 0.09 at last; lights whose films
are turned, so that what they reflect does not pass the camera's, leave 0.82 to 13.

Unit: fraction. Chosen on: path-traced fingers. Range: 0.36 to 0.82 (what it separates).
"""

LATE_MISFIT = 0.5
"""The same in the second half of the steps.

Unit: fraction. Chosen on: path-traced fingers. Range: 0.09 to 0.82 (what it separates).
"""

AVERAGED_MM = 0.1
"""Sigma of the Gaussian mean of the information matrix.

Unit: mm. Chosen on: not known. Range: 0.07 to 0.2 (validation/parameters).
"""

FILMS_RIDGE_MM = 0.3
"""Sigma of the Gaussian mean that separates ridges from shape.

Unit: mm. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

FILM_ERROR_DEG = (0, 15, 30, 45, 60, 75)
"""Slants at which `FILM_ERROR` is given.

Unit: deg. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: not known.
"""

FILM_ERROR = (0.03, 0.05, 0.1, 0.25, 0.5, 1.0)
"""Error of the heights measured by films, as they are weighed, by slant: over the ridges' rms.

Unit: fraction. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: 0.5 to 1 times these values (validation/parameters).
"""

NOISE_ERROR_MM = 0.04
"""The same over the standard deviation of a slope by noise, on skin that faces the camera.

Unit: mm. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py). Range:
none within 0.7 to 1.4 (validation/parameters).
"""

START_ERROR = 0.9
"""Error of the start's ridges over their stated one.

Unit: none. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: none within 0.7 to 1.4 (validation/parameters).
"""

ERROR_CORRELATION = 0.6
"""Correlation of the start's error with that of the films.

Unit: none. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: 0.42 to 0.84 (validation/parameters).
"""

STATED_DEG = (7.5, 22.5, 37.5, 52.5, 75)
"""Slants of the errors below, which are those that are stated.

Unit: deg. Chosen on: judgement. Range: not known.
"""

BEND_ERROR = (0.8, 1.05, 1.5, 1.8, 3.5)
"""Without lights to the side, by slant: error over the variance of the lens's blur times the
ridges' curvature.

Unit: none. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: 0.5 to 1.4 times these values (validation/parameters).
"""

GAIN_ERROR = 0.05
"""Error of the gain, over the square of scattered over specular light.

Unit: none. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: 0.025 to 0.1 (validation/parameters).
"""

MAX_GAIN_ERROR = 0.2
"""Largest error of the gain.

Unit: fraction. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: not known.
"""

GLINTS = 1.6
"""Rms slope of the ridges over roughness from which the bend's error grows with it: glints hide
what lies between them.

Unit: none. Chosen on: simulated fingers (a, c and g of validation/path_traced/drawn_films.py).
Range: 1.12 to 3.2 (validation/parameters).
"""

SIDE_ERROR = (0.03, 0.2, 0.32, 0.05, 0.3)
"""With lights to the side and no films, by slant: error over the ridges' height times their slope.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

SIDE_ERROR_FILMS = (0.01, 0.09, 0.24, 0.04, 0.37)
"""The same with films too.

Unit: none. Chosen on: simulated fingers (i and j of validation/path_traced/drawn_films.py). Range:
none within 0.7 to 1.4 (validation/parameters).
"""

SIDE_GAIN_ERROR = 0.1
"""Error of the gain with lights to the side and no films.

Unit: fraction. Chosen on: not known. Range: 0.07 to 0.1 (validation/parameters).
"""

SIDE_GAIN_ERROR_FILMS = 0.035
"""The same with films too.

Unit: fraction. Chosen on: simulated fingers (i and j of validation/path_traced/drawn_films.py).
Range: 0.0175 to 0.07 (validation/parameters).
"""

TYPICAL_CHI_SQUARE = 0.4
"""Typical reduced chi-square. The stated variance scales with its power 3/4.

Unit: none. Chosen on: simulated fingers (i and j of validation/path_traced/drawn_films.py). Range:
none within 0.7 to 1.4 (validation/parameters).
"""

# --- relief

WINDOW_OVERLAP = 4
"""Windows advance by their side over this number.

Unit: none. Chosen on: speed. Range: 2 to 8 (validation/parameters).
"""

DENOISE_WINDOW_MM = 1.7
"""Side of a window: about four ridges.

Unit: mm. Chosen on: not known. Range: 1.19 to 3.4 (validation/parameters).
"""

NOISE_CAUTION = 1.5
"""Factor on the noise's power where a window's own power is estimated.

Unit: none. Chosen on: not known. Range: 0.75 to 3 (validation/parameters).
"""

CROSSOVER_MM = 0.3
"""Standard deviation of the Gaussian that leaves the shape's frequencies to the coarse grid.

Unit: mm. Chosen on: not known. Range: 0.3 to 0.42 (validation/parameters).
"""

RIDGE_RANGE_PER_MM = (9.0, 24.0)
"""Angular frequencies of ridges: periods of 0.70 to 0.26 mm, as seen from above.

Unit: rad/mm. Chosen on: judgement. Range: 0.7 to 2 times these values (validation/parameters).
"""

KNIT_MM = 0.5
"""Standard deviation of the Gaussian that separates relief and shape in the result.

Unit: mm. Chosen on: not known. Range: 0.35 to 0.5 (validation/parameters).
"""

RIDGE_TRUST = 4.0
"""Factor on the expected power of the ridges, so that the unmixing shrinks them less than the
least-squares optimum.

Unit: none. Chosen on: not known. Range: 4 to 5.6 (validation/parameters).
"""

COLOUR_STEPS = 2
"""Corrections of the relief in each round.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

COLOUR_MODEL_ERROR = 0.5
"""Error of the relief that is not noise (specular reflection taken for relief, flanks too steep to
be resolved), over the relief's local rms height.

Unit: fraction. Chosen on: simulated fingers (validation/accuracy). Range: none within 0.7 to 1.4
(validation/parameters).
"""

# --- shape

START_ROUNDS = 2
"""Rounds of photometric stereo and integration for the first shape.

Unit: none. Chosen on: not known. Range: 1 to 4 (validation/parameters).
"""

SHAPE_KNEE_PER_MM = 5.0
"""Angular frequency from which the shape's slopes are expected to fall off.

Unit: rad/mm. Chosen on: not known. Range: 3.5 to 10 (validation/parameters).
"""

GLARE_RATIO = 0.16
"""Apparent slope of the specular reflection (in red) over the shape's slopes at low frequencies.

Unit: none. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""

NOISE_RATIO = 0.1
"""Noise of the slopes over the shape's slopes at low frequencies.

Unit: none. Chosen on: not known. Range: 0.1 to 0.14 (validation/parameters).
"""

SHAPE_CUTOFF_PER_MM = 8.0
"""Angular frequency beyond which slopes are left to the fine grid.

Unit: rad/mm. Chosen on: not known. Range: 5.6 to 16 (validation/parameters).
"""

MAX_SPECULAR = 1.0
"""Largest specular reflection that is predicted, over that of a clean boundary with the skin's
refractive index. What is left over is separated by its colour; what is predicted in excess becomes
relief that is not there.

Unit: fraction. Chosen on: not known. Range: none within 0.7 to 1.4 (validation/parameters).
"""
