"""tubeplan schema: every key of result.json."""

from __future__ import annotations

import json as json_text
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer

from tubeplan_viz.result import result_schema


def schema(
    json: Annotated[bool, typer.Option("--json", help="Print the JSON Schema itself (2020-12).")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", hidden=True)] = False,  # as every command; there is no progress
) -> None:
    """List the keys of result.json with their types and meanings.

    Example: tubeplan schema --json > result.schema.json
    """
    document = result_schema()
    if json:
        typer.echo(json_text.dumps(document, indent=1))
        return
    typer.echo(document["description"])
    for key, kind, meaning in keys(document, document, ""):
        typer.echo(f"{key}  [{kind}]  {meaning}".rstrip())


def keys(part: Mapping[str, Any], root: Mapping[str, Any], name: str) -> Iterator[tuple[str, str, str]]:
    """Name, type and description of every key below a part of a schema; ``[]`` stands for the items of a list."""
    for key, found in part.get("properties", {}).items():
        place = f"{name}.{key}" if name else key
        shown = {**resolved(found, root), **found}
        yield place, kind_of(shown), shown.get("description", "")
        yield from keys(shown, root, place)
        if isinstance(shown.get("items"), Mapping):
            yield from keys(resolved(shown["items"], root), root, f"{place}[]")


def resolved(part: Mapping[str, Any], root: Mapping[str, Any]) -> Mapping[str, Any]:
    """A part of the schema, or what it refers to."""
    reference = part.get("$ref")
    if reference is None:
        return part
    found: Any = root
    for step in reference.removeprefix("#/").split("/"):
        found = found[step]
    return dict(found)


def kind_of(part: Mapping[str, Any]) -> str:
    """Type in words: its JSON types, its only value, or its choices."""
    if "enum" in part:
        return " | ".join(map(str, part["enum"]))
    if "const" in part:
        return str(part["const"])
    kind = part.get("type", "any")
    return kind if isinstance(kind, str) else " | ".join(kind)
