"""Formats whose values stand in tables: TOML, JSON, YAML."""

from __future__ import annotations

import functools
import io
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any

_ENTRY = re.compile(r"(?P<name>[^\[\]]+)(?:\[(?P<index>\d+(?:,\d+)?)\])?")


def flat(tree: Any, before: str = "") -> dict[str, Any]:
    """Values by path: tables with dots, entries of lists as name[i]."""
    found: dict[str, Any] = {}
    for name, each in tree.items() if isinstance(tree, Mapping) else ():
        where = f"{before}{name}"
        if isinstance(each, Mapping):
            found |= flat(each, f"{where}.")
        elif isinstance(each, list):
            found |= {
                f"{where}[{i}]": v for i, v in enumerate(each) if not isinstance(v, (list, Mapping))
            }
        else:
            found[where] = each
    return found


def put(
    tree: MutableMapping[str, Any], path: str, value: Any, prefix: str = "", order: int = 0
) -> None:
    """Set a value in nested tables.

    The path is taken from the top if it leads somewhere, else from the one table that holds its first
    name, else from `prefix`.

    Args:
        tree: changed in place.
        path: names with dots, the last one perhaps with an index [i] or [i,j].
        value: to set.
        prefix: path of the table for what is new.
        order: entries of a list that is new, and rows of a matrix.

    Raises ValueError for a path that leads into a value, an index outside of a list.
    """
    entry = _ENTRY.fullmatch(path)
    if entry is None:
        raise ValueError(f"{path!r} is no path: write table.name, name[i] or name[i,j].")
    names = entry["name"].split(".")
    table = _begin(tree, names[0], prefix)
    for name in names[:-1]:
        table = table.setdefault(name, {})
        if not isinstance(table, MutableMapping):
            raise ValueError(f"{path!r} leads into {name}, which is a value.")  # noqa: TRY004 - a file's fault
    last = names[-1]
    if entry["index"] is None:
        if isinstance(table.get(last), (list, Mapping)):
            raise ValueError(
                f"{path!r} is a {'list' if isinstance(table[last], list) else 'table'}: name an entry of it."
            )
        table[last] = value
        return
    index = [int(i) for i in entry["index"].split(",")]
    _put_entry(table, last, index, value, order, path)


def _put_entry(
    table: MutableMapping[str, Any], name: str, index: list[int], value: Any, order: int, path: str
) -> None:
    """Set an entry of a list, or of a matrix that is written row by row."""
    if name not in table:
        size = order ** len(index) if order else 0
        if not size:
            raise ValueError(
                f"{path!r} is an entry of a list that is not there: give --present, a file with it."
            )
        table[name] = [0.0] * size
    held = table[name]
    rows = math.isqrt(len(held)) if isinstance(held, list) else 0
    place = index[0] if len(index) == 1 else index[0] * rows + index[1]
    fits = isinstance(held, list) and place < len(held)
    if not fits or (len(index) == 2 and (rows**2 != len(held) or max(index) >= rows)):
        raise ValueError(f"{path!r}: {name} has no such entry.")
    held[place] = value


def _begin(tree: MutableMapping[str, Any], first: str, prefix: str) -> MutableMapping[str, Any]:
    """The table that a path begins at."""
    if first in tree:
        return tree
    holding = [table for table in _tables(tree) if first in table]
    if len(holding) > 1:
        raise ValueError(f"several tables hold {first!r}: give the whole path.")
    if holding:
        return holding[0]
    table = tree
    nodes = [
        table for table in _tables(tree) if prefix and prefix.rsplit(".", maxsplit=1)[-1] in table
    ]
    if len(nodes) == 1:  # a node of another name
        found = nodes[0][prefix.rsplit(".", maxsplit=1)[-1]]
        if isinstance(found, MutableMapping):
            return found
    for name in prefix.split(".") if prefix else ():
        table = table.setdefault(name, {})
    return table


def _tables(tree: Any) -> Iterator[MutableMapping[str, Any]]:
    """Every table below, the tree itself left out."""
    for each in tree.values():
        if isinstance(each, MutableMapping):
            yield each
            yield from _tables(each)


def find(read: Mapping[str, Any], path: str) -> Any:
    """The value at a path among those that `flat` gave, found as `put` finds it; None if there is none."""
    entry = _ENTRY.fullmatch(path)
    if entry is None:
        return None
    name, index = entry["name"], entry["index"]
    wanted = name if index is None else f"{name}[{index}]"
    if index is not None and "," in index:
        row, column = map(int, index.split(","))
        ends = [k for k in read if re.fullmatch(rf"(.*\.)?{re.escape(name)}\[\d+\]", k)]
        wanted = f"{name}[{row * math.isqrt(len(ends)) + column}]"
    if wanted in read:
        return read[wanted]
    found = [v for k, v in read.items() if k.endswith(f".{wanted}")]
    return found[0] if len(found) == 1 else None


def nested(values: Mapping[str, Any], prefix: str = "", order: int = 0) -> dict[str, Any]:
    """Tables from paths."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        put(tree, path, value, prefix, order)
    return tree


def _comments(lines: Sequence[str]) -> str:
    return "".join(f"# {line}".rstrip() + "\n" for each in lines for line in each.splitlines())


def write_toml(values: Mapping[str, Any], comments: Sequence[str], present: str | None) -> str:
    """TOML, the values of the present file kept, its comments not."""
    import tomli_w

    tree = {} if present is None else tomllib.loads(present)
    for path, value in values.items():
        put(tree, path, value)
    return _comments(comments) + tomli_w.dumps(tree)


def write_json(values: Mapping[str, Any], _comments: Sequence[str], present: str | None) -> str:
    """JSON, what else the present file holds kept; it has no comments."""
    tree = {} if present is None else json.loads(present)
    for path, value in values.items():
        put(tree, path, value)
    return json.dumps(tree, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


# ---- YAML


def _yaml() -> Any:
    """A reader and writer that keeps comments and order."""
    try:
        from ruamel.yaml import YAML
    except ImportError as error:
        raise ImportError(
            "YAML needs the package ruamel.yaml: pip install 'navgym[tuning]'."
        ) from error
    made = YAML()
    made.Representer = _representer()
    made.preserve_quotes = True
    made.width = 120
    return made


@functools.cache
def _representer() -> Any:
    """Values as readers of YAML 1.1 take them too: to them 1e-05 is text, and no is false."""
    from ruamel.yaml.representer import RoundTripRepresenter

    class Strict(RoundTripRepresenter):
        """Numbers with a point, text in quotes where it is new."""

    def number(representer: Any, value: float) -> Any:
        mantissa, mark, power = repr(value).partition("e")
        text = mantissa if "." in mantissa else f"{mantissa}.0"
        return representer.represent_scalar("tag:yaml.org,2002:float", f"{text}{mark}{power}")

    def word(representer: Any, value: str) -> Any:
        quoted = '"' if value.lower() in _DOUBTFUL or value[:1] in "+-.0123456789~" else None
        return representer.represent_scalar("tag:yaml.org,2002:str", value, style=quoted)

    Strict.add_representer(float, number)
    Strict.add_representer(str, word)
    return Strict


_DOUBTFUL = {"", "y", "n", "yes", "no", "on", "off", "true", "false", "null"}


def yaml_writer(
    prefix: str = "", order: int = 0
) -> Callable[[Mapping[str, Any], Sequence[str], str | None], str]:
    """What writes YAML.

    Args:
        prefix: path of the table for what is new.
        order: see `put`.
    """

    def write(values: Mapping[str, Any], comments: Sequence[str], present: str | None) -> str:
        yaml, text = _yaml(), io.StringIO()
        tree = _load_yaml(present) if present else {}
        for path, value in values.items():
            put(tree, path, value, prefix, order)
        yaml.dump(tree, text)
        return _comments(comments) + text.getvalue()

    return write


def _load_yaml(text: str) -> Any:
    from ruamel.yaml.error import YAMLError

    try:
        found = _yaml().load(text)
    except YAMLError as error:
        raise ValueError(f"no YAML: {' '.join(str(error).split())[:200]}") from None
    if found is None:
        return {}
    if not isinstance(found, MutableMapping):
        raise ValueError("it holds no table of names and values.")  # noqa: TRY004 - a file's fault
    return found


def read_yaml(text: str) -> dict[str, Any]:
    """Values by path."""
    return flat(_load_yaml(text))
