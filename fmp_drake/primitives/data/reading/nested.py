"""Readers of nested values in text files: JSON and YAML."""

import json
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from fmp_drake.errors import SkillFileError
from fmp_drake.primitives.data.reading.arrays import (
    flat_values,
    recordings_in,
    table_of,
)
from fmp_drake.primitives.data.reading.rows import LEAST_COMPLETE
from fmp_drake.primitives.data.reading.table import (
    ReadingOptions,
    Table,
    count_text,
    readable,
)
from fmp_drake.primitives.data.reading.text import (
    number_in,
    read_lines,
    read_text,
)

_JSON_LINE = '{"time": 0.1, "x": 0.2, "y": 0.3, "z": 0}'
# Numbers in YAML that Python writes differently.
_NUMBERS = {"true": 1.0, "false": 0.0, ".nan": np.nan, ".inf": np.inf, "-.inf": -np.inf}
# Greatest depth of lists and mappings in YAML.
_MOST_LEVELS = 100
# Keys in less than one of so many objects are left out where most of a table would be empty.
_RAREST = 100
# Number of an element in the name of a value.
_NUMBER = re.compile(r"(?<=\.)\d+(?=\.)")
# Beginnings and ends of documents in YAML.
_DOCUMENT = re.compile(r"^(?:---|\.\.\.)(?!\S)", re.MULTILINE)


def read_json(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the numbers of JSON lines, a list of objects, or an object of lists.

    Names of nested values are joined by dots: `pose.position.x`.

    Raises
    ------
    SkillFileError
        Where the file is not JSON of this form; a broken line is named.
    """
    hint = f"; write an object of numbers in each line, such as {_JSON_LINE}"
    with readable(path, "a JSON file", hint=hint):
        return _nested_tables(path, _json_content(path, read_lines(path)), options)


def read_yaml(path: Path, options: ReadingOptions) -> list[Table]:
    """Return the numbers in YAML: in messages that ROS printed, or in one document as in JSON.

    Broken documents, such as the last one, are left out. A file without lists and mappings
    is read as text.
    """
    contents, broken = [], 0
    for document in _DOCUMENT.split("\n".join(read_lines(path))):
        try:
            contents.append(_yaml_content(path, document))
        except yaml.YAMLError:
            broken += 1
    # Between messages, ROS reports lost ones.
    messages = [content for content in contents if isinstance(content, dict)]
    broken += bool(messages) * sum(isinstance(content, str) for content in contents)
    contents = messages or [c for c in contents if isinstance(c, list)]
    if not contents:
        return read_text(path, options)
    with readable(path, "a YAML file"):
        content = contents[0] if len(contents) == 1 else contents
        tables = _nested_tables(path, content, options)
    count = count_text(broken, "broken document")
    remarks = (f"{count} left out",) if broken else ()
    return [replace(table, remarks=(*table.remarks, *remarks)) for table in tables]


def _yaml_content(path: Path, document: str) -> Any:
    """Return the lists, mappings, numbers and words in a YAML document.

    Tags are ignored. Aliases, which may stand for gigabytes, are refused.
    """
    # Whether each open collection is a mapping, and its items: keys and values in turn.
    stack: list[tuple[bool, list[Any]]] = [(False, [])]
    for event in yaml.parse(document, Loader=yaml.CSafeLoader):
        is_mapping, items = stack[-1]
        if isinstance(event, yaml.AliasEvent):
            raise SkillFileError(f"{path} is YAML with aliases; write JSON instead.")
        if len(stack) > _MOST_LEVELS:  # The time to read them grows as their square.
            raise SkillFileError(
                f"{path} has more than {_MOST_LEVELS} levels of lists."
            )
        if isinstance(event, yaml.ScalarEvent):
            is_key = is_mapping and len(items) % 2 == 0
            items.append(event.value if is_key or event.style else _value(event.value))
        elif isinstance(event, yaml.CollectionStartEvent):
            stack.append((isinstance(event, yaml.MappingStartEvent), []))
        elif isinstance(event, yaml.CollectionEndEvent):
            stack.pop()
            pairs = zip(items[::2], items[1::2], strict=True) if is_mapping else ()
            content = {key: value for key, value in pairs if isinstance(key, str)}
            stack[-1][1].append(_listed(content) if is_mapping else items)
    return next(iter(stack[0][1]), None)


def _value(word: str) -> float | str | None:
    """Return the number that a word in YAML stands for, or the word; None where empty."""
    if not word:
        return None
    number = _NUMBERS.get(word.lower(), number_in(word))
    return word if number is None else number


def _nested_tables(path: Path, content: Any, options: ReadingOptions) -> list[Table]:
    """Return the tables of the recordings in a list of objects, or an object of lists."""
    recordings = recordings_in(content if isinstance(content, dict) else {"": content})
    return [
        table_of(path, _columns(path, each), topic=options.topic) for each in recordings
    ]


def _json_content(path: Path, lines: list[str]) -> Any:
    """Return the content of a JSON file, or that of each line."""
    try:
        return json.loads("\n".join(lines), object_hook=_listed)
    except ValueError:
        content = []
        for number, line in enumerate(lines, 1):
            try:
                content += [json.loads(line)] if line.strip() else []
            except ValueError as reason:
                raise SkillFileError(
                    f"{path}: line {number} is not JSON ({reason}); expected an object "
                    f"in each line, such as {_JSON_LINE}."
                ) from None
    return content


def _listed(content: dict[str, Any]) -> Any:
    """Return an object with the keys "0", "1" ..., which pandas writes, as a list."""
    is_list = "0" in content and list(content) == [*map(str, range(len(content)))]
    return list(content.values()) if is_list else content


def _columns(path: Path, content: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return the arrays of one recording; a list has the name ""."""
    values = dict(flat_values(content))
    rows = values[""] if list(values) == [""] else []
    is_rows = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
    if not (is_rows or _is_objects(rows)):
        raise SkillFileError(
            f"{path} holds neither objects nor lists of numbers; write an object in each "
            f"line, such as {_JSON_LINE}."
        )
    has_one = sum(map(_is_objects, values.values())) == 1
    columns: dict[str, NDArray[Any]] = {}
    for name, value in values.items():
        if _is_objects(value):
            stem = "" if has_one else f"{name}."
            columns |= {f"{stem}{n}": a for n, a in _object_columns(value).items()}
        else:
            column = _column(value) if isinstance(value, list) else None
            columns[name] = np.asarray(value) if column is None else column
    return columns


def _object_columns(objects: list[dict[str, Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays over a list of objects, NaN where a value is missing."""
    rows = [dict(flat_values(_with_numbers(item))) for item in objects]
    counts = Counter(name for row in rows for name in row)
    # A key of each object's own, such as its number, would make the table a square.
    is_empty = counts.total() * _RAREST < len(counts) * len(rows)
    least = len(rows) / _RAREST if is_empty else min(len(rows) / _RAREST, 2)
    partial = _in_partial_lists(objects, counts)
    names = [n for n, count in counts.items() if count >= least and n not in partial]
    columns = {name: _column([row.get(name) for row in rows]) for name in names}
    return {name: column for name, column in columns.items() if column is not None}


def _in_partial_lists(
    objects: list[dict[str, Any]], counts: Mapping[str, int]
) -> set[str]:
    """Return the names of values in lists that are empty in most objects, or vary in length.

    `counts` are the numbers of objects with each name. Elements of a list that varies in
    length, such as detections, are not the same ones in all objects.
    """
    numbered = {name for name in counts if _NUMBER.search(name)}
    if numbered:  # Some may be keys of mappings.
        numbered -= {name for item in objects for name, _ in flat_values(item)}
    elements: dict[str, list[str]] = {}
    for name in numbered:
        elements.setdefault(_NUMBER.sub("", name), []).append(name)
    partial = set[str]()
    for names in elements.values():
        numbers = {counts[name] for name in names}
        if len(numbers) > 1 or max(numbers) < LEAST_COMPLETE * len(objects):
            partial.update(names)
    return partial


def _with_numbers(content: Any) -> Any:
    """Return nested mappings in which lists of objects are mappings by their numbers."""
    if _is_objects(content):
        content = {str(k): item for k, item in enumerate(content)}
    if not isinstance(content, Mapping):
        return content
    return {name: _with_numbers(value) for name, value in content.items()}


def _column(values: list[Any]) -> NDArray[Any] | None:
    """Return values of one shape, NaN for missing ones; None where shapes differ."""
    shapes = {np.shape(value) for value in values if value not in (None, [])}
    if len(shapes) != 1:
        return None
    missing = np.full(shapes.pop(), np.nan)
    return np.array([missing if value in (None, []) else value for value in values])


def _is_objects(content: Any) -> bool:
    """Return whether a value is a list of objects."""
    is_list = isinstance(content, list) and len(content) > 0
    return is_list and all(isinstance(item, dict) for item in content)
