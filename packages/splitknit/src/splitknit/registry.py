"""Which verbs there are, and which distribution brings each: members register theirs by entry points.

An entry point of the group ``splitknit.verbs`` has the verb as its name (``match``, ``calibrate camera``) and names a
function: its signature and docstring make the options and the help. The group ``splitknit.imports`` extends a verb of
the core, ``splitknit.devices`` names what ``capture`` photographs with.
The module imports next to nothing, so that ``splitknit --help`` is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
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
        "turn photographs and light directions into a capture folder (--images), or prints of other systems into PNG",
    ),
    "reconstruct": (CORE, "turn a capture folder, or photographs, into a 3D fingerprint"),
    "separate": (CORE, "split images under fine patterns into direct and global light, or polarised ones"),
    "capture": (RIG, "photograph a finger under all LEDs: with the rig, or with its twin"),
    "calibrate": (RIG, "measure a rig: its camera, its lights, its sensor, its films"),
    "rig": (RIG, "draw the targets that calibrate a rig"),
    "evaluate": (MATCH, "error rates of anybody's scores, with confidence intervals"),
    "compare": (MATCH, "how two measurements of one finger differ, laid on each other"),
    "match": (MATCH, "report how similar two fingers are"),
    "enroll": (MATCH, "put fingers into a gallery, which is made where there is none"),
    "identify": (MATCH, "find a finger in a gallery, or check whose it is said to be"),
    "gallery": (MATCH, "look into a gallery, remove from it, export and import it"),
    "export": (MATCH, "write fingers as records, images and meshes that other systems read"),
    "records": (MATCH, "what a file of another system is, and what it holds"),
    "serve": (MATCH, "serve a gallery over HTTP: enrol, identify, verify, quality"),
    "batch": (MATCH, "reconstruct and compare a whole population, or what of it is missing"),
    "profile": (CORE, "cut a surface between two points, and measure its roughness there"),
    "print": (MATCH, "turn a finger in space into a flat print of 500 pixels per inch"),
    "pad": (MATCH, "detect presentation attacks: was live skin photographed, or a copy, or is that unknown"),
}
"""The verbs of all members in the order of ``--help``, each with its distribution and its line of help."""
_SCANNED = "lay another scanner's points on a grid from a checkout, with 'python validation/scanners/cloud.py'."
GONE: dict[str, str] = {
    "enroll --set": "templates are made in one way; leave it out.",
    "identify --set": "templates are made in one way; leave it out.",
    "completion": "the options of a verb are in its '--help', and a typo is answered by what was meant.",
    "forget": "'gallery remove' erases a person from a gallery; docs/guide/data-protection.md lists the other files.",
    "gallery index": "up to some 100,000 captures are searched by an index in memory; leave the command out.",
    "gallery migrate": "use 'gallery export' of the program that wrote the gallery, and 'gallery import' of this one.",
    "gallery rekey": "use 'gallery export', and 'gallery import' into a new file under the other key.",
    "gallery repair": "what is damaged is named when it is read: 'gallery remove' takes it out.",
    "gallery check": "a gallery is checked whenever it is opened.",
    "gallery export --images": "a gallery keeps no pictures any more; keep the captures themselves.",
    "gallery remove --row": "use '--person', '--finger' and '--session'.",
    "enroll --keep-images": "keep the captures themselves, in a folder of your own.",
    "identify --search": "leave it out: up to 200 captures all are compared, of more those whose minutiae agree best.",
    "export --date": "it was for ANSI/NIST-ITL, which is only read.",
    "export --device": "it was for ANSI/NIST-ITL, which is only read.",
    "export --key-file": "galleries are not exported as records; export the prints that were enrolled.",
    "export --to ansi-nist-itl": "write iso-39794-4 or iso-19794-4; transactions are only read.",
    "export --to iso-19794-2-2011": "write iso-19794-2 (of 2005).",
    "export --to iso-19794-4-2011": "write iso-39794-4, which states the print's quality as well.",
    "print --set": "prints are made in one way; leave it out.",
    "records what --out": "read its minutiae with 'read_prints' (docs/reference/records.md) and draw them yourself.",
    "identify --shards": "leave it out: an index in memory serves up to some 100,000 captures.",
    "calibrate lights --nail-seen": "mark the nail's tip in the table.",
    "calibrate shading": "gel sensors are not calibrated any more; lights of opaque things are, with a ball or a nail.",
    "reconstruct --frames": "reconstruct each colour photograph by itself.",
    "reconstruct --level": "it was for gel sensors.",
    "reconstruct --shading": "give the lights of an opaque thing by '--lights' and '--flat'.",
    "separate --block": "shifted checkerboards are separated; one image is in validation/separation.",
    "separate --method": "shifted checkerboards are separated; other patterns are in validation/separation.",
    "view": "open report.html in the result's folder: it shows the surface in three dimensions.",
    "import --unit": _SCANNED,
    "import --up": _SCANNED,
    "import --pitch": _SCANNED,
    "import --people": "import a tree of people from a checkout, with 'python validation/thesis/people.py'.",
    "import --table": "make a rig file with 'splitknit calibrate lights --table', and give it to --lights.",
    "rig cad": "draw the parts from a checkout, with 'python -m hardware.draw' (docs/guide/rig-build.md).",
    "rig circuit": "design the board from a checkout, with 'python -m hardware.circuit' (docs/guide/rig-circuit.md).",
    "rig phantom": "draw it from a checkout, with 'python -m hardware.phantom'.",
    "rig optimise": "sweep rigs from a checkout, with 'python validation/thesis/rigs.py'.",
    "match --method voted": "use 'python validation/published/voted.py A B' from a checkout.",
    "match --method minutiae3d": "use 'python validation/published/minutiae3d.py A B' from a checkout.",
    "match --method tetrahedra": "use 'python validation/published/tetrahedra.py A B' from a checkout.",
    "match --method surface-code": "use 'python validation/published/surface_code.py A B' from a checkout.",
    "print --pores": "use 'python validation/published/pores.py A B' from a checkout.",
    "simulate --scanner": "use 'python validation/scanners/run.py --system NAME' from a checkout.",
    "evaluate --fuse llr": "use 'trained', 'linear' or 'minmax'; validation/published/knuckles.py has these ratios.",
    "evaluate --exclude": "leave the lines of those fingers out of the score file.",
    "batch --cluster": "use '--scheduler' (docs/guide/batch.md).",
    "batch --cluster-ca": "name certificates in Dask's configuration (docs/guide/batch.md).",
    "batch --cluster-cert": "name certificates in Dask's configuration (docs/guide/batch.md).",
    "batch --cluster-key": "name certificates in Dask's configuration (docs/guide/batch.md).",
    "batch --csv": "score files are in STORE/csv.",
    "batch --insecure-cluster": "use tls://, or a tunnel to tcp://127.0.0.1 (docs/guide/batch.md).",
    "train": "use the scripts of training/ from a checkout: 'python training/shape.py --out DIR'.",
}
"""Verbs and options that left (``forget``, ``print --pores``), each with what to use instead, as one sentence."""


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

    module, _, names = value.partition(":")
    found = import_module(module)
    for name in names.split(".") if names else ():
        found = getattr(found, name)
    return found


def verbs_known() -> list[str]:
    """First words of all verbs: those of the program's own members, then anybody else's."""
    return list(dict.fromkeys((*VERBS, *(name.split(" ")[0] for name in registered(GROUP)))))


def objects_of(verb: str) -> dict[str, str]:
    """A verb's functions by what follows it (nothing, or ``camera`` ... of ``calibrate``); none where not installed."""
    functions = registered(GROUP, VERBS[verb][0] if verb in VERBS else None)
    return {name[len(verb) :].strip(): value for name, value in functions.items() if name.split(" ")[0] == verb}


def refusal(words: Sequence[str]) -> str:
    """Why the first word is no verb that can run, or why an option is none any more; nothing if all is well."""
    typed = " ".join(words).replace("=", " ") + " "
    for name, instead in GONE.items():
        verb, _, option = name.partition(" --")
        if typed.startswith(f"{verb} ") and (not option or f" --{option} " in typed):
            return f"'{name}' left the program: {instead}"
    verb = next((word for word in words if not word.startswith("-")), "")
    if verb and verb not in VERBS and verb not in verbs_known():
        from difflib import get_close_matches

        near = get_close_matches(verb, VERBS, 1)
        hint = f"did you mean '{near[0]}'?" if near else "'splitknit --help' lists them."
        return f"there is no verb {verb[:100]!a}; {hint}"
    if verb in VERBS and not objects_of(verb):
        return not_installed(f"'splitknit {verb}'", VERBS[verb][0])
    return ""


def extension(group: str, name: str, what: str, distribution: str) -> Any:
    """The object that a member registers for a part of a core's verb; BadInput, begun by `what`, if not installed."""
    value = registered(group).get(name)
    if value is None:
        from splitknit.errors import BadInput

        raise BadInput(not_installed(what, distribution))
    return load(value)


def not_installed(what: str, distribution: str) -> str:
    """One sentence on what is missing, and the command that adds it."""
    how = f"add it, in splitknit's folder, with 'pip install ./packages/{distribution}'."
    return f"{what} comes with {distribution}, which is not installed; {how}"
