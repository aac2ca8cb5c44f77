"""Learning objects: the cache by content, going on after an end, several workers, and what can be wrong with a cache."""

import errno
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hashmatch_parts import COARSE, other_part, part

from pipeline.exceptions import InputError
from pipeline.hashmatch import template_cache
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.learning import Progress, learned
from pipeline.hashmatch.rendered_templates import RenderedTemplates
from pipeline.hashmatch.template_cache import TemplateCache
from pipeline.hashmatch.templates import Templates
from pipeline.parallel import HERE, Workers, open_workers

FEW = replace(COARSE, angle_step_deg=90, in_plane_limit_deg=0)
"""4 views, of which each is a template."""
PARTS = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=0)
"""72 views, learned in 2 parts."""


def learn_into(
    folder: Path,
    config: HashMatchConfig = FEW,
    obj_ids: tuple[int, ...] = (1,),
    workers: Workers = HERE,
    progress: Progress = lambda *_: None,
) -> list[Templates]:
    source = RenderedTemplates({1: part(), 2: other_part()}, config, 300.0)
    return learned(source, obj_ids, TemplateCache(folder), workers, progress)


def assert_same(one: Templates, other: Templates) -> None:
    for name, value in vars(one).items():
        np.testing.assert_array_equal(getattr(other, name), value)


def files(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_what_was_learned_is_read_back_exactly(tmp_path: Path):
    (first,) = learn_into(tmp_path)
    before = files(tmp_path)
    told: list[tuple[str, int, int]] = []
    (again,) = learn_into(tmp_path, progress=lambda *news: told.append(news))
    assert_same(first, again)
    assert files(tmp_path) == before
    assert not told


def test_a_new_object_or_setting_leaves_the_others_as_they_are(tmp_path: Path):
    learn_into(tmp_path)
    before = files(tmp_path)
    assert [own.obj_id for own in learn_into(tmp_path, obj_ids=(2, 1))] == [2, 1]
    learn_into(tmp_path, replace(FEW, points=50))
    after = files(tmp_path)
    assert {name: after[name] for name in before} == before
    assert len(after) == 3
    others = {
        "tables": 7,
        "seed": 3,
        "threads": 2,
        "cache": tmp_path,
        "skip_symmetric_views": not FEW.skip_symmetric_views,
    }
    learn_into(tmp_path, replace(FEW, **others))  # templates do not depend on these, nor on symmetries that are not
    assert files(tmp_path) == after


def test_progress_names_the_object_and_counts_templates(tmp_path: Path):
    told: list[tuple[str, int, int]] = []
    learn_into(tmp_path, PARTS, (1, 2), progress=lambda *news: told.append(news))
    assert told == [
        ("learning object 1 (1 of 2)", 0, 144), ("learning object 1 (1 of 2)", 36, 144), ("learning object 2 (2 of 2)", 72, 144),
        ("learning object 2 (2 of 2)", 108, 144), ("learned 2 objects", 144, 144),
    ]  # fmt: skip


def test_learning_that_was_stopped_goes_on_where_it_was(tmp_path: Path):
    (whole,) = learn_into(tmp_path / "whole", PARTS)

    def stop(_: str, done: int, __: int) -> None:
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn_into(tmp_path / "stopped", PARTS, progress=stop)
    assert len(files(tmp_path / "stopped")) == 1
    told: list[tuple[str, int, int]] = []
    (resumed,) = learn_into(tmp_path / "stopped", PARTS, progress=lambda *news: told.append(news))
    assert told == [("learning object 1", 36, 72), ("learned one object", 72, 72)]
    assert_same(whole, resumed)
    assert list(files(tmp_path / "stopped")) == list(files(tmp_path / "whole"))


def test_several_processes_learn_the_same(tmp_path: Path):
    alone = learn_into(tmp_path / "alone", PARTS, (1, 2))
    with open_workers(2) as workers:
        together = learn_into(tmp_path / "together", PARTS, (1, 2), workers)
    for one, other in zip(alone, together, strict=True):
        assert_same(one, other)


@pytest.mark.parametrize("damage", ["version", "cut", "empty", "no archive", "not all"])
def test_what_cannot_be_used_is_learned_anew_and_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, damage: str
):
    (first,) = learn_into(tmp_path)
    (path,) = tmp_path.iterdir()
    if damage == "version":
        monkeypatch.setattr(template_cache, "version", lambda: "another")
    elif damage == "not all":
        np.savez(path, version=template_cache.version(), obj_id=1)
    else:
        path.write_bytes({"cut": path.read_bytes()[:5000], "empty": b"", "no archive": b"PK\x03\x04 nothing"}[damage])
    with caplog.at_level(logging.INFO):
        (again,) = learn_into(tmp_path)
    assert_same(first, again)
    reason = {
        "version": "has templates that another version of this program made",
        "not all": "lacks some of what templates hold",
    }
    (record,) = caplog.records
    expected = reason.get(damage, "is no readable file of templates")
    assert record.levelno == (logging.INFO if damage == "version" else logging.WARNING)
    assert record.getMessage() == f"{path}: {expected}; they are learned anew"
    caplog.clear()
    learn_into(tmp_path)
    assert not caplog.records
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(
        InputError, match=r"cannot be written \(No space left on device\); .* with --cache, or free"
    ) as e:
        learn_into(tmp_path)
    assert "\n" not in str(e.value)
    assert not list(tmp_path.iterdir())


def test_a_file_in_the_place_of_the_cache_is_named(tmp_path: Path):
    (tmp_path / "cache").write_text("")
    with pytest.raises(InputError, match=r"cache/\.obj_000001.* cannot be written \(.*\); choose a folder .* --cache"):
        learn_into(tmp_path / "cache")
