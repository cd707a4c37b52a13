"""Writes docs/schemas/*.json and docs/schemas.md from what the program says of its JSON:

    python3 docs/make_schemas.py target/release/downwash
"""

import json
import subprocess
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
HEAD = """\
# JSON of the commands

Made by [`make_schemas.py`](make_schemas.py) from the program's own types. `downwash schema NAME` prints a
JSON Schema; those of this version lie in [`schemas/`](schemas). Units are SI and in the names; a number
that is not finite is `null`. Within a `schema_version` keys may be added, none goes or changes its meaning.
"""


def kind(schema):
    """A schema's type in words."""
    if schema is True or schema == {}:
        return "anything"
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    for several in ("anyOf", "oneOf"):
        if several in schema:
            return " or ".join(dict.fromkeys(kind(each) for each in schema[several]))
    if "enum" in schema:
        return ", ".join(f"`{value}`" for value in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    types = schema.get("type", "anything")
    types = types if isinstance(types, list) else [types]
    words = []
    for each in types:
        if each == "array":
            if "prefixItems" in schema:
                each = "[" + ", ".join(kind(item) for item in schema["prefixItems"]) + "]"
            else:
                each = f"list of {kind(schema.get('items', True))}"
        elif each == "object" and isinstance(schema.get("additionalProperties"), dict):
            each = f"table of {kind(schema['additionalProperties'])}"
        words.append(each)
    return " or ".join(words)


def cell(text):
    return " ".join(text.split()).replace("|", "\\|")


def table(schema):
    """The rows of an object's keys."""
    required = schema.get("required", [])
    rows = ["| Key | Type | What it is |", "|---|---|---|"]
    for name, value in schema.get("properties", {}).items():
        about = value.get("description", "") if isinstance(value, dict) else ""
        mark = "" if name in required else " (may be missing)"
        rows.append(f"| `{name}` | {cell(kind(value))}{mark} | {cell(about)} |")
    return "\n".join(rows)


def with_own_names(name, schema, shared):
    """The schema, those of its parts renamed whose names others have for something else."""
    for part, body in schema.get("$defs", {}).items():
        if shared.get(part, body) != body:
            own = "".join(word.capitalize() for word in name.split(".")[1:]) + part
            text = json.dumps(schema).replace(f'"#/$defs/{part}"', f'"#/$defs/{own}"')
            schema = json.loads(text)
            schema["$defs"][own] = schema["$defs"].pop(part)
    return schema


def main(program):
    printed = subprocess.run([program, "schema", "--json"], check=True, capture_output=True, text=True)
    schemas = json.loads(printed.stdout)
    folder = DOCS / "schemas"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.json"):
        old.unlink()
    shared, page = {}, [HEAD]
    for name, schema in schemas.items():
        (folder / f"{name}.json").write_text(json.dumps(schema, indent=2, sort_keys=True) + "\n")
        schema = with_own_names(name, schema, shared)
        shared.update(schema.get("$defs", {}))
        printed_by = schema["$comment"].removeprefix("printed by ")
        page.append(f"## {name}\n\n`{printed_by}`. {cell(schema.get('description', ''))}\n\n{table(schema)}\n")
    page.append("# Parts of these\n")
    for name, schema in sorted(shared.items()):
        body = table(schema) if "properties" in schema else choices(schema)
        page.append(f"## {name}\n\n{cell(schema.get('description', ''))}\n\n{body}\n")
    (DOCS / "schemas.md").write_text("\n".join(page))


def choices(schema):
    """What a value may be, where it is no table."""
    rows = []
    for each in schema.get("oneOf", schema.get("anyOf", [schema])):
        about = each.get("description", "") if each is not schema else ""
        rows.append(f"- {kind(each)}" + (f": {cell(about)}" if about else ""))
    return "\n".join(rows)


if __name__ == "__main__":
    main(sys.argv[1])
