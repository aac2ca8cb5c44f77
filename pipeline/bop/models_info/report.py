"""What the search of symmetries found for a model, as one JSON object in BOP's units (millimetres)."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from pipeline.bop.models_info.symmetries import entries_of, group_from
from pipeline.bop.units import millimetres
from pipeline.symmetry_search.groups import Candidate
from pipeline.symmetry_search.search import SymmetrySearch


def report(search: SymmetrySearch, diameter: float, info: Mapping[str, Any]) -> dict[str, Any]:
    """The candidates, the suggested set in the form of `models_info.json`, and how it compares with what that lists.

    Args:
        search: What was found.
        diameter: Of the model, metres.
        info: The object's entry in `models_info.json`; empty if it has none.

    """
    listed = group_from(info)
    return {
        "diameter_mm": _mm(diameter),
        "epsilon_mm": _mm(search.epsilon),
        "candidate_bound_mm": _mm(search.bound),
        "seconds": round(search.seconds, 3),
        "candidates": [
            _candidate(candidate, diameter, index in search.suggested)
            for index, candidate in enumerate(search.candidates)
        ],
        "suggested": {"name": search.group.name, **entries_of(search.group)},
        "listed": listed.name,
        "suggested_is_listed": search.group.equals(listed, search.surface.extent),
    }


def _candidate(candidate: Candidate, diameter: float, suggested: bool) -> dict[str, Any]:
    return {
        "kind": candidate.kind,
        "fold": candidate.fold,
        "axis": np.round(candidate.axis.direction, 9).tolist(),
        "offset_mm": np.round(millimetres(candidate.axis.through), 6).tolist(),
        "distance_mm": _mm(candidate.distance),
        "distance_of_diameter": round(candidate.distance / diameter, 6),
        "distance_at_axis_mm": _mm(candidate.distance_at_axis),
        "mean_distance_mm": _mm(candidate.mean_distance),
        "suggested": suggested,
    }


def _mm(metres: float) -> float:
    return round(metres * 1000.0, 6)
