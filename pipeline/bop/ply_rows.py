"""The lower half of the PLY reader: its header, and the rows of each element as columns."""

from dataclasses import dataclass

import numpy as np

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class BadPlyError(Exception):
    """What is wrong with a PLY, without the name of the file."""


@dataclass(frozen=True)
class Property:
    """A column of an element."""

    name: str
    type: str
    count_type: str | None
    """Type of the length of a list, None for a single number."""


@dataclass(frozen=True)
class Element:
    """A table of the file, such as its vertices."""

    name: str
    count: int
    properties: list[Property]


@dataclass(frozen=True)
class Header:
    """What the header announces."""

    order: str
    """Byte order of binary data, empty for ASCII."""
    elements: list[Element]
    texture_file: str | None


Table = dict[str, np.ndarray]
"""Columns of an element: (n,) for single numbers, (n, k) for lists of k numbers."""


def read_header(data: bytes) -> tuple[Header, bytes]:
    """The header of a PLY and the data behind it. Raises BadPlyError if it is not understood."""
    if not data.startswith(b"ply"):
        raise BadPlyError("does not begin with 'ply', so it is no PLY mesh; export it as PLY")
    end = data.find(b"end_header")
    newline = data.find(b"\n", end)
    if end < 0 or newline < 0:
        raise BadPlyError("the header has no end_header; the file is cut off, get it again")
    order, elements, texture = "", [], None
    for line in data[:end].decode("latin-1").splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                order = _ORDERS[words[1]]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                elements[-1].properties.append(_property(words))
            elif words[:2] == ["comment", "TextureFile"]:
                texture = line.split(maxsplit=2)[2].strip()
        except (KeyError, IndexError, ValueError) as error:
            raise BadPlyError(f"header line {line[:60]!r} is not understood; export the mesh again") from error
    for element in elements:
        if element.count < 0 or len({prop.name for prop in element.properties}) < len(element.properties):
            raise BadPlyError(f"the header counts or names element {element.name} wrongly; export the mesh again")
    return Header(order, elements, texture), data[newline + 1 :]


def _property(words: list[str]) -> Property:
    if words[1] == "list":
        return Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return Property(words[2], _TYPES[words[1]], None)


def read_table(source: "BinaryRows | AsciiRows", element: Element) -> list[Table]:
    """All rows of an element, in runs of rows whose lists are equally long."""
    tables, remaining, at_once = [], element.count, element.count
    while remaining:
        table, count = source.read_run(element, source.list_lengths(element), min(remaining, at_once))
        if not count:
            read = element.count - remaining
            raise BadPlyError(f"{element.name} ends after {read} of {element.count} rows; it is cut off, get it again")
        tables.append(table)
        remaining, at_once = remaining - count, 4 * count  # short runs must not look at all that remains each time
    return tables


class BinaryRows:
    """Reads rows one after another from binary data."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order, self._at = data, order, 0

    def list_lengths(self, element: Element) -> list[int]:
        """Lengths of the lists of the next row."""
        at, lengths = self._at, []
        for prop in element.properties:
            if prop.count_type is not None and at < len(self._data):
                size = int(prop.count_type[1])
                lengths.append(int.from_bytes(self._data[at : at + size], "big" if self._order == ">" else "little"))
                at += size + lengths[-1] * int(prop.type[1])
            else:
                at += int(prop.type[1])
        return lengths

    def read_run(self, element: Element, lengths: list[int], rows: int) -> tuple[Table, int]:
        """As many of the next rows as have lists of these lengths, at most `rows`."""
        if max(lengths, default=0) > len(self._data):
            return {}, 0
        fields, remaining = [], iter(lengths)
        for prop in element.properties:
            if prop.count_type is not None:
                fields.append((f"#{prop.name}", self._order + prop.count_type))
                fields.append((prop.name, self._order + prop.type, (next(remaining, 0),)))
            else:
                fields.append((prop.name, self._order + prop.type))
        dtype = np.dtype(fields)
        available = (len(self._data) - self._at) // dtype.itemsize
        table = np.frombuffer(self._data, dtype, min(rows, available), self._at)
        counts = [table[f"#{prop.name}"] for prop in element.properties if prop.count_type is not None]
        count = _equal_run(counts, lengths, len(table))
        self._at += count * dtype.itemsize
        return {prop.name: table[prop.name][:count] for prop in element.properties}, count


class AsciiRows:
    """Reads rows one after another from text, all of whose numbers are taken in one go."""

    def __init__(self, data: bytes) -> None:
        try:
            self._numbers, self._at = np.array(data.split(), dtype=np.float64), 0
        except ValueError as error:
            raise BadPlyError(f"holds what is no number ({str(error)[:60]}); export the mesh again") from error

    def list_lengths(self, element: Element) -> list[int]:
        """Lengths of the lists of the next row."""
        at, lengths = self._at, []
        for prop in element.properties:
            if prop.count_type is not None and at < len(self._numbers):
                lengths.append(int(np.clip(self._numbers[at], 0, len(self._numbers))))
                at += lengths[-1]
            at += 1
        return lengths

    def read_run(self, element: Element, lengths: list[int], rows: int) -> tuple[Table, int]:
        """As many of the next rows as have lists of these lengths, at most `rows`."""
        columns, width, remaining = {}, 0, iter(lengths)
        for prop in element.properties:
            if prop.count_type is not None:
                columns[f"#{prop.name}"] = width
                columns[prop.name] = slice(width + 1, width + 1 + next(remaining, 0))
                width = columns[prop.name].stop
            else:
                columns[prop.name] = width
                width += 1
        available = (len(self._numbers) - self._at) // width
        table = self._numbers[self._at : self._at + min(rows, available) * width].reshape(-1, width)
        counts = [table[:, column] for name, column in columns.items() if name.startswith("#")]
        count = _equal_run(counts, lengths, len(table))
        self._at += count * width
        return {name: table[:count, column] for name, column in columns.items()}, count


def _equal_run(counts: list[np.ndarray], lengths: list[int], rows: int) -> int:
    """Number of rows at the beginning whose lists have the given lengths."""
    for column, length in zip(counts, lengths, strict=False):
        differing = np.flatnonzero(column[:rows] != length)
        rows = int(differing[0]) if len(differing) else rows
    return rows
