"""Write JSON schemas of what verbs print with --json, from the classes that they return.

    python tools/make_json_schemas.py

writes docs/reference/schemas/VERB.json; the tests of galleries compare files and results.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union

from splitknit.findings import Finding
from splitknit.io.provenance import json_text
from splitknit_match.gallery.gallery import Enrolment
from splitknit_match.gallery.identify import Identification, RankedCandidate
from splitknit_match.matching.results import Match, MatchOfImages, MatchOfPrints, MatchOfRidges

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "reference" / "schemas"
VERBS = {
    "match": MatchOfRidges | MatchOfPrints | MatchOfImages | Match,
    "identify": Identification,
    "enroll": Enrolment,
}
PLAIN = {str: "string", bool: "boolean", int: "integer", float: "number", type(None): "null"}


def schema_of(kind: Any, known: dict[str, Any]) -> dict[str, Any]:
    """Schema of a type; those of classes go into `known`."""
    origin, inside = typing.get_origin(kind), typing.get_args(kind)
    if kind in PLAIN:
        return {"type": PLAIN[kind]}
    if origin is Literal:
        return {"enum": list(inside)}
    if origin in (Union, types.UnionType):
        return {"anyOf": [schema_of(part, known) for part in inside]}
    if origin is tuple or origin is list:
        return {"type": "array", "items": schema_of(inside[0], known)}
    if origin in (dict, Mapping):
        return {"type": "object", "additionalProperties": schema_of(inside[1], known)}
    if kind is Finding and kind.__name__ not in known:  # its facts
        text = {"type": "string"}
        fields = dict.fromkeys(("code", "severity", "message"), text)
        more = {"files": {"type": "array", "items": text}, "effect_deg": {"type": "number"}}
        known[kind.__name__] = {
            "type": "object",
            "properties": {**fields, **more},
            "required": list(fields),
        }
    elif kind.__name__ not in known:
        known[kind.__name__] = {}
        hints = typing.get_type_hints(kind, localns={"RankedCandidate": RankedCandidate})
        fields = {
            field.name: schema_of(hints[field.name], known) for field in dataclasses.fields(kind)
        }
        # as known_json leaves out
        needed = [field.name for field in dataclasses.fields(kind) if field.default is not None]
        known[kind.__name__] = {"type": "object", "properties": fields, "required": needed}
    return {"$ref": f"#/$defs/{kind.__name__}"}


def schema_of_verb(verb: str) -> dict[str, Any]:
    """JSON schema of what a verb prints."""
    known: dict[str, Any] = {}
    schema = schema_of(VERBS[verb], known)
    if verb == "enroll":  # prints the fields of its content beside the others
        content, whole = known.pop("GalleryContent"), known["Enrolment"]
        del whole["properties"]["content"]
        whole["properties"] |= content["properties"]
        whole["required"] = [
            *content["required"],
            *(name for name in whole["required"] if name != "content"),
        ]
    about = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"splitknit {verb} --json",
    }
    return {**about, **schema, "$defs": known}


def main() -> None:
    """Write them all."""
    FOLDER.mkdir(exist_ok=True)
    for verb in VERBS:
        (FOLDER / f"{verb}.json").write_text(json_text(schema_of_verb(verb)), encoding="utf-8")


if __name__ == "__main__":
    main()
