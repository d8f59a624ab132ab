"""Frozen arrays, and frozen dataclasses of arrays on disk: one ``.npz`` per object, written whole or not at all."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
import zipfile
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
_JSON = "__json__"


def freeze(values: Any) -> np.ndarray:
    """A read-only, contiguous copy (an array that is both already is returned as it is)."""
    a: np.ndarray = np.asarray(values)
    if not a.flags.writeable and a.flags.c_contiguous and a.base is None:
        return a
    a = np.array(a, order="C", copy=True)
    a.flags.writeable = False
    return a


def freeze_fields(obj: Any) -> None:
    """Replaces every array field of a frozen dataclass by its read-only copy; call it from ``__post_init__``."""
    for f in dataclasses.fields(obj):
        value = getattr(obj, f.name)
        if isinstance(value, np.ndarray):
            object.__setattr__(obj, f.name, freeze(value))


def write_atomically(path: Path, write: Any) -> None:
    """Calls ``write(temporary_path)`` and renames on success, so that a reader never sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix="." + path.stem, suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def _flatten(value: Any, prefix: str, arrays: dict[str, np.ndarray]) -> Any:
    """JSON skeleton of a value; arrays go to ``arrays`` under their dotted name."""
    if isinstance(value, np.ndarray):
        arrays[prefix] = value
        return {"__array__": prefix}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: _flatten(getattr(value, f.name), f"{prefix}.{f.name}", arrays) for f in dataclasses.fields(value)
        }
    if isinstance(value, (list, tuple)):
        return [_flatten(v, f"{prefix}.{i}", arrays) for i, v in enumerate(value)]
    if isinstance(value, dict):
        return {str(k): _flatten(v, f"{prefix}.{k}", arrays) for k, v in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    return value


def save(path: Path, obj: Any) -> None:
    """Stores a dataclass of arrays, scalars, strings, lists and nested dataclasses."""
    arrays: dict[str, np.ndarray] = {}
    skeleton = _flatten(obj, "x", arrays)
    header = np.frombuffer(json.dumps(skeleton).encode(), np.uint8)

    def write(p: Path) -> None:
        with open(p, "wb") as f:
            np.savez_compressed(f, **{_JSON: header}, **arrays)  # type: ignore[arg-type]

    write_atomically(path, write)


def load(path: Path) -> dict[str, Any]:
    """The fields stored by `save`, nested dataclasses as dicts; the caller rebuilds its type.

    Raises
        ValueError: the file is not one of ours, or damaged.
    """
    try:
        with open(path, "rb") as f, np.load(f, allow_pickle=False) as z:
            arrays = {k: z[k] for k in z.files}
        skeleton = json.loads(arrays.pop(_JSON).tobytes().decode())
    except (ValueError, KeyError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path}: not a pruefstand archive") from error

    def rebuild(v: Any) -> Any:
        if isinstance(v, dict):
            if set(v) == {"__array__"}:
                return arrays[v["__array__"]]
            return {k: rebuild(w) for k, w in v.items()}
        return [rebuild(w) for w in v] if isinstance(v, list) else v

    fields = rebuild(skeleton)
    if not isinstance(fields, dict):
        raise ValueError(f"{path}: not a pruefstand archive")
    return fields
