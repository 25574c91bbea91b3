"""Meaning and remedy of each code of a finding of the rig's verbs."""

from __future__ import annotations

from splitknit.diagnosis.codes import Code

CODES: dict[str, Code] = {
    # calibrate camera
    "uncertain-focal-length": Code(
        "The photographs leave the focal length uncertain.",
        "Tilt the board by 20 to 40 deg to several sides.",
    ),
    "parallel-boards": Code(
        "The boards lie nearly parallel.", "Tilt the board by 20 to 40 deg to several sides."
    ),
    "held-principal-point": Code(
        "The photographs do not determine the principal point; the image's middle was taken.",
        "Take more photographs, the board tilted differently in each.",
    ),
    "uncovered-picture": Code(
        "The boards cover little of the picture; outside them the distortion is a guess.",
        "Let the board reach into every corner.",
    ),
    "other-camera-height": Code(
        "The camera stands higher or lower than its rig file states.", "Check `--square-mm`."
    ),
    "unmeasured-height": Code(
        "The scale rests on a height of the camera that was not measured.",
        "Photograph the board flat on the finger plane (`--plane`).",
    ),
    "oblique-camera": Code(
        "The camera is tilted against the base.",
        "Straighten the camera, or put something thin under the base.",
    ),
    "planes-disagree": Code(
        "The photographs of the finger plane disagree.", "Lay the print flat; measure its squares."
    ),
    "uneven-print": Code(
        "Marks on the finger plane do not fit the print.", "Use a flat print; check `--board`."
    ),
    # calibrate lights
    "one-nail-position": Code(
        "The nail stood in one place only, so the directions are unchecked.",
        "Photograph it in a second place.",
    ),
    "stray-tips": Code(
        "Shadow tips that contradict all others were given little weight.",
        "Correct their pixels.",
    ),
    "one-band": Code("The table has LEDs of one band only.", "Add the rows of the other."),
    "kept-leds": Code(
        "LEDs that would be refused were kept (`--keep`).",
        "Correct the pixels, or photograph the nail again under these LEDs.",
    ),
    "side-lights-kept": Code(
        "The side lights keep the places that the rig file had.",
        "Measure them with a ball (`--sphere`).",
    ),
    "shadow-out-of-view": Code(
        "A shadow of the nail leaves the picture.", "Use a shorter nail or move it to the middle."
    ),
    "unchecked-mask": Code(
        "The ball's rim was not found near its outline, which is unchecked.",
        "Check that the outline follows the rim.",
    ),
    "corrected-mask": Code(
        "A ball's outline lies beside its rim; the rim was used.", "Correct the outline."
    ),
    "found-ball": Code(
        "No outline was given; the largest round object is taken for the ball.",
        "If it is another object, give the ball's outline (`--ball`).",
    ),
    "uncertain-distances": Code(
        "The glints do not determine the lights' distances; directions were written.",
        "Use matt ground (`--ground`), or two balls and a rig with the camera (`--rig`).",
    ),
    "glints-disagree": Code(
        "The glints on the balls do not fit one place for each light.",
        "Check outlines and scale.",
    ),
    "ground-departs": Code(
        "The ground is not matt or not flat; the lights' distances are less certain.",
        "Put the balls on matt paper.",
    ),
    "lights-left-out": Code(
        "Lights without a glint on a ball's front are left out.",
        "Nothing; or move the ball to where these lights reach it.",
    ),
    "directions-only": Code(
        "An .lp file holds directions; the distances are lost.", "Write a .txt or a rig file."
    ),
    # calibrate radiometry
    "no-ambient-image": Code(
        "There is no ambient image: ambient light and black level count as the LEDs' light.",
        "Take one with all LEDs off.",
    ),
    "uneven-beam": Code(
        "An LED's light does not fit the model of a beam.",
        "Frost the LED, and look for what shadows the card.",
    ),
    "glossy-card": Code("The card is glossy.", "Use a matt card."),
    # calibrate polarisers
    "film-leak": Code(
        "Much specular light remains in the crossed image.",
        "Turn the LED's film or the analyser.",
    ),
    # capture
    "nominal-leds": Code(
        "No rig file was given, and the LEDs' nominal positions are assumed.",
        "Calibrate the rig and name its file (`--rig`).",
    ),
    "untested-camera": Code("The camera was not tested on hardware.", "Look at the first frames."),
    "simulated-target": Code("The twin photographed a target, not a finger.", "Nothing."),
}
"""Codes that the core also uses, such as ``ambient-light``, are in
:data:`splitknit.diagnosis.codes.CODES`."""
