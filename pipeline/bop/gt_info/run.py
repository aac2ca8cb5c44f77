"""Making a dataset's ground-truth information; an interrupted run continues where it stopped, whatever ended it.

While a run lasts there is a journal in the dataset's folder, with what is to be made and which scenes are finished, and
one in the folder of the scene at work. When all is done, with the lists of targets, the first journal goes last.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.bop.dataset import open_dataset
from pipeline.bop.gt_info.files import SceneMaker, journal_path, remove_leftovers
from pipeline.bop.gt_info.image import ImageTask, Recipe, make_image
from pipeline.bop.gt_info.plan import Plan, check_nothing_is_overwritten
from pipeline.bop.gt_info.scenes import ScenePart
from pipeline.bop.gt_info.targets import detection_images, list_path, localization_targets, write_detection_images
from pipeline.bop.journal import Journal
from pipeline.bop.writer import write_targets
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers

Progress = Callable[[int], None]
"""Told the number of finished images, those of the run that is continued with them."""


def make_gt_info(
    plan: Plan, *, force: bool = False, workers: Workers | None = None, progress: Progress | None = None
) -> None:
    """Make all that is planned, or what an interrupted run of the same plan has left to do; `force` starts anew.

    Memory is that of one image per worker. Raises InputError, before any work is done, if a file exists and `force` is
    not given, if an interrupted run had other settings or another run is at work; later if a file cannot be read or
    written, and then the same call continues.
    """
    journal = _open_run(plan, force)
    try:
        if plan.images:
            _Run(plan, journal, progress or (lambda done: None)).make_scenes(workers or HERE)
        _write_lists(plan)
        journal.remove()
    finally:
        journal.close()


def is_interrupted(plan: Plan) -> bool:
    """Whether there is a run to be continued."""
    return _run_path(plan).is_file()


def _run_path(plan: Plan) -> Path:
    return plan.root / f".gt_info_{plan.split}.journal"


def _open_run(plan: Plan, force: bool) -> Journal:
    if not force and not is_interrupted(plan):
        check_nothing_is_overwritten(plan)
    journal = Journal(_run_path(plan))
    try:
        if journal.head is None and not force:  # new, or of a run that was killed before it had begun
            check_nothing_is_overwritten(plan)
        if journal.head is None or force:
            for path in (plan.root / plan.split).glob("*/.gt_info*.journal"):
                path.unlink()
            journal.start({"settings": plan.settings, "force": force})
        elif journal.head["settings"] != plan.settings:
            raise InputError(
                f"{journal.path}: an interrupted run was to make something else, or for other scenes; give its command "
                "again to complete it, or start anew with --force"
            )
    except BaseException:
        if journal.head is None:
            journal.remove()
        journal.close()
        raise
    return journal


class _Run:
    """A run at work."""

    def __init__(self, plan: Plan, journal: Journal, progress: Progress) -> None:
        self._plan, self._journal, self._progress = plan, journal, progress
        self._finished = {tuple(journal.read(line)) for line in journal.entries}
        self._makers: dict[int, SceneMaker] = {}
        """Scenes at work by their number; where several workers meet at the end of a scene, there are two or three."""
        self._images = 0
        """Number of images in finished scenes."""

    def make_scenes(self, workers: Workers) -> None:
        """Make all scenes that are not finished."""
        plan = self._plan
        left = sum(len(part.instances) for part in plan.parts if self._mark(part) not in self._finished)
        recipe = Recipe(plan.kinds, plan.delta, plan.models)
        try:
            for _, made in workers.map_unordered(make_image, self._tasks(), recipe, total=left):
                self._makers[made.scene].take(made)
                self._finish_if_complete(made.scene)
        finally:
            for maker in self._makers.values():
                maker.close()

    def _tasks(self) -> Iterator[ImageTask]:
        known = {mark[:2] for mark in self._finished}
        for number, part in enumerate(self._plan.parts):
            mark = self._mark(part)
            if mark in self._finished:
                journal_path(part).unlink(missing_ok=True)
                self._images += len(part.instances)
            else:
                replacing = self._journal.head["force"] or mark[:2] in known
                maker = self._makers[number] = SceneMaker(self._plan, number, replacing)
                yield from maker.tasks()
                self._finish_if_complete(number)  # without a task
        self._tell()

    def _finish_if_complete(self, number: int) -> None:
        maker, part = self._makers.get(number), self._plan.parts[number]
        if maker and maker.is_complete:
            maker.write_json()
            self._journal.append(self._mark(part))
            maker.close()
            journal_path(part).unlink()
            del self._makers[number]
            self._images += len(part.instances)
        self._tell()

    def _tell(self) -> None:
        self._progress(self._images + sum(maker.finished for maker in self._makers.values()))

    @staticmethod
    def _mark(part: ScenePart) -> tuple[int, str, str]:
        """The line of the journal that says that a scene is finished."""
        return part.scene_id, part.sensor, part.fingerprint


def _write_lists(plan: Plan) -> None:
    """Write the lists of targets, from the files that are there now."""
    remove_leftovers(plan.root)
    dataset = open_dataset(plan.root, plan.split, plan.sensor)
    paths = {kind: list_path(plan.root, plan.split, kind) for kind in ("bop19", "bop24")}
    if "bop19" in plan.kinds:
        write_targets(paths["bop19"], localization_targets(dataset))
    if "bop24" in plan.kinds:
        official = "bop19" not in plan.kinds and paths["bop19"].is_file()
        write_detection_images(paths["bop24"], detection_images(dataset, paths["bop19"] if official else None))
