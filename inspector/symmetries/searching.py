"""Searching all objects under review, one after the other, behind the page."""

import logging
import threading

from inspector.symmetries.review import Review
from pipeline.exceptions import InputError
from pipeline.symmetry_search.search import find_symmetries

log = logging.getLogger(__name__)


class BackgroundSearch:
    """One thread that searches object by object, the one that is looked at and those behind it first."""

    def __init__(self, review: Review, epsilon: float | None = None) -> None:
        """`epsilon` in metres: up to which distance to suggest candidates, None for the default."""
        self._review = review
        self._epsilon = epsilon
        self._stopped = threading.Event()

    def start(self) -> None:
        """Begin."""
        threading.Thread(target=self._run, name="symmetries", daemon=True).start()

    def stop(self) -> None:
        """Begin no further object."""
        self._stopped.set()

    def _run(self) -> None:
        while not self._stopped.is_set():
            index = self._review.waiting()
            if index is None:
                return
            self._search(index)

    def _search(self, index: int) -> None:
        review = self._review
        review.searched(index, progress="searching")
        try:
            model = review.read(index)
            search = find_symmetries(model, self._epsilon, progress=lambda share: review.searched(index, share=share))
        except InputError as error:
            review.searched(index, progress="failed", problem=str(error))
        except Exception as error:  # one model's fault must not end the search of the others
            log.exception("the search of %s failed", review.objects[index].file.path)
            review.searched(index, progress="failed", problem=f"the search failed: {type(error).__name__}: {error}")
        else:
            review.found(index, model, search)
