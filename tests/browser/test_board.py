"""The leaderboard in Chromium: numbers that open their targets, files that are handed in, other datasets."""

from pathlib import Path

import pytest
from opened_page import OpenedPage
from tiny_dataset import FIRST, SECOND, claim, make_dataset, perfect, pose, results_of

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.evaluate import Evaluation, evaluate
from pipeline.bop.results import read_results, write_results


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two datasets side by side, and results for both."""
    folder = tmp_path_factory.mktemp("data")
    for name in ("tiny", "other"):
        make_dataset(folder / name)
    missed = results_of(claim(FIRST, 2, pose(0.0, 0.05, 0.451)), claim(SECOND, 1, pose(0, 0, 0.5)), method="half")
    write_results(folder / "perfect_tiny-test.csv", perfect())
    write_results(folder / "half_tiny-test.csv", missed)
    write_results(folder / "perfect_other-test.csv", perfect())
    lines = (folder / "half_tiny-test.csv").read_text().splitlines()
    fields = lines[2].split(",")
    (folder / "broken_tiny-test.csv").write_text("\n".join([*lines[:2], ",".join([*fields[:3], "sure", *fields[4:]])]))
    return folder


@pytest.fixture(scope="module")
def server(serve, data: Path):
    return start(serve, data)


def start(serve, data: Path):
    return serve(data / "tiny", "--results", data / "perfect_tiny-test.csv", "--leaderboard", data / "leaderboard")


@pytest.fixture(scope="module")
def page(server, open_page) -> OpenedPage:
    return open_page(server.url, size=(1500, 900))


@pytest.fixture(scope="module")
def half(data: Path) -> Evaluation:
    return evaluate(open_dataset(data / "tiny"), read_results(data / "half_tiny-test.csv"))


def board(page: OpenedPage) -> dict[str, list[str]]:
    """Numbers of each method's row, left to right."""
    return page.page.evaluate(
        "Object.fromEntries([...document.querySelectorAll('.pi-board tr')].slice(1).map(row => ["
        "row.querySelector('td.pi-name div').textContent,"
        "[...row.querySelectorAll('.pi-number .pi-value')].map(value => value.textContent)]))"
    )


def hand_in(page: OpenedPage, path: Path) -> None:
    page.page.get_by_role("button", name="Add results…").click()
    with page.page.expect_file_chooser() as chooser:
        page.page.get_by_role("button", name="Choose a file…").click()
    chooser.value.set_files(path)


def test_served_methods_are_on_it_and_a_number_opens_its_targets(page: OpenedPage):
    page.page.keyboard.press("3")
    page.eventually(lambda: board(page) == {"perfect": ["100.0"]})
    assert page.address()["board.open"] == "1"
    page.page.locator(".pi-number").click()
    page.eventually(lambda: "board.open" not in page.address())
    page.settled()
    assert len(page.rows()) == 4
    assert {row[-1] for row in page.rows()} == {"correct"}


def test_a_file_with_a_fault_is_refused_with_line_and_column(page: OpenedPage, data: Path):
    page.show(**{"board.open": 1})
    hand_in(page, data / "broken_tiny-test.csv")
    dialog = page.page.locator(".mantine-Modal-content")
    dialog.get_by_text("line 3, column score: 'sure' is no number").wait_for()
    assert dialog.get_by_role("button", name="Add and evaluate").count() == 0
    dialog.get_by_role("button", name="Close").click()
    assert list(board(page)) == ["perfect"]


def test_a_file_that_is_handed_in_is_evaluated_and_kept_across_a_restart(
    page: OpenedPage, data: Path, half: Evaluation, serve, open_page
):
    page.show(**{"board.open": 1})
    hand_in(page, data / "half_tiny-test.csv")
    dialog = page.page.locator(".mantine-Modal-content")
    dialog.get_by_text("1 of 3 targets have no estimate").wait_for()
    dialog.locator("textarea").last.fill("image type: RGB-D")
    dialog.get_by_role("button", name="Add and evaluate").click()
    assert half.scores.average is not None
    numbers = {"perfect": ["100.0"], "half": [f"{100 * half.scores.average:.1f}"]}
    page.eventually(lambda: board(page) == numbers)
    restarted = open_page(start(serve, data).url, "board.open=1", size=(1500, 900))
    restarted.eventually(lambda: board(restarted) == numbers)
    assert "image type: RGB-D" in restarted.page.locator(".pi-board").inner_text()
    restarted.close()


def test_bars_of_two_methods_open_the_targets_of_an_object(page: OpenedPage, half: Evaluation):
    page.show(**{"board.open": 1, "board.score": "mssd"})
    page.page.locator(".pi-board tr", has_text="half").locator(".pi-second").click()
    of_both = ["100.0", f"{100 * half.per_object[1].mssd:.1f}"]
    first = page.page.locator(".pi-bar-line").first.locator(".pi-value")
    page.eventually(lambda: first.all_inner_texts() == of_both)
    assert page.page.locator(".pi-bar-line").count() == 2
    assert page.page.locator(".pi-chart").count() >= 4
    page.page.locator(".pi-bar-line").first.locator(".pi-track").nth(1).click()
    page.eventually(lambda: page.address().get("method") == "1")
    page.settled()
    assert page.address()["filter.obj_id"] == "1"
    assert {row[1] for row in page.rows()} == {"1"}


def test_the_number_of_another_dataset_opens_that_dataset(page: OpenedPage, data: Path):
    page.show(**{"board.open": 1})
    hand_in(page, data / "perfect_other-test.csv")
    page.page.locator(".mantine-Modal-content").get_by_role("button", name="Add and evaluate").click()
    page.eventually(lambda: board(page)["perfect"] == ["100.0", "100.0"])
    other = page.page.evaluate(
        "[...document.querySelectorAll('.pi-board th')].findIndex(h => h.innerText.includes('other'))"
    )
    page.page.locator(".pi-board tr", has_text="perfect").locator("td").nth(other).locator(".pi-number").click()
    page.eventually(lambda: page.address().get("dataset") == "other/test")
    page.eventually(lambda: page.page.title().startswith("other "))
    page.reload()
    page.eventually(lambda: page.page.title().startswith("other "))
    page.show("")
    page.eventually(lambda: page.page.title().startswith("tiny "))
