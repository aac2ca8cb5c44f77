"""The part of the tab about an annotated instance: why it was found or lost, check by check."""

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any, NamedTuple

from inspector import html
from inspector.hashmatch import pieces
from inspector.hashmatch.choice import FOLLOWED, query, window_query
from pipeline.explaining import Explanation
from pipeline.scene import ImageKey

PLACES = {
    "template": "no template near",
    "pyramid": "outside of the pyramid",
    "objectness": "lost in objectness",
    "size": "lost by its size",
    "hashing": "lost in hashing",
    "verification": "lost in verification",
    "suppression": "suppressed",
    "selection": "not selected",
    "refinement": "lost in refinement",
    "found": "found",
}
"""Where an instance was lost, in words."""


class Check(NamedTuple):
    """One step of the way of an instance through the method."""

    name: str
    passed: bool | None
    """None where it says nothing of itself, or was not reached."""
    text: str
    choose: str
    """Part of an address that shows the evidence; empty for none."""


def verdict_line(explanation: Explanation | None, missing: str, *, brief: bool = False) -> str:
    """What became of the selected instance, in one sentence (or, `brief`, in words); or why that is not known."""
    if explanation is None:
        return f'<div class="pi-hm-verdict">{escape(missing)}</div>'
    state = "good" if explanation.stage == "found" else "bad"
    place = PLACES.get(explanation.stage, explanation.stage)
    if brief:
        hint = escape(explanation.verdict, quote=True)
        return f'<div class="pi-hm-verdict pi-hm-{state}" title="{hint}"><b>{escape(place)}</b></div>'
    return f'<div class="pi-hm-verdict pi-hm-{state}"><b>{escape(place)}</b> {escape(explanation.verdict)}</div>'


def warning(text: str) -> str:
    """What cannot be shown, and why."""
    return f'<div class="pi-hm-verdict pi-hm-warning">{escape(text)}</div>'


def trace_part(key: ImageKey, explanation: Explanation) -> str:
    """All checks of an instance; a click on one shows its evidence in the picture."""
    rows = []
    for check in checks(key, explanation):
        inner = f"{pieces.mark(check.passed)}<span>{escape(check.name)}</span><span>{escape(check.text)}</span>"
        if check.choose:
            rows.append(
                pieces.choosing("div", check.choose, f"{inner}<em>›</em>", classes="pi-hm-check", hint="show it")
            )
        else:
            rows.append(f'<div class="pi-hm-check">{inner}<em></em></div>')
    remark = "The template nearest to the ground truth, at the window about it that came farthest:"
    return html.paragraph(remark, dim=True) + f'<div class="pi-hm-chain">{"".join(rows)}</div>'


def checks(key: ImageKey, explanation: Explanation) -> list[Check]:
    """The checks of an instance of HashMatch in their order; of another method, its numbers."""
    details = explanation.details
    if "followed" not in details:
        return [Check(one.name, None, _number(one.value, one.limit, one.unit), "") for one in explanation.evidence]
    before = [*_of_window(key, explanation, details), *_of_tests(key, details)]
    after = [*_of_detections(key, explanation, details)]
    if details["detections"]["count"]:  # other templates were detected, whatever became of this one
        before = [check._replace(passed=check.passed or None) for check in before]
    return _with_one_failure([*before, *after])


def _with_one_failure(found: list[Check]) -> list[Check]:
    """Only the check at which the instance was lost counts as failed; what follows from it does not."""
    failed = next((i for i, check in enumerate(found) if check.passed is False), len(found))
    return found[: failed + 1] + [check._replace(passed=check.passed or None) for check in found[failed + 1 :]]


def _of_window(key: ImageKey, explanation: Explanation, details: Mapping[str, Any]) -> Iterator[Check]:
    template, window = details.get("template"), details.get("window")
    if template is None or window is None:
        yield Check("window", False, "no level of the pyramid fits", query(key, stage="windows"))
        return
    there = {"pixel": (window["u"], window["v"]), "level": window["level"]}
    limit = next((one.limit for one in explanation.evidence if one.unit == "deg"), None)
    angle = template["angle_deg"]
    yield Check(
        "nearest template", limit is None or angle <= limit, f"{angle:.1f}° off", _at(key, there, part="window")
    )
    where = f"level {window['level']} (scale {window['scale']:.2f}), at {window['u']:.0f}, {window['v']:.0f}"
    yield Check("window", True, where, _at(key, there, stage="windows"))
    edgels = details["objectness"]
    text = f"{edgels['edgels']} edgels, more than {edgels['needed']:.0f} needed"
    yield Check("objectness", edgels["passed"], text, _at(key, there, stage="objectness"))
    possible = details.get("size_possible")
    reached = edgels["passed"]
    yield Check(
        "object's size",
        possible if reached else None,
        "possible" if possible else "impossible here",
        _at(key, there, stage="objectness"),
    )
    votes = details["votes"]
    reached = reached and bool(possible)
    rank = f", rank {votes['rank']} of at most {votes['kept_at_most']}" if votes["rank"] else ""
    text = f"{votes['votes']} votes of {votes['needed']} needed{rank}"
    yield Check("hashing", votes["passed"] if reached else None, text, _at(key, there, stage="hashing"))


def _of_tests(key: ImageKey, details: Mapping[str, Any]) -> Iterator[Check]:
    window, failed = details.get("window"), False
    if window is None:
        return
    there = {"pixel": (window["u"], window["v"]), "level": window["level"]}
    for test in details.get("tests") or ():
        passed = None if failed else test["passed"]
        if test["test"] == 1:
            text = f"{test['measured']:.3f} m measured, {test['nearest']:.3f} to {test['farthest']:.3f} m fit"
        elif test["fraction"] is None:
            text = "off: the model has no colour"
        else:
            short = test["needed"] - test["fraction"]
            text = f"{test['fraction']:.2f} of {test['needed']:.2f}" + (
                f", {short:.2f} short" if passed is False else ""
            )
        yield Check(test["name"], passed, text, _at(key, there, stage="verification", part="window", test=test["test"]))
        failed |= test["passed"] is False


def _of_detections(key: ImageKey, explanation: Explanation, details: Mapping[str, Any]) -> Iterator[Check]:
    found = details["detections"]
    if not found["count"]:
        nearest = found["nearest_error"]
        text = "none" if nearest is None else f"none of it; the nearest is {nearest:.2f} d off"
        yield Check("detections", False, text, query(key, stage="verification", level=None))
        return
    text = f"{found['count']}, the best with rank {found['rank']}"
    yield Check("detections", True, text, _detection(key, found["best"], stage="verification"))
    by = found["suppressed_by"]
    if by is not None:
        text = f"the best was suppressed by detection {by['detection']}"
        passed = None if explanation.stage != "suppression" else False
        yield Check("non-max. suppression", passed, text, _detection(key, by["detection"], stage="nms"))
    else:
        yield Check("non-max. suppression", True, "the best was kept", _detection(key, found["best"], stage="nms"))
    yield from _of_refinement(key, explanation, details["refinement"])


def _of_refinement(key: ImageKey, explanation: Explanation, refinement: Mapping[str, Any]) -> Iterator[Check]:
    before, after, chosen = (refinement[name] for name in ("rough_error", "moved_error", "chosen_error"))
    show = query(key, part="swarm", instance=None, iteration=None, stage="off")
    if before is not None and after is not None:
        text = f"MSSD {before:.2f} d → {after:.2f} d ({refinement['proposed']} poses refined)"
        yield Check("refinement", explanation.stage not in ("refinement",), text, show)
    elif explanation.stage != "suppression":
        yield Check("refinement", False, "none of its detections was refined", "")
    if explanation.stage == "found":
        yield Check("estimate", True, f"MSSD {chosen:.3f} d", show)
    else:
        text = "none" if chosen is None else f"the nearest one is {chosen:.2f} d off"
        yield Check("estimate", False, text, "")


def _at(key: ImageKey, there: Mapping[str, Any], **more: Any) -> str:
    """The part of an address that shows the template and window of a trace."""
    return window_query(key, **dict(there), **{"template": FOLLOWED, **more})


def _detection(key: ImageKey, row: int, **more: Any) -> str:
    return window_query(key, detection=row, level=None, **more)


def _number(value: float, limit: float | None, unit: str) -> str:
    against = "" if limit is None else f" (limit {limit:.3g})"
    return f"{value:.3g} {unit}{against}".strip()
