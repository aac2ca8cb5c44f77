"""What can be wrong with a request for cameras."""

from collections.abc import Mapping

from pipeline.exceptions import InputError


class CameraSettingsError(InputError):
    """A range or a rule that no camera can follow; the text names the field, its value and what would do."""


class NoViewError(InputError):
    """No camera was found within the number of tries; the text tells which constraints failed how often."""

    def __init__(self, place: str, counts: Mapping[str, int], fix: str) -> None:
        self.counts = dict(counts)
        """Tries that failed by the constraint that they failed first."""
        most_first = sorted(self.counts.items(), key=lambda item: -item[1])
        reasons = ", ".join(f"{count} {reason}" for reason, count in most_first) or "none made"
        super().__init__(f"{place}: no view in {sum(self.counts.values())} tries: {reasons}; {fix}")
