"""JSON schemas of verbs: made of the classes, and true of what the verbs print."""

import json
import runpy
from pathlib import Path

import pytest

from splitknit.cli.main import main
from splitknit.io.prints import write_print_png

from test_open_gallery import press  # isort: skip

SCRIPT = Path(__file__).resolve().parents[4] / "tools" / "make_json_schemas.py"
KINDS = {
    "string": str,
    "boolean": bool,
    "integer": int,
    "number": (int, float),
    "null": type(None),
    "array": list,
}


def check(value, schema, known):
    """Hold a value against the part of JSON Schema that is used, with no field that it does not
    name."""
    if "$ref" in schema:
        schema = known[schema["$ref"].removeprefix("#/$defs/")]
        assert set(schema["required"]) <= set(value) <= set(schema["properties"]), set(value) ^ set(
            schema["properties"]
        )
        for name, field_value in value.items():
            check(field_value, schema["properties"][name], known)
    elif "anyOf" in schema:
        failed = []
        for alternative in schema["anyOf"]:
            try:
                check(value, alternative, known)
            except (AssertionError, TypeError) as error:
                failed.append(error)
        assert len(failed) < len(schema["anyOf"]), (value, schema)
    elif schema["type"] == "object":
        for element in value.values():
            check(element, schema["additionalProperties"], known)
    else:
        assert isinstance(value, KINDS[schema["type"]]), (value, schema)
        for element in value if schema["type"] == "array" else ():
            check(element, schema["items"], known)


@pytest.mark.slow
def test_schemas_are_true(tmp_path, capsys):
    script = runpy.run_path(str(SCRIPT))
    write_print_png(tmp_path / "a.png", press(1))
    prints, gallery = [str(tmp_path / "a.png")] * 2, str(tmp_path / "g.skg")
    for verb, words in {
        "enroll": [gallery, prints[0], "--person", "ann", "--finger", "right_index"],
        "identify": [gallery, prints[1]],
        "match": prints,
    }.items():
        schema = script["schema_of_verb"](verb)
        file = script["FOLDER"] / f"{verb}.json"
        assert json.loads(file.read_text(encoding="utf-8")) == schema, (
            "run tools/make_json_schemas.py"
        )
        assert main([verb, *words, "--json"]) == 0
        check(json.loads(capsys.readouterr().out), schema, schema["$defs"])
