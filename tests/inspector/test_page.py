"""The channel between a page and its session, on a real event loop."""

import asyncio
import json
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from inspector import page
from inspector.page import PageChannel, PageChannels, static_files


def on_a_loop(scenario: Callable[[], Any]) -> Any:
    return asyncio.run(asyncio.wait_for(scenario(), 20))


def channel(**methods: Callable[..., Any]) -> PageChannel:
    return PageChannel(asyncio.get_running_loop(), methods)


def test_calls_run_in_order_and_not_on_the_loop():
    done: list[int] = []
    threads: set[int] = set()

    def note(number: int) -> int:
        time.sleep(0.002 if number % 2 else 0)  # a slow call does not let the next one overtake it
        threads.add(threading.get_ident())
        done.append(number)
        return number

    async def scenario() -> list[int]:
        found = channel(note=note)
        return await asyncio.gather(*(found.call("note", [i]) for i in range(20)))

    assert on_a_loop(scenario) == list(range(20))
    assert done == list(range(20))
    assert len(threads) == 1
    assert threading.get_ident() not in threads


def test_a_busy_page_does_not_hold_up_another():
    go_on = threading.Event()

    async def scenario() -> str:
        slow, quick = channel(wait=lambda: go_on.wait(10)), channel(answer=lambda: "at once")
        waiting = asyncio.ensure_future(slow.call("wait", []))
        answer = await quick.call("answer", [])
        assert not waiting.done()
        go_on.set()
        await waiting
        return answer

    assert on_a_loop(scenario) == "at once"


@pytest.mark.parametrize(
    ("method", "arguments"), [("absent", []), ("add", []), ("add", [1, 2, 3]), ("add", ["a", 1]), ("fail", [])]
)
def test_what_cannot_be_called_gives_none_and_the_next_call_works(
    method: str, arguments: list[Any], caplog: pytest.LogCaptureFixture
):
    def fail() -> None:
        raise RuntimeError

    async def scenario() -> tuple[Any, Any]:
        found = channel(add=lambda a, b: a + b, fail=fail)
        return await found.call(method, arguments), await found.call("add", [1, 2])

    with caplog.at_level(logging.CRITICAL, "inspector.page"):
        assert on_a_loop(scenario) == (None, 3)


def test_news_that_are_there_come_at_once():
    async def scenario() -> dict[str, Any]:
        found = channel()
        found.publish(rows=3)
        await asyncio.sleep(0)
        return await found.news(0)

    news = on_a_loop(scenario)
    assert news["rows"] == 3
    assert news["version"] == 2


def test_a_waiting_page_is_woken_from_another_thread():
    async def scenario() -> dict[str, Any]:
        found = channel()
        now = await found.news(0)
        waiting = asyncio.ensure_future(found.news(now["version"]))
        await asyncio.sleep(0)
        assert not waiting.done()
        await asyncio.to_thread(found.publish, title="new")
        return await asyncio.wait_for(waiting, 2)

    assert on_a_loop(scenario)["title"] == "new"


def test_without_news_a_page_is_answered_after_a_while(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(page, "PATIENCE", 0.05)

    async def scenario() -> tuple[dict[str, Any], dict[str, Any]]:
        found = channel()
        now = await found.news(0)
        return now, await found.news(now["version"])

    before, after = on_a_loop(scenario)
    assert before == after


def test_the_version_grows_only_with_what_changed_and_nothing_is_lost():
    async def scenario() -> list[dict[str, Any]]:
        found, seen = channel(), []
        for state in ({"a": 1}, {"a": 1}, {"b": 2}, {"a": 3, "b": 2}):
            found.publish(**state)
            await asyncio.sleep(0)
            seen.append(await found.news(0))
        return seen

    seen = on_a_loop(scenario)
    assert [news["version"] for news in seen] == [2, 2, 3, 4]
    assert seen[-1] == {"a": 3, "b": 2, "version": 4}


def test_two_pages_that_wait_on_one_channel_are_both_woken():
    async def scenario() -> list[dict[str, Any]]:
        found = channel()
        waiting = [asyncio.ensure_future(found.news(1)) for _ in range(2)]
        await asyncio.sleep(0)
        found.publish(a=1)
        return await asyncio.gather(*waiting)

    assert [news["a"] for news in on_a_loop(scenario)] == [1, 1]


def answers(query: dict[str, str], method: str = "answer_call") -> Any:
    """The answer of `PageChannels` with one channel `key` that can `add`."""

    async def scenario() -> bytes | None:
        channels, found = PageChannels(), channel(add=lambda a, b: a + b)
        channels.add(found)
        found.publish(rows=3)
        await asyncio.sleep(0)
        asked = {name: value.replace("KEY", found.key) for name, value in query.items()}
        return await getattr(channels, method)(asked)

    found = on_a_loop(scenario)
    return None if found is None else json.loads(found)


def test_a_call_is_answered_with_json():
    assert answers({"key": "KEY", "method": "add", "args": "[1, 2]"}) == 3


@pytest.mark.parametrize("key", ["", "wrong", "KEYx"])
@pytest.mark.parametrize("method", ["answer_call", "answer_state"])
def test_an_unknown_key_gets_nothing(key: str, method: str):
    assert answers({"key": key, "method": "add", "args": "[1, 2]"}, method) is None
    assert answers({}, method) is None


@pytest.mark.parametrize("args", ["[1, 2", "", "nonsense"])
def test_arguments_that_are_no_json_get_nothing(args: str):
    assert answers({"key": "KEY", "method": "add", "args": args}) is None


@pytest.mark.parametrize("args", ["{}", "3", "null", '"text"'])
def test_arguments_that_are_no_list_are_none(args: str):
    assert answers({"key": "KEY", "method": "add", "args": args}) is None


@pytest.mark.parametrize("since", ["0", "1", "-1", "x", "", "1.5", "²"])
def test_the_state_is_answered_whatever_the_page_says_it_knows(since: str):
    assert answers({"key": "KEY", "since": since}, "answer_state") == {"rows": 3, "version": 2}


def test_keys_are_long_and_never_the_same():
    async def scenario() -> set[str]:
        return {channel().key for _ in range(50)}

    keys = on_a_loop(scenario)
    assert len(keys) == 50
    assert min(map(len, keys)) >= 24


def test_a_page_that_went_away_is_forgotten():
    async def scenario() -> bytes | None:
        channels, found = PageChannels(), channel(add=lambda: 1)
        channels.add(found)
        channels.remove(found)
        channels.remove(found)
        return await channels.answer_call({"key": found.key, "method": "add", "args": "[]"})

    assert on_a_loop(scenario) is None


def test_our_script_and_style_are_served():
    files = static_files()
    assert set(files) == {f"/{name}.{suffix}" for name in ("inspector", "leaderboard") for suffix in ("js", "css")}
    assert all(content for _, content in files.values())
