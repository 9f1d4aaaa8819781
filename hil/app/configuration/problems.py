"""Translates Pydantic's errors into problems of a YAML text: path, what is wrong, allowed, given.

The allowed values come from the model's own JSON Schema, so they always match the check.
"""

import json
import math
import re
from difflib import get_close_matches
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from drivers.errors import ConfigurationError
from hil.app.configuration.yaml_positions import Document, Path, Problem, Value, lines

Schema = dict[str, Any]

UNITS = frozenset({
    "m", "mm", "um", "m2", "m3", "s", "s2", "ms", "us", "ns", "min", "h", "kg", "g", "t", "N", "kN", "Nm",
    "W", "V", "A", "Hz", "kHz", "MHz", "rad", "deg", "percent", "bit", "ticks",
})  # fmt: skip
"""Words that count as a unit at the end of a key."""
FIXED_KEYS = {"reactions": ("estop", "bus", "second_controller")}
"""Section -> keys that cannot be set: their reaction is always sto, since no drive could obey another one."""


def problems(error: ValidationError, document: Document, schema: Schema) -> list[Problem]:
    """Translate every validation error into a problem; `schema` is the JSON Schema of the whole model."""
    found: dict[tuple[str, Path], Problem] = {}
    for item in error.errors(include_url=False):
        path = _path(item["loc"], document.value, missing=item["type"] == "missing")
        kind, problem = _problem(item["type"], item, path, document, schema)
        found.setdefault((kind, problem.path), problem)
    # A union reports every alternative. If one of them objects to the content of the value, the type errors
    # of the others are noise.
    content = {path[:n] for kind, path in found for n in range(len(path) + (kind != "type"))}
    kept = [p for (kind, path), p in found.items() if not (kind == "type" and path in content)]
    missing_keys = {p.path for p in kept if p.message.startswith("missing")}
    corrected_keys = {
        (*p.path[:-1], name)
        for p in kept
        for name in re.findall(r"^(?:missing|wrong) unit: the key is (\w+)", p.message)
    }
    return [p for p in kept if p.path not in missing_keys & corrected_keys]


Of = TypeVar("Of", bound=BaseModel)


def validated(kind: type[Of], document: Document) -> tuple[Of | None, list[Problem]]:
    """(section, problems) of a YAML text; section: None if there are problems."""
    found = list(document.problems)
    if document.value is not None:
        try:
            section = kind.model_validate_json(json.dumps(document.value), strict=True)
        except ValidationError as error:
            found += problems(error, document, kind.model_json_schema())
        else:
            return (None, found) if found else (section, found)
    return None, found


def checked(kind: type[Of], document: Document, name: str) -> Of:
    """Section of type `kind` in the text of file `name`. Raises ConfigurationError with all problems."""
    section, found = validated(kind, document)
    if section is None:
        raise ConfigurationError(*lines(found, name))
    return section


_BOUNDS = {
    "exclusiveMinimum": "greater than",
    "minimum": "at least",
    "exclusiveMaximum": "less than",
    "maximum": "at most",
}


def describe(schema: Schema, root: Schema) -> str:
    """Allowed values of a JSON Schema, as text; root: schema that its references refer to."""
    match _dereference(schema, root):
        case {"discriminator": {"propertyName": name, "mapping": mapping}}:
            return f"a section whose {name} is {', '.join(mapping)}"
        case {"anyOf": options} | {"oneOf": options}:
            return " or ".join(dict.fromkeys(describe(each, root) for each in options))
        case {"enum": words}:
            return ", ".join(map(str, words))
        case {"const": word}:
            return str(word)
        case {"type": "number" | "integer" as kind, **bounds}:
            words = [f"{text} {bounds[key]:g}" for key, text in _BOUNDS.items() if key in bounds]
            return f"a {'whole ' * (kind == 'integer')}number {' and '.join(words)}".rstrip()
        case {"type": "array", **sizes}:
            return _describe_list(sizes, root)
        case {"type": "string", "pattern": form}:
            return f"text of the form {form.strip('^$')}"
        case {"type": "object", "properties": keys}:
            return "a section with the keys " + ", ".join(keys)
        case {"type": "object", "minProperties": 1}:
            return "a section of at least 1 entry"
        case {"type": "string" | "boolean" | "null" as kind}:
            return {"string": "text", "boolean": "true or false", "null": "null"}[kind]
    return "a section"


def _describe_list(sizes: Schema, root: Schema) -> str:
    low, high = sizes.get("minItems"), sizes.get("maxItems")
    count = f"{low} " if low == high and low else f"at least {low} " if low else ""
    items: Schema = sizes.get("items") or next(iter(sizes.get("prefixItems", [])), {})
    entry, words = _dereference(items, root).get("type"), describe(items, root)
    if entry in ("number", "integer"):
        return f"a list of {count}{words.removeprefix('a ').replace('number', 'numbers', 1)}"
    if entry == "array":
        return f"a list of {count}lists, each {words}"
    return "a list of at least 1 entry" if low == 1 != high else f"a list of {count}entries"


def at(path: Path, data: Value, root: Schema) -> Schema:
    """JSON Schema at `path`, with alternatives chosen by the data."""
    schema = root
    for item in path:
        schema = _choose(_dereference(schema, root), data, root)
        if isinstance(item, int):
            prefix = schema.get("prefixItems", [])
            schema = prefix[item] if item < len(prefix) else schema.get("items", {})
            data = data[item] if isinstance(data, list) and item < len(data) else None
        else:
            extra = schema.get("additionalProperties")
            named = [s for form, s in schema.get("patternProperties", {}).items() if re.search(form, item)]
            other = next(iter(named), extra if isinstance(extra, dict) else {})
            schema = schema.get("properties", {}).get(item, other)
            data = data.get(item) if isinstance(data, dict) else None
    return _choose(_dereference(schema, root), data, root)


def _dereference(schema: Schema, root: Schema) -> Schema:
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rsplit("/", 1)[1]]
    return schema


def _choose(schema: Schema, data: Value, root: Schema) -> Schema:
    """Alternative of a schema that fits the data: by discriminator, else by its kind."""
    options = schema.get("oneOf") or schema.get("anyOf")
    if not options:
        return schema
    if "discriminator" in schema:
        name = schema["discriminator"]["propertyName"]
        word = data.get(name) if isinstance(data, dict) else None
        reference = schema["discriminator"]["mapping"].get(word) if isinstance(word, str) else None
        return _dereference({"$ref": reference}, root) if reference else schema
    kind = "object" if isinstance(data, dict) else "array" if isinstance(data, list) else None
    for option in (_dereference(o, root) for o in options):
        if kind and option.get("type") == kind:
            return option
        if kind == "object" and "discriminator" in option:
            return _choose(option, data, root)
    return schema


def _path(loc: tuple[str | int, ...], data: Value, *, missing: bool) -> Path:
    """Pydantic's location without the names of union alternatives, which are not in the text."""
    path: list[str | int] = []
    for item in loc:
        try:
            data = data[item]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            continue
        path.append(item)
    return (*path, loc[-1]) if missing else tuple(path)


_WHAT = {
    **dict.fromkeys(("literal_error", "union_tag_invalid"), "unknown value"),
    "string_pattern_mismatch": "wrong form",
    **dict.fromkeys(("too_short", "too_long"), "wrong number of entries"),
    **dict.fromkeys(("greater_than", "greater_than_equal", "less_than", "less_than_equal"), "out of range"),
}
"""Pydantic's name of an error -> our words."""


def _problem(kind: str, item: Any, path: Path, document: Document, schema: Schema) -> tuple[str, Problem]:
    """(class, problem) of an error; the class identifies duplicates from alternatives of a union."""
    if kind == "extra_forbidden":
        return "key", Problem(document.key_position(path), path, unknown_key(path, document, schema))
    if kind in ("value_error", "assertion_error"):
        return "value", Problem(document.value_position(path), path, str(item["ctx"]["error"]))
    given: Any = item["input"]
    if kind == "missing" and isinstance(path[-1], int):  # an entry of a list of fixed length
        kind, path = "too_short", path[:-1]
        given = document.at(path)
    there = at(path, document.value, schema)
    allowed = describe(there, schema)
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        chosen = there["discriminator"]
        path, allowed = (*path, chosen["propertyName"]), ", ".join(chosen["mapping"])
        given = given.get(path[-1]) if isinstance(given, dict) else given
    if kind in ("missing", "union_tag_not_found"):
        return "key", Problem(document.key_position(path), path, f"missing, allowed: {allowed}")
    group, position, what = "value", document.value_position(path), _WHAT.get(kind)
    if kind == "string_pattern_mismatch" and item["loc"][-1] == "[key]":
        group, position = "key", document.key_position(path)
        allowed = describe({"type": "string", **item["ctx"]}, schema)
    elif kind == "finite_number" or (isinstance(given, float) and not math.isfinite(given)):
        what = "not a finite number"
    elif kind.endswith(("_type", "_parsing", "_from_float")):
        group, what = "type", "wrong type"
    counted = kind in ("too_short", "too_long") and isinstance(given, list | dict)
    shown = f"{len(given)} entries" if counted else _show(given)
    return group, Problem(position, path, f"{what or item['msg']}, allowed: {allowed}, given: {shown}")


def unknown_key(path: Path, document: Document, schema: Schema) -> str:
    """Message for an unknown key: the missing or wrong unit, the nearest key, or all keys."""
    fixed = FIXED_KEYS.get(str(path[0]), ()) if len(path) == 2 else ()
    if path[-1] in fixed:
        return f"not a key: the reaction to {', '.join(fixed)} is always sto; leave it out"
    known = list(at(path[:-1], document.value, schema).get("properties", {}))
    key = str(path[-1])
    free = [k for k in known if (*path[:-1], k) not in document.values]
    for name in free:
        stem, unit = split_unit(name)
        if unit and stem.lower() == split_unit(key)[0].lower():
            if split_unit(key)[1]:
                return f"wrong unit: the key is {name} (in {unit})"
            return f"missing unit: the key is {name}"
    near = get_close_matches(key, free or known, 1, 0.6)
    if near:
        return f"unknown key, did you mean {near[0]}?"
    return f"unknown key, allowed: {', '.join(known)}"


def split_unit(key: str) -> tuple[str, str]:
    """Split `kp_N_m` into ("kp", "N_m"); the unit is empty for a key without one."""
    words = key.split("_")
    end = len(words)
    while end > 1 and words[end - 1] in UNITS:
        end -= 1
    return "_".join(words[:end]), "_".join(words[end:])


def _show(value: object) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return str(value).replace("nan", ".nan").replace("inf", ".inf")
    if isinstance(value, dict):
        return "a section"
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else text[:57] + "..."
