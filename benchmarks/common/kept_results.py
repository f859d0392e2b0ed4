"""Results of benchmarks on disk: numbers and arrays as JSON and npz, checked by a digest, never pickled."""

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from gelgap.assets.array_file import read_arrays
from gelgap.assets.checksums import parse_json
from gelgap.assets.whole_file import set_aside, write_whole


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
    arrays = read_arrays(content)
    try:
        return _decoded(parse_json(arrays["tree"].tobytes()), arrays)
    except (KeyError, TypeError, AttributeError, ImportError, RecursionError) as error:
        raise ValueError(f"a kept result is of another version ({error})") from None


def kept_result(file: Path, make: Callable[[], Any]) -> Any:
    """Return the result that a file keeps; make and keep it if there is none, or if its file is damaged."""
    found = read_kept(file)
    if found is None:
        found = make()
        write_whole(file, result_bytes(found))
    return found


def read_kept(file: Path) -> Any:
    """Return the result that a file keeps, None if there is no file; one that is damaged is named and set aside."""
    try:
        return result_from_bytes(file.read_bytes())
    except FileNotFoundError:
        return None
    except ValueError as error:
        set_aside(file, f"cannot be used ({error})")
        return None


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
