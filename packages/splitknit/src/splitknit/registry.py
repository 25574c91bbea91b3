"""Which verbs there are, and which distribution brings each: members register theirs by entry
points.

An entry point of the group ``splitknit.verbs`` has the verb as its name (``match``, ``calibrate
camera``) and names a function: its signature and docstring make the options and the help. The group
``splitknit.imports`` extends a verb of the core, ``splitknit.devices`` names what ``capture``
photographs with, ``splitknit.matchers`` and ``splitknit.presets`` name what others add. The module
imports next to nothing, so that ``splitknit --help`` is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Any

GROUP = "splitknit.verbs"
IMPORTS, DEVICES = "splitknit.imports", "splitknit.devices"
CORE, SIMULATOR, RIG, MATCH = "splitknit", "splitknit-simulator", "splitknit-rig", "splitknit-match"
MEMBERS = (CORE, SIMULATOR, RIG, MATCH)
VERBS = {
    "demo": (SIMULATOR, "simulate a finger, reconstruct it, compare it with the truth"),
    "simulate": (
        SIMULATOR,
        "photograph a simulated finger, a population of them, or what calibrates a simulated rig",
    ),
    "import": (
        CORE,
        (
            "turn photographs and light directions into a capture folder (--images), or prints of"
            " other systems into PNG"
        ),
    ),
    "reconstruct": (CORE, "turn a capture folder, photographs or a normal map into a surface"),
    "capture": (RIG, "photograph a finger under all LEDs: with the rig, or with its twin"),
    "calibrate": (RIG, "measure a rig: its camera, its lights, its sensor, its films"),
    "rig": (RIG, "draw the targets that calibrate a rig; test a rig that was built"),
    "evaluate": (MATCH, "error rates of anybody's scores, with confidence intervals"),
    "compare": (MATCH, "how two measurements of one finger differ, laid on each other"),
    "match": (MATCH, "report how similar two fingers are"),
    "enroll": (MATCH, "put fingers into a gallery, which is made where there is none"),
    "identify": (MATCH, "find a finger in a gallery, or check whose it is said to be"),
    "gallery": (MATCH, "look into a gallery, remove from it, export and import it"),
    "export": (MATCH, "write fingers as records, images and meshes that other systems read"),
    "records": (MATCH, "identify a fingerprint record and list its contents"),
    "serve": (MATCH, "serve a gallery over HTTP: enrol, identify, verify, quality"),
    "batch": (MATCH, "reconstruct and compare a population"),
    "profile": (CORE, "cut a surface between two points, and measure its roughness there"),
    "print": (MATCH, "turn a finger in space into a flat print of 500 pixels per inch"),
}
"""The verbs of all members in the order of ``--help``, each with its distribution and its line of
help."""


def registered(group: str, distribution: str | None = None) -> dict[str, str]:
    """Names and objects (``module:name``) that are registered, by one distribution or by all that
    are installed."""
    from importlib import metadata  # slow where many distributions are installed

    if distribution is None:
        points = metadata.entry_points(group=group)
    else:
        try:
            points = metadata.distribution(distribution).entry_points.select(group=group)
        except metadata.PackageNotFoundError:
            return {}
    return {point.name: point.value for point in points}


def verbs_known() -> list[str]:
    """First words of all verbs: those of the program's own members, then anybody else's."""
    return list(dict.fromkeys((*VERBS, *(name.split(" ")[0] for name in registered(GROUP)))))


def objects_of(verb: str) -> dict[str, str]:
    """A verb's functions by what follows it (nothing, or ``camera`` ... of ``calibrate``); none
    where not installed."""
    functions = registered(GROUP, VERBS[verb][0] if verb in VERBS else None)
    return {
        name[len(verb) :].strip(): value
        for name, value in functions.items()
        if name.split(" ")[0] == verb
    }


def refusal(words: Sequence[str]) -> str:
    """Why the first word is no verb that can run; nothing if it is one."""
    verb = next((word for word in words if not word.startswith("-")), "")
    if verb and verb not in VERBS and verb not in verbs_known():
        from difflib import get_close_matches

        near = get_close_matches(verb, VERBS, 1)
        if near:
            return f"there is no verb {verb[:100]!a}; did you mean '{near[0]}'?"
        return f"there is no verb {verb[:100]!a}; 'splitknit --help' lists them."
    if verb in VERBS and not objects_of(verb):
        return not_installed(f"'splitknit {verb}'", VERBS[verb][0])
    return ""


def extension(group: str, name: str, what: str, distribution: str) -> Any:
    """The object that a member registers for a part of a core's verb; BadInput, begun by `what`, if
    not installed."""
    value = registered(group).get(name)
    if value is None:
        from splitknit.errors import BadInput

        raise BadInput(not_installed(what, distribution))
    from pkgutil import resolve_name

    return resolve_name(value)


def not_installed(what: str, distribution: str) -> str:
    """One sentence on what is missing, and the command that adds it."""
    return (
        f"{what} comes with {distribution}, which is not installed; add it, in splitknit's folder,"
        f" with 'pip install ./packages/{distribution}'."
    )


def own_object(kind: str, name: str, known: Iterable[str]) -> Any:
    """Somebody's own matcher or preset: an entry point of ``splitknit.matchers`` or
    ``splitknit.presets``, or named as MODULE:NAME. Raises BadInput."""
    from difflib import get_close_matches
    from pkgutil import resolve_name

    from splitknit.errors import refusing, require

    value = registered(f"splitknit.{kind}s").get(name, name)
    near = get_close_matches(name, known, 1)
    meant = f"; did you mean '{near[0]}'?" if near else "."
    require(
        ":" in value,
        f"there is no {kind} '{name}'; known are {', '.join(known)}, and your own as"
        f" MODULE:NAME{meant}",
    )
    with refusing(f"the {kind} '{name}' cannot be imported; is its module on PYTHONPATH?"):
        return resolve_name(value)
