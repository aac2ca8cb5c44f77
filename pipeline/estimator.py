"""What a pose estimation method looks like to the rest of the program."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from pipeline.recording import StageRecorder
from pipeline.scene import Image, PoseEstimate, Target


@runtime_checkable
class Estimator(Protocol):
    """A method that estimates the poses of known objects in an image."""

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """Poses of the targets in one image.

        Args:
            image: The image; `depth` or `rgb` may be None, and a method that needs it raises an `InputError`.
            targets: Objects to look for, all of this image (thesis sec. bop_6d_object_localization).
            recorder: Where the stages show what they see; a `NullRecorder` when nobody wants to know.

        Returns:
            Estimates in metres, in any order, as many per object as the method found; an object that was not found
            has none.

        """
        ...
