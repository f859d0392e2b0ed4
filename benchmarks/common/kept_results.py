"""Results of benchmarks on disk: numbers and arrays as JSON and npz, checked by a digest, never pickled."""

import hashlib
import io
import json
from dataclasses import fields, is_dataclass
from importlib import import_module
from typing import Any

import numpy as np
from pydantic import BaseModel


def result_bytes(value: Any) -> bytes:
    """Return a result of numbers, texts, arrays, tuples, lists, and gelgap's own dataclasses and settings, as bytes."""
    arrays: list[np.ndarray] = []
    tree = _encoded(value, arrays)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        tree=np.frombuffer(json.dumps(tree).encode(), dtype=np.uint8),
        **{str(index): array for index, array in enumerate(arrays)},
    )
    content = buffer.getvalue()
    return hashlib.sha256(content).digest() + content


def result_from_bytes(data: bytes) -> Any:
    """Return the result of `result_bytes`.

    Raises
    ------
    ValueError
        If the bytes are not those that were written.
    """
    digest, content = data[:32], data[32:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("a kept result is damaged: its checksum does not match")
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = dict(file)
    return _decoded(json.loads(arrays["tree"].tobytes()), arrays)


def _encoded(value: Any, arrays: list[np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        arrays.append(np.asarray(value))
        return {"array": len(arrays) - 1, "scalar": isinstance(value, np.generic)}
    if isinstance(value, tuple | list):
        return {type(value).__name__: [_encoded(item, arrays) for item in value]}
    if isinstance(value, BaseModel):
        content = {name: getattr(value, name) for name in type(value).model_fields}
    elif is_dataclass(value):
        content = {field.name: getattr(value, field.name) for field in fields(value)}
    else:
        raise TypeError(f"{type(value).__name__} cannot be kept")
    place = f"{type(value).__module__}:{type(value).__qualname__}"
    return {"class": place, "fields": {name: _encoded(item, arrays) for name, item in content.items()}}


def _decoded(tree: Any, arrays: dict[str, np.ndarray]) -> Any:
    match tree:
        case {"array": index, "scalar": scalar}:
            return arrays[str(index)][()] if scalar else arrays[str(index)]
        case {"tuple": items}:
            return tuple(_decoded(item, arrays) for item in items)
        case {"list": items}:
            return [_decoded(item, arrays) for item in items]
        case {"class": place, "fields": content}:
            return _class_at(place)(**{name: _decoded(item, arrays) for name, item in content.items()})
    return tree


def _class_at(place: str) -> type:
    """Return one of gelgap's own dataclasses or settings by module and name."""
    module, _, name = place.partition(":")
    found = getattr(import_module(module), name, None) if module.startswith("gelgap.") else None
    if not (isinstance(found, type) and (is_dataclass(found) or issubclass(found, BaseModel))):
        raise ValueError(f"a kept result names {place}, which is no class of results")
    return found
