"""What each code of a finding means, what to do, and how often it was wrong on sound captures."""

from __future__ import annotations

from typing import NamedTuple


class Code(NamedTuple):
    """One row of the documentation."""

    meaning: str
    remedy: str
    wrong: str = "not measured"
    """How often it came on sound captures."""


_FITS = "0 of 100 sound sets of objects (validation/objects)"

CODES: dict[str, Code] = {
    # what spoils a surface, or makes it doubtful
    "one-light": Code("All photographs are under one light.", "Light each LED alone."),
    "unequal-lights": Code(
        "The lights are not as bright as was stated or assumed.",
        "Calibrate their brightness, or let it be estimated.",
        "0 of 114 sound objects (validation/objects)",
    ),
    "strange-photograph": Code(
        "One photograph is not of the same thing under its own light.",
        "Check its file, or capture it again.",
        _FITS,
    ),
    "light-order": Code(
        "The photographs are in another order than their lights.",
        "List them in the same order.",
        _FITS,
    ),
    "light-frame": Code(
        "The lights were measured in another frame than x right, y up.",
        "Give `--light-frame`.",
        _FITS,
    ),
    "light-residual": Code(
        "Much of the light does not fit a matt surface under these lights.",
        "Check order, directions and brightness of the lights, the encoding and the background.",
        "shine and deep shadows leave much too",
    ),
    "glossy": Code(
        "The object shines, and a lobe of gloss is fitted with its surface.",
        "Mask one material where several differ.",
    ),
    "height-factor": Code(
        "The object is not matt: all its heights may be off by one factor.",
        "Compare a height that you know.",
        "errors over the stated deviation: rms 0.85 on 24 objects of which two are real",
    ),
    "no-surface": Code(
        "The slopes that were measured belong to no surface.", "Check the lights' directions."
    ),
    "normals-y": Code(
        "y of a normal map points down, or not where it was stated to: only so its slopes have"
        " little curl.",
        "Check `--normals-y`.",
    ),
    "normals-contradicted": Code(
        "The photographs contradict the normal map in a part of the surface.",
        "Look at misfit.png: gloss and shadows contradict true normals too.",
        "0 of 1 with scanned normals (DiLiGenT's bear)",
    ),
    "hollow": Code(
        "The object comes out hollow; a hill under lights turned by 180 deg looks the same.",
        "Look at it.",
    ),
    "several-fingers": Code(
        "Several fingers are in view, and one is reconstructed.",
        "Photograph one alone, or mark it in a mask.",
    ),
    "odd-finger-width": Code(
        "The finger is oddly wide or narrow.", "Check the scale, or the mask."
    ),
    "odd-depth": Code("The surface is oddly deep.", "Check the lights and the scale."),
    "odd-ridge-period": Code(
        "The ridges lie oddly far apart or close.", "Check the scale.", "people differ by 8 %"
    ),
    "clipped-photograph": Code(
        "A fifth of the finger is clipped in one photograph.",
        "Shorten the exposure.",
        "0 of 180 sound fingers",
    ),
    "swapped-colours": Code(
        "The files hold blue, green, red in this order.",
        "Swap the channels.",
        "0 of 180 sound fingers",
    ),
    "white-balance": Code(
        "The camera balanced white anew for each photograph.",
        "Fix white balance and exposure.",
        "0 of 180 sound fingers",
    ),
    "other-encoding": Code(
        "The photographs are stored as srgb where linear was stated, or the other way round.",
        "State the other one.",
        "0 of 14 sound objects of gloss and metal",
    ),
    "tone-curve": Code(
        "Stored values are not in proportion to light: a gamma, tone curve or night mode.",
        "Store RAW or linear images.",
        "0 of 126 sound fingers",
    ),
    "flat-finger": Code(
        "The finger comes out too flat.", "Store RAW or linear images.", "0 of 144 sound fingers"
    ),
    "drifted-led": Code(
        "An LED is no longer as bright as at the calibration.", "Calibrate the brightness again."
    ),
    "led-places": Code(
        "The LEDs seem to stand elsewhere than the rig states.",
        "Measure their positions, or calibrate the lights.",
        "noted for 6 of some 230 sound fingers, doubted for none",
    ),
    "near-lights": Code(
        "Lights that were stated as directions are near; places were fitted to the ground.",
        "Give their places (`calibrate lights`).",
        "0 of 114 rendered sets under distant lights",
    ),
    "bare-patch": Code(
        "A part of the finger shows no ridges although it is lit, as under a plaster.",
        "Take off what covers it.",
        "noted for 0 of 185 sound fingers",
    ),
    "other-ridges": Code(
        "One photograph shows other ridges than the rest.",
        "Capture it again.",
        "0 of 386 sound fingers",
    ),
    "other-outline": Code(
        "The near-infrared photographs show another outline.", "Capture both bands in one go."
    ),
    "jpeg": Code(
        "The photographs were saved as JPEG, which loses ridges.", "Save PNG, TIFF or RAW."
    ),
    "sharpened-photographs": Code(
        "The camera, or a program, sharpened the photographs: ridges come out too high.",
        "Switch sharpening off, or store RAW images.",
        "0 of 93 sound fingers",
    ),
    "inverted-mask": Code(
        "The mask holds what lies around the object.", "Paint the object white, all else black."
    ),
    # photographs that were left out, in whole or in part
    "overexposed-photograph": Code(
        "Clipped values of a photograph were not used.", "Shorten the exposure.", _FITS
    ),
    "underexposed-photograph": Code("A photograph was too dark to use.", "Check its light.", _FITS),
    "moved-photograph": Code(
        "A photograph is shifted against the others.", "Capture it again.", _FITS
    ),
    "blurred-photograph": Code(
        "A photograph is blurred against the others.", "Capture it again.", _FITS
    ),
    "double-photograph": Code("A photograph shows everything twice.", "Capture it again.", _FITS),
    "unlike-photograph": Code("A photograph does not fit the others.", "Capture it again.", _FITS),
    # how good the photographs are
    "dark-photographs": Code("The photographs are dark.", "Lengthen the exposure."),
    "saturated-photograph": Code(
        "A part of the finger is saturated.", "Shorten the exposure, or dry the finger."
    ),
    "faint-ridges": Code(
        "Ridges hardly show.", "Focus the camera, clean the lens, dry or moisten the finger."
    ),
    "dark-specks": Code("Dark specks lie on the finger.", "Wipe the finger, and the lens."),
    "bright-specks": Code(
        "Bright specks lie on the finger.", "Wipe the finger, or moisten its skin."
    ),
    "ambient-light": Code(
        "Much light comes from elsewhere.",
        "Close the box, dim the room, or give `--background`.",
        "0 of 119 sound objects (validation/objects)",
    ),
    "dead-led": Code("A photograph is almost black.", "Check the LED's wiring."),
    "led-brightness": Code(
        "A photograph is not as bright as the rig promises.", "Check the LED, or calibrate again."
    ),
    "short-finger": Code("Little of the finger is in view.", "Push it further in."),
    "finger-crosses-view": Code("The finger's tip is not in view.", "Move it back."),
    "moved-finger": Code(
        "The finger moved between the shots.", "Rest it on its support, and capture again."
    ),
    "undone-motion": Code(
        "The finger moved; that was undone.", "Nothing; a still finger shows finer ridges."
    ),
    "few-lights": Code("Three or four lights leave little to check.", "Use seven."),
    "not-specular": Code(
        "The series through parallel films is not the brighter one.", "Exchange the series."
    ),
    "series-order": Code(
        "Both polarised series are not in one order of lights.", "List both in the same order."
    ),
    "side-moved": Code(
        "Photographs lit from the side were taken of a moved finger, and not used.",
        "Capture again.",
    ),
    # what was assumed, or could not be measured
    "scale-unknown": Code(
        "Nobody has measured the scale: heights are in pixels.", "Give `--px-per-mm`."
    ),
    "scale-of-ridges": Code(
        "The scale was taken from the ridges.", "Measure it: people differ by 8 %."
    ),
    "odd-view": Code("The pictures show an oddly large or small place.", "Check the scale."),
    "odd-camera-height": Code("The camera stands oddly high or low.", "Check the board's squares."),
    "odd-led-distance": Code("LEDs stand oddly near or far.", "Check the unit of position_mm."),
    "odd-top": Code("The setting `top_mm` is odd.", "Check it."),
    "odd-relief": Code(
        "The ridges are oddly high.", "Say what is not live skin (`--material opaque`)."
    ),
    "assumed-encoding": Code(
        "The encoding of the photographs was assumed.", "State it (`--encoding`)."
    ),
    "assumed-mask": Code(
        "The mask was found beside the photographs, or in them.", "Give it, or none (`--mask all`)."
    ),
    "outline-at-border": Code(
        "The outline that was found touches a border of the image, and may hold what lies behind.",
        "Look at it in the report, or give a mask (`--mask`).",
    ),
    "background-left-out": Code(
        "What lies behind the object reaches a border of the image and was left out.",
        "Look at the outline in the report, or give a mask (`--mask`).",
    ),
    "part-left-out": Code(
        "The outline that was found leaves out a part of the object.", "Give a mask (`--mask`)."
    ),
    "skipped-files": Code("Files of the folder were not used.", "Look at their names."),
    "turned-photographs": Code(
        "The photographs were turned as their EXIF data say.", "Give lights for them upright."
    ),
    "composed-colours": Code(
        "Coloured exposures were put together from white ones.", "Capture under coloured LEDs."
    ),
    "unsure-tip": Code(
        "Which way the finger's tip points is not clear.", "Give `--tip-direction`."
    ),
    "crease": Code("The finger was cut at its first flexion crease.", "Nothing."),
    "no-crease": Code(
        "No flexion crease is in view; all of the finger is kept.", "Nothing, or show more of it."
    ),
    "no-nir": Code("The shape comes from white light.", "Capture near-infrared photographs."),
    "estimated-brightness": Code("The brightness of the lights was estimated.", "Calibrate it."),
    "grey-photographs": Code(
        "Grey photographs do not tell glare from skin.", "Take colour photographs."
    ),
    "no-network": Code(
        "The network of the relief could not be used.", "Use six white lights, 12 px/mm or more."
    ),
    "specular-unused": Code("The specular reflection was not used.", "See its sentence."),
    "side-unused": Code("Photographs lit from the side were not used.", "Use the preset metric."),
    "side-misfit": Code("Photographs lit from the side do not fit.", "Calibrate their lights."),
    "hardly-measured": Code(
        "The ridges are hardly measured.", "More pixels a millimetre, better focus."
    ),
    "wet-finger": Code(
        "Much of the finger's light is specular reflection: ridges may be too low by half.",
        "Dry the finger, or use polarising films.",
        "0 of 22 dry fingers, 1 of 6 of the darkest skin",
    ),
    "little-gloss": Code("The ridges' common factor is not well known.", "Use polarising films."),
    "steep-walls": Code(
        "The object has walls, where heights drop too little.", "Photograph it from another side."
    ),
    "mirror-outline": Code(
        "A mirror's outline disagrees with the others.", "Check mirrors and their light."
    ),
}
