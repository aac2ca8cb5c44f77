"""Learning objects: their templates come from the cache, or are made and put there."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

from pipeline.hashmatch.template_cache import TemplateCache
from pipeline.hashmatch.template_source import TemplateSource
from pipeline.hashmatch.templates import Templates, joined
from pipeline.parallel import HERE, Workers

Progress = Callable[[str, int, int], None]
"""Called with what is done, for people, with the number of templates that are learned and how many there will be."""


def learned(
    source: TemplateSource,
    obj_ids: Sequence[int],
    cache: TemplateCache,
    workers: Workers = HERE,
    progress: Progress = lambda *_: None,
) -> list[Templates]:
    """Templates of objects in their order, from the cache as far as they are there.

    Each part is put into the cache when it comes, so learning that is ended goes on where it was.

    Args:
        source: Makes what is missing.
        obj_ids: Of the objects.
        cache: Where templates are kept.
        workers: Who makes them.
        progress: Called as parts are made, not where there is nothing to make; what it raises ends learning.

    Raises:
        InputError: an object cannot be learned, or the cache cannot be written.

    """
    names = {obj_id: cache.name(source, obj_id) for obj_id in obj_ids}
    found = {obj_id: cache.find(name) for obj_id, name in names.items()}
    missing = {obj_id: names[obj_id] for obj_id, templates in found.items() if templates is None}
    if missing:
        found |= _Learning(source, cache, missing, progress).by(workers)
    return [templates for templates in found.values() if templates is not None]


@dataclass(frozen=True)
class _Learning:
    """Objects that are learned together."""

    source: TemplateSource
    cache: TemplateCache
    names: dict[int, str]
    """In the cache, by object id."""
    progress: Progress

    def by(self, workers: Workers) -> dict[int, Templates]:
        """Let workers make the parts that are not there from before, and put them together."""
        sizes = {obj_id: self.source.parts(obj_id) for obj_id in self.names}
        parts = {
            obj_id: [self.cache.find(self.names[obj_id], i) for i in range(len(sizes[obj_id]))] for obj_id in sizes
        }
        items = [(obj_id, i) for obj_id, found in parts.items() for i, part in enumerate(found) if part is None]
        total = sum(map(sum, sizes.values()))
        done = total - sum(sizes[obj_id][i] for obj_id, i in items)
        whole = {obj_id: self._whole(obj_id, found) for obj_id, found in parts.items() if None not in found}
        self.progress(self._label(items), done, total)
        answers = workers.map_unordered(learn_part, items, self.source, total=len(items), describe=_described)
        with closing(answers):
            for count, (position, made) in enumerate(answers, start=1):
                obj_id, i = items[position]
                self.cache.put(made, self.names[obj_id], i)
                parts[obj_id][i] = made
                if None not in parts[obj_id]:
                    whole[obj_id] = self._whole(obj_id, parts.pop(obj_id))
                done += sizes[obj_id][i]
                self.progress(self._label(items[count:]), done, total)
        return whole

    def _whole(self, obj_id: int, parts: Sequence[Templates | None]) -> Templates:
        templates = joined([part for part in parts if part is not None])
        self.cache.put(templates, self.names[obj_id])
        self.cache.drop_parts(self.names[obj_id])
        return templates

    def _label(self, items: Sequence[tuple[int, int]]) -> str:
        """What is learned now, for people; parts are given out in order."""
        count = len(self.names)
        if not items:
            return f"learned {count} objects" if count > 1 else "learned one object"
        obj_id = items[0][0]
        place = f" ({list(self.names).index(obj_id) + 1} of {count})" if count > 1 else ""
        return f"learning object {obj_id}{place}"


def learn_part(source: TemplateSource, item: tuple[int, int]) -> Templates:
    """Make one part of an object's templates, in whatever process."""
    return source.learn(*item)


def _described(item: tuple[int, int]) -> str:
    return f"templates of object {item[0]}"
