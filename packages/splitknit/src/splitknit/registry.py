"""Which verbs there are, and which distribution brings each: members register theirs by entry points.

An entry point of the group ``splitknit.verbs`` has the verb as its name (``match``, ``calibrate camera``) and names a
:class:`splitknit.cli.verb.Verb`. The groups ``splitknit.imports`` and ``splitknit.views`` extend two verbs of the core.
The module imports next to nothing, so that ``splitknit --help`` is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

GROUP = "splitknit.verbs"
IMPORTS, VIEWS = "splitknit.imports", "splitknit.views"
CORE, SIMULATOR, RIG, MATCH = "splitknit", "splitknit-simulator", "splitknit-rig", "splitknit-match"
VERBS = {
    "demo": (SIMULATOR, "simulate a finger, reconstruct it, compare it with the truth"),
    "simulate": (
        SIMULATOR,
        "photograph a simulated finger, a population of them, or what calibrates a simulated rig",
    ),
    "import": (
        CORE,
        "turn photographs and light directions into a capture folder (--images), a point cloud into a result folder, "
        "or prints of other systems into PNG",
    ),
    "reconstruct": (CORE, "turn a capture folder, or photographs, into a 3D fingerprint"),
    "separate": (CORE, "split images under fine patterns into direct and global light, or polarised ones"),
    "train": (SIMULATOR, "train a network on simulated skin (needs torch)"),
    "capture": (RIG, "photograph a finger under all LEDs: with the rig, or with its twin"),
    "calibrate": (RIG, "measure a rig: its camera, its lights, its sensor, its films"),
    "rig": (RIG, "plan and build a rig: parts, circuit, dimensions"),
    "evaluate": (MATCH, "error rates of anybody's scores, with confidence intervals"),
    "compare": (MATCH, "how two measurements of one finger differ, laid on each other"),
    "match": (MATCH, "report how similar two fingers are"),
    "enroll": (MATCH, "put fingers into a gallery, which is made where there is none"),
    "identify": (MATCH, "find a finger in a gallery, or check whose it is said to be"),
    "gallery": (MATCH, "look into a gallery, remove from it, export, import and check it"),
    "export": (MATCH, "write fingers as records, images and meshes that other systems read"),
    "records": (MATCH, "what a file of another system is, and what it holds"),
    "serve": (MATCH, "serve a gallery over HTTP: enrol, identify, verify, quality"),
    "batch": (MATCH, "reconstruct and compare a whole population, or what of it is missing"),
    "view": (CORE, "look at results and photographs in the browser, on this machine only"),
    "profile": (CORE, "cut a surface between two points, and measure its roughness there"),
    "print": (MATCH, "turn a finger in space into a flat print of 500 pixels per inch"),
    "pad": (MATCH, "detect presentation attacks: was live skin photographed, or a copy, or is that unknown"),
    "completion": (CORE, "print a script that completes verbs and options in your shell"),
}
"""The verbs of all members in the order of ``--help``, each with its distribution and its line of help."""
GONE: dict[str, str] = {
    "forget": "'gallery remove' erases a person from a gallery; docs/guide/data-protection.md lists the other files.",
    "gallery index": "up to some 100,000 captures are searched by an index in memory; leave the command out.",
    "gallery migrate": "use 'gallery export' of the program that wrote the gallery, and 'gallery import' of this one.",
    "gallery rekey": "use 'gallery export', and 'gallery import' into a new file under the other key.",
    "gallery repair": "use 'gallery check', and 'gallery remove --row' for what it names.",
}
"""Verbs that left (``rig cad``, ``forget``), each with what to use instead, as one sentence."""


def registered(group: str, distribution: str | None = None) -> dict[str, str]:
    """Names and objects (``module:name``) that are registered, by one distribution or by all that are installed."""
    from importlib import metadata  # slow where many distributions are installed

    if distribution is None:
        found = {one.name: one.value for one in metadata.entry_points(group=group)}
    else:
        try:
            points = metadata.distribution(distribution).entry_points
        except metadata.PackageNotFoundError:
            points = metadata.EntryPoints()
        found = {one.name: one.value for one in points if one.group == group}
    return found


def load(value: str) -> Any:
    """Import the object of an entry point."""
    from importlib import import_module

    module, _, name = value.partition(":")
    found = import_module(module)
    return getattr(found, name) if name else found


def objects_of(verb: str) -> dict[str, str]:
    """A verb's objects by what follows it (nothing, or ``camera`` ... of ``calibrate``); none where not installed."""

    def those(names: dict[str, str]) -> dict[str, str]:
        return {name[len(verb) :].strip(): value for name, value in names.items() if name.split(" ")[0] == verb}

    return those(registered(GROUP, VERBS[verb][0] if verb in VERBS else None))


def extension(group: str, name: str, what: str, distribution: str) -> Any:
    """The object that a member registers for a part of a core's verb; BadInput, begun by `what`, if not installed."""
    value = registered(group).get(name)
    if value is None:
        from splitknit.errors import BadInput

        raise BadInput(not_installed(what, distribution))
    return load(value)


def not_installed(what: str, distribution: str) -> str:
    """One sentence on what is missing, and the command that adds it."""
    missing = [one for one in dict.fromkeys((SIMULATOR, distribution)) if not registered(GROUP, one)]
    folders = " ".join(f"./packages/{one}" for one in missing or [distribution])
    how = f"add it, in splitknit's folder, with 'pip install {folders}'."
    return f"{what} comes with {distribution}, which is not installed; {how}"
