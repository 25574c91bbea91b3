"""What each code of a finding of the matching verbs means, what to do, and how often it came on
sound captures.

Findings of the photographs themselves have the core's codes
(:mod:`splitknit.diagnosis.codes`).
"""

from __future__ import annotations

from splitknit.diagnosis.codes import Code

_ADVICE = "no clean simulated finger (measured once; docs/experiments/prints.md)"

CODES: dict[str, Code] = {
    # prints and photographs that are read
    "odd-resolution": Code(
        "Ridges lie oddly far apart, or close, at the stated resolution.",
        "Give the true resolution (`--resolution-ppi`).",
        "0 of 320 real prints (validation/prints/any_print.py)",
    ),
    "square-pixels": Code(
        "Pixels of a print that were not square were made so.", "Nothing; or scan it again."
    ),
    "white-ridges": Code(
        "The ridges of a print are light, and have been turned dark.",
        "If they are not, say so (`--ridges dark`).",
        "0 of 320 real prints (validation/prints/any_print.py)",
    ),
    "unknown-polarity": Code(
        "A print does not show whether its ridges are dark, and they are taken for dark.",
        "Say it (`--ridges dark` or `light`); `match` and `identify` compare both.",
        "58 of 320 real prints (validation/prints/any_print.py)",
    ),
    "latent-print": Code(
        "A print is latent; false match rates are of live fingers.", "Do not rely on the rate."
    ),
    "not-a-print": Code(
        "A picture shows lines, but no print of a finger.", "Name a print of one finger."
    ),
    "failure-to-acquire": Code(
        "A source shows too few ridges or minutiae, and matches nobody.", "Capture it again."
    ),
    "fingerphoto": Code(
        "A picture was taken for a photograph of a finger; how its scale is known.",
        "Give `--px-per-mm` (of `match`: `--resolution-ppi`), or choose another finger (`--box`).",
    ),
    "fingerphoto-quality": Code(
        "The percentage of a photographed finger with clear ridges.",
        "Below 50: the one thing that its sentence names.",
    ),
    "fingerphoto-scale": Code(
        "A photograph matches best at another scale than was assumed.", "Give its scale."
    ),
    # quality of a print
    "weak-ridges": Code(
        "The ridges of a print are low.",
        "Moisten a dry finger, dry a wet one, check the focus.",
        _ADVICE,
    ),
    "missing-ridges": Code(
        "Ridges are missing on a part of the finger.",
        "Check focus and exposure, clean finger and lens.",
        _ADVICE,
    ),
    "gaps-in-ridges": Code(
        "The skin between ridges shows none.", "Wipe finger and lens, check the focus.", _ADVICE
    ),
    "noisy-ridges": Code(
        "Directions or distances of the ridges disagree.",
        "Wipe the finger, lengthen the exposure, keep still.",
        _ADVICE,
    ),
    "soft-ridges": Code(
        "The edges of the ridges are soft.", "Focus on the finger, keep it still.", _ADVICE
    ),
    "few-ridges": Code(
        "Few ridges are in view.", "Push the finger further in, its pad to the camera.", _ADVICE
    ),
    "off-centre": Code(
        "The ridges lie beside the finger's middle.", "Turn the pad to the camera.", _ADVICE
    ),
    # rolled prints
    "view-cut-off": Code(
        "The view in a mirror is cut off.", "Lay the finger in the middle between the mirrors."
    ),
    "view-left-out": Code(
        "The view in a mirror is cut off so much that it is not used.",
        "Lay the finger in the middle between the mirrors.",
    ),
    "no-finger-in-mirror": Code(
        "No finger was found in a mirror.", "Check the mirror's pose, and the light on its side."
    ),
    "light-only-mirror": Code("A mirror gives light, and no view for the print.", "Nothing."),
    "views-do-not-meet": Code(
        "The ridges of two views do not lie on each other, or may not.",
        "Check the mirror's pose, and that ridges are seen in it.",
    ),
    # comparisons
    "mirrored-print": Code(
        "Two prints match only if one is seen in a mirror.", "Turn one picture round."
    ),
    "unequal-scales": Code(
        "Two sides have different scales: prints match only at one scale of their ridges, or"
        " lengths of two surfaces differ.",
        "Check the resolution, or the scale, of both.",
    ),
    "no-minutiae": Code(
        "Some templates hold no minutiae, and were compared by ridges alone.",
        "Nothing; or enrol them again as prints.",
    ),
    # galleries
    "captures-left-out": Code(
        "Of a large gallery only captures whose minutiae agree best were compared; about 1 match"
        " in 100 is missed.",
        "Nothing; or name the person or finger.",
    ),
    "failures-in-gallery": Code(
        "Captures of the gallery are failures to acquire.", "Enrol these fingers again."
    ),
    "matches-another": Code(
        "What was enrolled matches another finger of the gallery.",
        "Check the names (`--duplicates` refuse, warn, allow).",
    ),
    "unlike-earlier": Code(
        "What was enrolled is unlike the earlier captures of the finger.", "Check the names."
    ),
    "low-chance": Code(
        "Another impression of an enrolled print would often not match it.",
        "Enrol another impression of the finger, of more skin or clearer.",
    ),
    "readable-by-others": Code(
        "Others on this computer can read a gallery or a key.", "`chmod 600`."
    ),
    "not-encrypted": Code(
        "Exported templates are personal data, and not encrypted.", "Keep the folder safe."
    ),
    "numbered-people": Code(
        "The people of an encrypted gallery are numbered in a report.", "Nothing."
    ),
    # batches and evaluation
    "captures-missing": Code(
        "Captures of the plan are not there yet.", "Run the same again when they are."
    ),
    "ignored-columns": Code("Columns of a score file were not read.", "Check their names."),
    "missing-scores": Code("Comparisons gave no score.", "Nothing; FAR and GAR count them."),
    "reversed-scores": Code(
        "Genuine scores are lower than impostor ones.",
        "Give `--dissimilarity` if they are distances.",
    ),
    "unresolved-far": Code(
        "There are too few impostor comparisons for a FAR.", "Make more of them."
    ),
    "rough-intervals": Code(
        "There is little to draw from, so that intervals are rough.", "Capture more fingers."
    ),
    "narrow-intervals": Code(
        "Fingers of one subject are similarly hard, so that intervals by finger are too narrow.",
        "Trust those by subject (`--cluster subject`).",
    ),
    "not-compared": Code("Two systems could not be compared.", "Score the same pairs with both."),
    "fused-systems": Code("How systems were fused, and their mean weights.", "Nothing."),
    "unnamed-subjects": Code(
        "A fusion may have learned from other fingers of those it was tested on.",
        "Name the subjects (columns subject_a, subject_b).",
    ),
    "missing-in-fusion": Code("Scores are missing in a fusion.", "See its sentence."),
    "same-measurement": Code(
        "Two surfaces are one measurement, so that nothing is shown.", "Name another measurement."
    ),
    "shifted-skin": Code(
        "Patches of skin have shifted between two measurements.", "Compare with `--elastic` too."
    ),
}
