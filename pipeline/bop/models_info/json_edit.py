"""Changing single members of a JSON object and nothing else: all other text stays as it was, digit for digit."""

import json
import re
from collections.abc import Mapping
from typing import NamedTuple

_SPACE = re.compile(r"[ \t\r\n]*")
_DECODER = json.JSONDecoder()


class Member(NamedTuple):
    """Where a member of an object stands in a text."""

    key: str
    start: int
    """Of the key."""
    colon: int
    """Behind the key."""
    value: int
    """Of the value."""
    end: int
    """Behind the value."""


def members(text: str) -> tuple[list[Member], int, int]:
    """The members of the object that a text holds, and the positions behind `{` and of `}`.

    Raises ValueError if the text is no JSON object.
    """
    position = _skip(text, 0)
    if text[position : position + 1] != "{":
        raise ValueError("no object")
    first = position + 1
    found: list[Member] = []
    position = _skip(text, first)
    while text[position : position + 1] != "}":
        if found:
            position = _skip(text, _after(text, position, ","))
        key, behind = _DECODER.raw_decode(text, position)
        value = _skip(text, _after(text, _skip(text, behind), ":"))
        end = _DECODER.raw_decode(text, value)[1]
        found.append(Member(key, position, behind, value, end))
        position = _skip(text, end)
    return found, first, position


def with_members(text: str, changes: Mapping[str, str | None]) -> str:
    """The text of an object with some members set to the given JSON texts, or removed (None); new ones come last.

    What is new is laid out as its neighbours are. Raises ValueError if the text is no JSON object.
    """
    found, first, last = members(text)
    lead = text[first : found[0].start] if found else ""
    tail = text[found[-1].end : last] if found else ""
    between = text[found[0].end : found[1].start] if len(found) > 1 else f",{lead or ' '}"
    colon = text[found[0].colon : found[0].value] if found else ": "
    parts: list[tuple[str, str]] = []
    for i, member in enumerate(found):
        gap = text[found[i - 1].end : member.start] if i else between
        if member.key not in changes:
            parts.append((gap, text[member.start : member.end]))
        elif (value := changes[member.key]) is not None:
            parts.append((gap, text[member.start : member.value] + value))
    known = {member.key for member in found}
    added = [(key, value) for key, value in changes.items() if key not in known and value is not None]
    parts += [(between, f"{json.dumps(key)}{colon}{value}") for key, value in added]
    body = "".join(part if i == 0 else gap + part for i, (gap, part) in enumerate(parts))
    return f"{text[:first]}{lead}{body}{tail}{text[last:]}"


def _skip(text: str, position: int) -> int:
    found = _SPACE.match(text, position)
    assert found is not None
    return found.end()


def _after(text: str, position: int, mark: str) -> int:
    if text[position : position + 1] != mark:
        raise ValueError(f"no {mark} at {position}")
    return position + 1
