"""Writes the Croissant description of the simulated sample: ``python -m docs.tools.croissant [--check]``.

Croissant is the format of MLCommons for descriptions of data sets, here with its fields for responsible AI. Columns and their
descriptions are those of :data:`shuttle_marl.data.schema.STROKES`. ``mlcroissant validate --jsonld FILE`` checks the file.
"""

import hashlib
import json
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from docs.tools.markdown import ROOT, write_or_check
from shuttle_marl.commands import cli
from shuttle_marl.data.schema import STROKES, named

FOLDER: Final = ROOT / "datasets" / "sample"
FILE: Final = FOLDER / "croissant.json"
_TABLE: Final = "strokes.parquet"
ABOUT: Final[dict[str, dict[str, Any]]] = tomllib.loads((Path(__file__).with_suffix(".toml")).read_text(encoding="utf-8"))
"""Context, fields of the data sets, and columns."""


def description() -> dict[str, Any]:
    """The description of the sample as JSON-LD."""
    return dataset(ABOUT["sample"], FOLDER, {"strokes": (_TABLE, "One row per stroke.", named(STROKES.empty_table()).schema)})


def dataset(about: dict[str, Any], folder: Path, tables: dict[str, tuple[str, str, pa.Schema]]) -> dict[str, Any]:
    """The description of Parquet files as JSON-LD.

    Args:
        about: fields of this data set: name, version, responsible AI and so on.
        folder: of the files.
        tables: name of the file, description, and schema, by the name of the record set. Each field of a schema has its
            description as metadata.
    """
    conforms = ["http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0"]
    distribution = [_file(folder / file) for file, _, _ in tables.values()]
    records = [
        {
            "@type": "cr:RecordSet",
            "@id": name,
            "name": name,
            "description": text,
            "field": [_field(name, file, field) for field in schema],
        }
        for name, (file, text, schema) in tables.items()
    ]
    shown = {**about, **ABOUT["owner"], **ABOUT["simulated"], "distribution": distribution, "recordSet": records}
    return {"@context": ABOUT["context"], "@type": "sc:Dataset", "conformsTo": conforms, **shown}


def _file(path: Path) -> dict[str, str]:
    content = path.read_bytes()
    return {
        "@type": "cr:FileObject",
        "@id": path.name,
        "name": path.name,
        "contentUrl": path.name,
        "contentSize": f"{len(content)} B",
        "encodingFormat": "application/x-parquet",
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _field(records: str, file: str, field: pa.Field) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{records}/{field.name}",
        "name": field.name,
        "description": (field.metadata or {})[b"description"].decode(),
        "dataType": _type(field.type),
        "source": {"fileObject": {"@id": file}, "extract": {"column": field.name}},
    }


def _type(kind: pa.DataType) -> str:
    if pa.types.is_boolean(kind):
        return "sc:Boolean"
    if pa.types.is_string(kind) or pa.types.is_dictionary(kind):
        return "sc:Text"
    return "sc:Float" if pa.types.is_floating(kind) else "sc:Integer"


def main(*, check: bool = False) -> None:
    """Write the description, or check it.

    Args:
        check: Change nothing; fail if the file differs.
    """
    write_or_check(
        FILE, json.dumps(description(), indent=2, ensure_ascii=False) + "\n", check=check, problem="does not describe the sample"
    )


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.croissant", description="Write the Croissant description of the sample."))
