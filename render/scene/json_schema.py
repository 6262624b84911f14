"""The JSON schema of scene files, for editors: units, ranges and words as the files hold them.

It is of draft 4, the newest that taplo (Even Better TOML) reads. What single keys may hold is all
there; what fits together (lamps beside the pad, a camera that sees) ``load_scene`` says alone.
"""

from __future__ import annotations

import contextlib
import re
from typing import Any

from pydantic import AliasChoices
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from render.scene.quantities import Part
from render.scene.schema import Scene
from render.scene.serialization import part_class

DRAFT = "http://json-schema.org/draft-04/schema#"


def scene_schema() -> dict[str, Any]:
    """Return the schema that every scene file fulfills; it is JSON as it is."""
    schema = Scene.model_json_schema(
        ref_template="#/definitions/{model}", schema_generator=_FileSchema
    )
    schema["definitions"] = schema.pop("$defs")
    schema["properties"]["lamps_file"] = {
        "type": "string",
        "description": "A CSV file of lamps, instead of lamps; relative to the scene file.",
    }
    without_schema_2 = _without_schema_2(Scene)
    without_schema_2["not"]["anyOf"].append({"required": ["lamps_file"]})
    schema["anyOf"] = [
        {"title": "schema 2", "properties": {"schema": {"enum": [2]}}},
        {"title": "schema 1", "required": ["fibers"], **without_schema_2},
    ]
    return {"$schema": DRAFT, **schema, "title": "A scene of tactilux"}


class _FileSchema(GenerateJsonSchema):
    """Says what a TOML file may hold: no null, one form for each key, defaults as they are typed.

    Quantities, profiles and spreads bring their own forms.
    """

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        """Leave null out, which TOML has not."""
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        """Keep defaults that a file types like that; those of quantities are in memory units."""
        content = self.generate_inner(schema["schema"])
        if isinstance(schema.get("default"), bool):
            content["default"] = schema["default"]
        return content

    def literal_schema(self, schema: core_schema.LiteralSchema) -> JsonSchemaValue:
        """Name a choice of one as others; draft 4 has no ``const``."""
        return {"enum": list(schema["expected"])}

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Describe each key by what the docstring of its part says of it."""
        content = super().model_schema(schema)
        doc = " ".join((schema["cls"].__doc__ or "").split())
        if "description" in content:
            content["description"] = doc.replace("``", "")
        for info in schema["cls"].model_fields.values():
            if isinstance(info.validation_alias, AliasChoices):
                first, *others = map(str, info.validation_alias.choices)
                content["properties"] |= {
                    name: dict(content["properties"][first]) for name in others
                }
        for name, inner in content.get("properties", {}).items():
            inner.pop("title", None)
            about = _about(name, doc)
            said = " ".join(filter(None, [about, inner.pop("description", "")]))
            # Beside a reference, draft 4 reads nothing.
            form = {"allOf": [dict(inner)]} if "$ref" in inner else dict(inner)
            inner.clear()
            inner |= {"description": said} | form if said else form
            inner.pop("since_schema", None)
            inner.pop("lists_since_schema", None)
        return content


def _about(name: str, doc: str) -> str:
    """Return the sentences of a docstring that name a key, without markup."""
    said = [part for part in re.split(r"(?<=[.;]) ", doc) if f"``{name}``" in part]
    return " ".join(said).replace("``", "").removesuffix(";").removesuffix(".") + "." * bool(said)


def _without_schema_2(part: type[Part]) -> dict[str, Any]:
    """Return what a file of schema 1 may not name in ``part`` and in what it holds."""
    newer: list[dict[str, Any]] = []
    inside: dict[str, Any] = {}
    for name, info in part.model_fields.items():
        extra = info.json_schema_extra
        if isinstance(extra, dict) and extra.get("since_schema") == 2:
            newer.append({"required": [name]})
            continue
        if isinstance(extra, dict) and extra.get("lists_since_schema") == 2:
            inside[name] = {"properties": {"value": {"not": {"type": "array"}}}}
        with contextlib.suppress(TypeError):  # it holds no part
            found = _without_schema_2(part_class(info.annotation))
            inside |= {name: found} if found else {}
    content: dict[str, Any] = {"not": {"anyOf": newer}} if newer else {}
    return content | ({"properties": inside} if inside else {})
