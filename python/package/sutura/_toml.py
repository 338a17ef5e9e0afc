"""The text of a scene file from a dict."""

from __future__ import annotations

import json
import numbers
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ._sutura import harmless

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(description: Mapping[str, Any]) -> str:
    """The text of a scene file with these keys; every number comes back to the bit when it is read.

    Raises TypeError for what no file can say, by its place: None, a key that is no text, an object of another kind.
    """
    if not isinstance(description, Mapping):
        raise TypeError(f"a scene is a dict with the keys of a scene file, or its text, not {_kind(description)}")
    return "\n".join(_table(_plain(description, ""), "")) + "\n"


def _plain(value: Any, place: str) -> Any:
    """The same of dicts, lists, text, numbers."""
    if isinstance(value, Mapping):
        for key in value:
            if not isinstance(key, str):
                raise TypeError(harmless(f"the key {key!r} in {place or 'the scene'} is {_kind(key)}: keys are text"))
        return {key: _plain(each, f"{place}.{key}" if place else key) for key, each in value.items()}
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, str):
        return str(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value)
    if isinstance(value, np.ndarray):
        return _plain(value.tolist(), place)
    if isinstance(value, Sequence):
        return [_plain(each, f"{place}[{index}]") for index, each in enumerate(value)]
    hint = "leave the key out" if value is None else "give a number, text, a list, an array or a dict"
    raise TypeError(harmless(f"{place} is {_kind(value)}: {hint}"))


def _kind(value: Any) -> str:
    return "None" if value is None else f"of the type {type(value).__name__}"


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(each, dict) for each in value)


def _table(table: dict[str, Any], place: str) -> Iterator[str]:
    """Lines of a section: what stands in a line first, as what follows a header belongs to that."""
    for key, value in table.items():
        if not (isinstance(value, dict) or _is_tables(value)):
            yield f"{_key(key)} = {_inline(value)}"
    for key, value in table.items():
        header = f"{place}.{_key(key)}" if place else _key(key)
        if isinstance(value, dict):
            yield f"\n[{header}]"
            yield from _table(value, header)
        elif _is_tables(value):
            for each in value:
                yield f"\n[[{header}]]"
                yield from _table(each, header)


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _inline(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_inline(each)}" for key, each in value.items()) + " }"
    return repr(value)
