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
import pyarrow.parquet as pq

from docs.tools.markdown import ROOT, write_or_check
from shuttle_marl.commands import cli
from shuttle_marl.data.schema import STROKES, named

FILE: Final = ROOT / "datasets" / "sample" / "croissant.json"
_TABLE: Final = "strokes.parquet"


def description() -> dict[str, Any]:
    """The description of the sample as JSON-LD."""
    about: dict[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
    conforms = ["http://mlcommons.org/croissant/1.0", "http://mlcommons.org/croissant/RAI/1.0"]
    held = pq.read_schema(FILE.with_name(_TABLE)).names
    records = {
        "@type": "cr:RecordSet",
        "@id": "strokes",
        "name": "strokes",
        "description": "One row per stroke.",
        "field": [_field(field) for field in named(STROKES.empty_table()).schema if field.name in held],
    }
    return {
        "@context": about["context"],
        "@type": "sc:Dataset",
        "conformsTo": conforms,
        **about["sample"],
        **about["owner"],
        **about["simulated"],
        "distribution": [_file(FILE.with_name(_TABLE).read_bytes())],
        "recordSet": [records],
    }


def _file(content: bytes) -> dict[str, str]:
    return {
        "@type": "cr:FileObject",
        **dict.fromkeys(("@id", "name", "contentUrl"), _TABLE),
        "contentSize": f"{len(content)} B",
        "encodingFormat": "application/x-parquet",
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _field(field: pa.Field) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"strokes/{field.name}",
        "name": field.name,
        "description": (field.metadata or {})[b"description"].decode(),
        "dataType": _type(field.type),
        "source": {"fileObject": {"@id": _TABLE}, "extract": {"column": field.name}},
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
    text = json.dumps(description(), indent=2, ensure_ascii=False)
    write_or_check(FILE, f"{text}\n", check=check, problem="does not describe the sample")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.croissant", description="Write the Croissant description of the sample."))
