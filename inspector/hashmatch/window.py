"""The part of the tab about a window: its votes, and the tests of one of its templates."""

from html import escape
from typing import NamedTuple

from inspector import html
from inspector.hashmatch import modalities, pieces
from inspector.hashmatch.choice import query, window_query
from inspector.hashmatch.image_record import ChosenWindow, ImageRecord
from inspector.hashmatch.modalities import MODALITIES
from pipeline.exceptions import InputError
from pipeline.hashmatch.window_report import TemplateVotes
from pipeline.scene import ImageKey

HOW_TO_BEGIN = (
    "Click into the image to look into the window there: its templates, and the tests that they passed or failed. "
    "Shift-click still selects an object."
)
ENDINGS = {
    "objectness": "rejected by objectness",
    "size": "no object of fitting size",
    "hashing": "too few votes",
    "verification": "rejected by verification",
    "suppression": "suppressed by another detection",
    "kept": "kept as a detection",
}
"""What became of a window."""


class Outcome(NamedTuple):
    """The outcome of a test."""

    number: int
    passed: bool | None
    """None where it was not made."""
    fraction: float | None
    """Share of matching points; None where there is none (T1, or not made)."""


def outcomes_of(vote: TemplateVotes, *, colored: bool) -> list[Outcome]:
    """Outcomes of T1 to T5: after the first that failed none is made, and T5 is off without colours."""
    found = [Outcome(1, vote.failed_test != 1, None)]
    for number in range(2, 6):
        made = vote.failed_test in (0, *range(number, 6)) and (number < 5 or colored)
        fraction = vote.fractions[number - 2] if made else None
        found.append(Outcome(number, vote.failed_test != number if made else None, fraction))
    return found


def shown_test(vote: TemplateVotes, chosen: int) -> int:
    """The test whose points are shown: the one that is chosen, that failed, or T2."""
    return chosen if chosen in range(1, 6) else vote.failed_test or 2


def window_part(record: ImageRecord, chosen: ChosenWindow, test: int) -> str:
    """All about a window; pictures that cannot be had are told in one line."""
    report, vote = chosen.report, chosen.vote
    state = "good" if report.stage == "kept" else "bad"
    where = f"level {report.level} · scale {report.scale:.2f} · centre {report.center[0]:.0f}, {report.center[1]:.0f}"
    lines = [
        f'<div class="pi-hm-verdict pi-hm-{state}"><b>{escape(ENDINGS[report.stage])}</b> {escape(report.verdict)}</div>',
        f'<div class="pi-dim pi-hm-small">{escape(where)}</div>',
        _objectness(report.edgels, report.edgels_needed),
    ]
    if vote is None:
        return "".join(lines) + _window_alone(record, chosen)
    lines += [_votes(record, chosen)]
    number = shown_test(vote, test)
    colored = record.colored(vote.obj_id)
    lines += [
        _title(record.reader.key, vote),
        _tests(outcomes_of(vote, colored=colored), number, report.matches_needed),
    ]
    return "".join(lines) + _pictures(record, chosen, vote, number)


def _objectness(edgels: int, needed: float) -> str:
    most = max(edgels, needed) * 1.05
    numbers = f"{edgels} edgels of {needed:.0f}"
    passed = edgels > needed
    bar = pieces.bar(edgels / most, good=passed, mark=needed / most)
    return f'<div class="pi-hm-test">{pieces.mark(passed)}<span>objectness</span>{bar}<span>{numbers}</span></div>'


def _votes(record: ImageRecord, chosen: ChosenWindow) -> str:
    """The window's templates, best voted first: picture, votes as a bar, and how far each came in the tests."""
    most = max(1, *(vote.votes for vote in chosen.votes))
    title = f"{chosen.report.candidates} templates passed on by votes"
    rows = [_vote(record, chosen, position, most) for position in range(len(chosen.votes))]
    steps = _step(chosen, -1, "‹") + _step(chosen, 1, "›")
    return (
        f'<div class="pi-hm-caption"><b>{escape(title)}</b><span>{steps}</span></div>'
        + f'<div class="pi-hm-votes">{"".join(rows)}</div>'
    )


def _step(chosen: ChosenWindow, by: int, sign: str) -> str:
    """A button to the template before or after."""
    position = (chosen.position + by) % len(chosen.votes)
    return pieces.choosing(
        "span", query(template=position, test=0), sign, classes="pi-hm-step", hint="another template"
    )


def _vote(record: ImageRecord, chosen: ChosenWindow, position: int, most: int) -> str:
    vote = chosen.votes[position]
    try:
        picture = pieces.image(record.template_pictures(vote.obj_id, vote.template).rgb, f"template {vote.template}")
    except InputError:
        picture = '<span class="pi-hm-nothing"></span>'
    rank = f"rank {vote.rank}" if vote.rank else "detected" if vote.detection is not None else "no rank"
    if position == chosen.followed:
        rank += " · traced"
    name = f"<span>object {vote.obj_id}<em>#{vote.template} · {rank}</em></span>"
    votes = f"<span>{pieces.bar(vote.votes / most)}<b>{vote.votes}</b></span>"
    marks = "".join(
        f'<i class="{_MARKS[test.passed]}"></i>' for test in outcomes_of(vote, colored=record.colored(vote.obj_id))
    )
    hint = f"template {vote.template} of object {vote.obj_id}: {vote.votes} votes; {_outcome(vote)}"
    inner = f'{picture}{name}{votes}<span class="pi-hm-five">{marks}</span>'
    return pieces.choosing("div", query(template=position, test=0), inner, on=position == chosen.position, hint=hint)


_MARKS = {True: "pi-hm-passed", False: "pi-hm-failed", None: ""}


def _outcome(vote: TemplateVotes) -> str:
    if not vote.failed_test:
        return "passed all tests"
    return f"failed {pieces.name_of_test(vote.failed_test)}"


def _title(key: ImageKey, vote: TemplateVotes) -> str:
    """What became of the template that is looked at."""
    if vote.failed_test:
        short = "" if vote.missing is None else f", {vote.missing:.2f} short"
        said = f'<b class="pi-bad">failed {escape(pieces.name_of_test(vote.failed_test))}{short}</b>'
    elif vote.suppressed_by is not None:
        link = pieces.choosing(
            "span",
            window_query(key, detection=vote.suppressed_by),
            f"detection {vote.suppressed_by}",
            classes="pi-hm-link",
        )
        said = f'<b class="pi-bad">suppressed</b> by {link}'
    elif vote.kept:
        said = f'<b class="pi-good">detection {vote.detection}, kept</b>'
    else:
        said = '<b class="pi-good">passed all tests</b>'
    return f"<h4>Template {vote.template} of object {vote.obj_id}: {said}</h4>"


def _tests(tests: list[Outcome], shown: int, needed: float) -> str:
    rows = []
    for test in tests:
        name = pieces.name_of_test(test.number)
        if test.fraction is None:
            text = {True: "passed", False: "failed", None: "not made"}[test.passed]
            bar = "<span></span>"
        else:
            text = f"{test.fraction:.2f} of {needed:.2f}"
            bar = pieces.bar(test.fraction, good=test.passed, mark=needed)
        inner = f"{pieces.mark(test.passed)}<span>{escape(name)}</span>{bar}<span>{text}</span>"
        on = test.number == shown
        rows.append(
            pieces.choosing(
                "div", query(test=test.number), inner, classes="pi-hm-test", on=on, hint=f"show the points of {name}"
            )
        )
    return "".join(rows)


def _pictures(record: ImageRecord, chosen: ChosenWindow, vote: TemplateVotes, test: int) -> str:
    """Window above template in all modalities, and larger, with the points of one test."""
    try:
        window = record.window_pictures(chosen.report)
        both = modalities.pairs(window, record.template_pictures(vote.obj_id, vote.template))
        points = record.points(chosen.report, vote)
    except InputError as error:
        return html.paragraph(f"No pictures: {str(error).splitlines()[0]}", dim=True)
    dotted = modalities.with_points(both[modalities.modality_of(test)], points, test)
    large = [
        f"<figure>{pieces.image(one, f'points of T{test} in the {name}')}<figcaption>{name}</figcaption></figure>"
        for name, one in zip(("window", "template"), dotted, strict=True)
    ]
    of_test = points.test == test
    count = f"{int(points.matched[of_test].sum())} of {int(of_test.sum())} points match"
    caption = f'<div class="pi-hm-caption"><b>{escape(pieces.name_of_test(test))}</b><span>{count}</span></div>'
    small = [pieces.image(both[name].window, f"{name} of the window") for name in MODALITIES]
    small += [pieces.image(both[name].template, f"{name} of the template") for name in MODALITIES]
    names = [f"<em>{name}</em>" for name in MODALITIES]
    return (
        f'{caption}<div class="pi-hm-pair">{"".join(large)}</div>'
        f'<div class="pi-hm-grid">{"".join(small)}{"".join(names)}</div>'
    )


def _window_alone(record: ImageRecord, chosen: ChosenWindow) -> str:
    window = record.window_pictures(chosen.report)
    alone = modalities.pairs(window, window)
    small = [pieces.image(alone[name].window, f"{name} of the window") for name in MODALITIES]
    return f'<div class="pi-hm-grid">{"".join(small)}{"".join(f"<em>{name}</em>" for name in MODALITIES)}</div>'
