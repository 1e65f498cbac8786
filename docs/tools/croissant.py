"""Writes the Croissant description of the simulated sample: ``python -m docs.tools.croissant [--check]``.

Croissant is the format of MLCommons for descriptions of data sets, here with its fields for responsible AI. Columns and their
descriptions are those of :data:`shuttle_marl.data.schema.STROKES`. ``mlcroissant validate --jsonld FILE`` checks the file.
"""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from docs.tools.markdown import ROOT, write_or_check
from shuttle_marl.commands import cli
from shuttle_marl.data.schema import STROKES

FOLDER: Final = ROOT / "datasets" / "sample"
FILE: Final = FOLDER / "croissant.json"
_TABLE: Final = "strokes.parquet"
_CONTEXT: Final = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "equivalentProperty": "cr:equivalentProperty",
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
OWNER: Final = {
    "url": "https://pypi.org/project/shuttle-marl/",
    "license": "https://spdx.org/licenses/MIT",
    "creator": {"@type": "Organization", "name": "the shuttle_marl authors"},
    "citeAs": "the shuttle_marl authors: shuttle_marl, two-player badminton for multi-agent reinforcement learning",
}
"""Fields of every data set of the package."""
SIMULATED: Final = {
    "rai:dataBiases": "The game is fitted to elite singles of the years 2018 to 2022; see the datasheet for their players.",
    "rai:personalSensitiveInformation": "None. The name of a player stands for a policy that imitates their choices.",
    "rai:dataSocialImpact": "Conclusions about players named here would be wrong; they did not play these strokes.",
    "rai:hasSyntheticData": True,
}
"""Fields of data sets that the shipped game generates."""
_ABOUT: Final = {
    "name": "shuttle_marl_sample",
    "description": "Matches of badminton in the schema of annotated ones, one row per stroke. No one played "
    "them: shipped policies did, on the shipped game.",
    **OWNER,
    "keywords": ["badminton", "simulation", "sports analytics"],
    "isLiveDataset": False,
    "rai:dataCollection": "Drawn by datasets/make_sample.py from the shipped game and policies; nothing was observed.",
    "rai:dataCollectionType": "Simulation",
    "rai:dataUseCases": "Trying out and testing code that reads strokes; not for fitting models or statements about people.",
    "rai:dataLimitations": "Landings, positions and times are drawn to fit the strokes and are less varied than real ones.",
    **SIMULATED,
}


def description() -> dict[str, Any]:
    """The description of the sample as JSON-LD."""
    about = {**_ABOUT, "version": "1.0.0", "datePublished": "2026-11-25"}
    return dataset(about, FOLDER, {"strokes": (_TABLE, "One row per stroke.", STROKES)})


def dataset(about: dict[str, Any], folder: Path, tables: dict[str, tuple[str, str, pa.Schema]]) -> dict[str, Any]:
    """The description of Parquet files as JSON-LD.

    Args:
        about: fields of the data set: name, licence, version, responsible AI and so on.
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
    shown = {**about, "distribution": distribution, "recordSet": records}
    return {"@context": _CONTEXT, "@type": "sc:Dataset", "conformsTo": conforms, **shown}


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
