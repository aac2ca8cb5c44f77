"""Dictionaries of markers: OpenCV's by name, or our own from a file of bit patterns.

    {"cells": 4, "border": 2, "markers": [["0110", "1111", "0100", "0000"], ...]}

Each marker is its rows of cells from the top, 1 for white, without the black border of `border` cells around; its id is
its place in the list.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool

from pipeline.bop.json_files import read_json_object, write_atomically
from pipeline.exceptions import FormatError, InputError
from pipeline.synth.boards.marker_board import opencv_dictionary

CELLS = (3, 8)
"""Fewest and most cells along a side, without the border."""


@dataclass(frozen=True, eq=False)
class MarkerDictionary:
    """Which markers there are. Raises InputError for patterns that cannot be told apart."""

    patterns: Bool[np.ndarray, "m c c"]
    """White cells of each marker, by id, without the border."""
    border: int = 1
    """Width of the black border, in cells."""
    corrected: int = 0
    """Wrong cells that detection forgives."""

    def __post_init__(self) -> None:
        for one in range(len(self.patterns)):
            if (turns_alike := symmetry(self.patterns[one])) > 1:
                raise InputError(f"marker {one} looks alike in {turns_alike} orientations; leave it out")
            for other in range(one):
                if distance(self.patterns[one], self.patterns[other]) == 0:
                    raise InputError(f"markers {other} and {one} are the same but for a turn; leave one out")

    @property
    def opencv(self) -> Any:
        """As OpenCV's object."""
        lists = [cv2.aruco.Dictionary.getByteListFromBits(one.astype(np.uint8)) for one in self.patterns]
        return cv2.aruco.Dictionary(np.concatenate(lists), self.patterns.shape[1], self.corrected)


def distance(one: Bool[np.ndarray, "c c"], other: Bool[np.ndarray, "c c"]) -> int:
    """Cells in which two patterns differ, at the turn at which they are most alike."""
    return min(int((np.rot90(one, turn) != other).sum()) for turn in range(4))


def symmetry(pattern: Bool[np.ndarray, "c c"]) -> int:
    """In how many of four orientations a pattern looks the same: 1, 2 or 4."""
    return sum(bool((np.rot90(pattern, turn) == pattern).all()) for turn in range(4))


def named_dictionary(name: str) -> MarkerDictionary:
    """One of OpenCV's dictionaries. Raises `UnknownIdError`, which lists the names."""
    kind = opencv_dictionary(name)
    patterns = [
        cv2.aruco.Dictionary.getBitsFromByteList(kind.bytesList[k : k + 1], kind.markerSize)
        for k in range(len(kind.bytesList))
    ]
    return _trusted(np.array(patterns, bool), 1, int(kind.maxCorrectionBits))


def any_dictionary(name: str) -> MarkerDictionary:
    """The dictionary of a file (a name that ends in .json), or OpenCV's of this name. Raises InputError."""
    return read_dictionary(Path(name)) if name.endswith(".json") else named_dictionary(name)


def _trusted(patterns: np.ndarray, border: int, corrected: int) -> MarkerDictionary:
    """A dictionary that is known to be sound: the comparison of all with all takes long for a thousand markers."""
    made = object.__new__(MarkerDictionary)
    for name, value in (("patterns", patterns), ("border", border), ("corrected", corrected)):
        object.__setattr__(made, name, value)
    return made


def read_dictionary(path: Path) -> MarkerDictionary:
    """Read a file of bit patterns. Raises MissingFileError or FormatError, one line with the entry and the fix."""
    content = read_json_object(path)
    cells, border, rows = content.get("cells"), content.get("border", 1), content.get("markers")
    if type(cells) is not int or not CELLS[0] <= cells <= CELLS[1]:
        raise FormatError(f'{path}: "cells" is {json.dumps(cells)}; give a whole number from {CELLS[0]} to {CELLS[1]}')
    if type(border) is not int or not 1 <= border <= 4:
        raise FormatError(f'{path}: "border" is {json.dumps(border)}; give a whole number from 1 to 4')
    if not isinstance(rows, list) or not rows:
        raise FormatError(f'{path}: "markers" is missing or empty; list the rows of each marker')
    patterns = np.stack([_pattern(path, k, entry, cells) for k, entry in enumerate(rows)])
    try:
        return MarkerDictionary(patterns, border)
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None


def _pattern(path: Path, position: int, entry: Any, cells: int) -> Bool[np.ndarray, "c c"]:
    good = isinstance(entry, list) and len(entry) == cells
    if not good or not all(isinstance(row, str) and len(row) == cells and not row.strip("01") for row in entry):
        example = ["0" * (cells - 1) + "1"] * cells
        raise FormatError(
            f"{path}: marker {position} is {json.dumps(entry)[:60]}; write {cells} rows such as {json.dumps(example)[:60]}"
        )
    return np.array([[cell == "1" for cell in row] for row in entry])


def write_dictionary(path: Path, dictionary: MarkerDictionary) -> None:
    """Write a file of bit patterns, one marker a line. Raises InputError if it cannot be written."""
    head = f'{{"cells": {dictionary.patterns.shape[1]}, "border": {dictionary.border}, "markers": [\n'
    rows = [json.dumps(["".join("01"[cell] for cell in row) for row in one.astype(int)]) for one in dictionary.patterns]
    write_atomically(path, (head + ",\n".join(f"  {row}" for row in rows) + "\n]}\n").encode())
