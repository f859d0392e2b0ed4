"""Croissant metadata of an export: JSON-LD by which other tools find its files, columns, types and units.

Format: https://docs.mlcommons.org/croissant/docs/croissant-spec.html, version 1.0.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa

from gelgap.assets.checksums import file_sha256
from gelgap.domains.columns import IMAGE, LABELS, OPTIONAL, PICTURE, POINTS, Column
from gelgap.domains.schema import SCHEMA_VERSION

CROISSANT = "croissant.json"
"""Name of the metadata's file."""
# JSON-LD's own words, as the specification's examples have them.
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
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
_DATA_TYPES = {
    pa.int32(): "sc:Integer",
    pa.float64(): "sc:Float",
    pa.bool_(): "sc:Boolean",
    pa.string(): "sc:Text",
    PICTURE: "sc:ImageObject",
    POINTS: "sc:Float",
}
_FORMATS = {".parquet": "application/x-parquet", ".png": "image/png"}


def write_croissant(folder: Path, title: str, description: str, licence: str) -> None:
    """Write `croissant.json` for the Parquet files and references that lie in the domains' folders below."""
    files = sorted(path for path in folder.glob("*/*") if path.suffix in _FORMATS)
    metadata = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": title,
        "description": description,
        "license": licence,
        "version": f"{SCHEMA_VERSION}.0.0",
        "distribution": [_file_object(path, folder) for path in files],
        "recordSet": [_record_set(path, folder) for path in files if path.suffix == ".parquet"],
    }
    text = json.dumps(metadata, indent=1, ensure_ascii=False)
    (folder / CROISSANT).write_text(text + "\n", encoding="utf-8")


def _file_object(path: Path, folder: Path) -> dict[str, Any]:
    name = path.relative_to(folder).as_posix()
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{path.stat().st_size} B",
        "encodingFormat": _FORMATS[path.suffix],
        "sha256": file_sha256(path),
    }


def _record_set(path: Path, folder: Path) -> dict[str, Any]:
    """Return the frames of one domain's part: `mb0i0/train` of the file `mb0i0/train-00000.parquet`."""
    import pyarrow.parquet as pq

    part = path.stem.partition("-")[0]
    name = f"{path.parent.name}/{part}"
    columns = {column.name: column for column in _columns()}
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": f"The {part} frames of the domain {path.parent.name}.",
        "field": [
            _field(columns[column], name, path.relative_to(folder).as_posix())
            for column in pq.read_schema(path).names
        ],
    }


def _columns() -> Iterator[Column]:
    yield from (*LABELS, IMAGE)
    for columns in OPTIONAL.values():
        yield from columns


def _field(column: Column, record_set: str, file: str) -> dict[str, Any]:
    source: dict[str, Any] = {"fileObject": {"@id": file}, "extract": {"column": column.name}}
    if column.type == PICTURE:
        source["transform"] = {"jsonPath": "bytes"}
    field = {
        "@type": "cr:Field",
        "@id": f"{record_set}/{column.name}",
        "name": column.name,
        "description": f"{column.meaning}{f', {column.unit}' if column.unit else ''}",
        "dataType": _DATA_TYPES[column.type],
        "source": source,
    }
    return field | ({"repeated": True} if column.type == POINTS else {})
