"""An estimator that is made where it works: templates and networks are large to send, and not all can be sent."""

import threading
from collections.abc import Callable, Sequence
from typing import Any

from pipeline.estimator import Estimator
from pipeline.recording import StageRecorder
from pipeline.scene import Image, PoseEstimate, Target


class LazyEstimator:
    """An estimator made at its first image: once in this process, or in each worker once (and in each of its threads).

    estimator = LazyEstimator(partial(make_my_method, config, dataset))
    """

    def __init__(self, make: Callable[[], Estimator]) -> None:
        """`make` is what is sent to workers: a function that they can import, or a `functools.partial` of one."""
        self._make = make
        self._of_thread = threading.local()

    def made(self) -> Estimator:
        """The estimator itself. Raises whatever making it does."""
        if not hasattr(self._of_thread, "estimator"):
            self._of_thread.estimator = self._make()
        return self._of_thread.estimator

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """See `Estimator`."""
        return self.made().estimate(image, targets, recorder)

    def __reduce__(self) -> tuple[Any, ...]:
        return LazyEstimator, (self._make,)
