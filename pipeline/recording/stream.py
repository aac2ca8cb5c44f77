"""A rerun recording in memory: records go in, the bytes of a finished .rrd file come out."""

from collections.abc import Collection, Mapping, Sequence

import rerun as rr
import rerun_bindings

from pipeline.recording.codec import PREFIX, encode
from pipeline.recording.display import (
    DEFAULTS,
    HIDDEN,
    MODEL_TINTS,
    Columns,
    display,
    model_instances,
    model_mesh,
)
from pipeline.recording.files import APPLICATION_ID
from pipeline.recording.records import KINDS, Record, Series
from pipeline.scene import GroundTruth, Model, PoseEstimate


class ChunkStream:
    """One recording being made.

    All recordings of a run share an id, so that the viewer shows them as one. The bytes are kept here and written
    by the caller: rerun's own file sink reports a full disk to its log only.
    """

    def __init__(self, recording_id: str) -> None:
        self._recording = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id)
        self._bytes = self._recording.binary_stream()
        self._recording.set_log_tick_enabled(False)
        self._recording.set_log_time_enabled(False)
        self._recording.log("/", *DEFAULTS, static=True, strict=True)

    def set_name(self, name: str) -> None:
        """Name the recording in the viewer."""
        self._recording.send_recording_name(name)

    def set_time(self, timeline: str, value: int) -> None:
        """Put what follows at a point of a timeline."""
        self._timeline, self._time = timeline, value
        self._recording.set_time(timeline, sequence=value)

    def log(self, path: str, record: Record) -> None:
        """Add a record and its drawing."""
        drawing = display(record)
        columns = Columns(PREFIX + KINDS[type(record)], encode(record, drawing.drawn))
        self._recording.log(path, columns, *drawing.archetypes, strict=True)
        for name, archetypes in drawing.children.items():
            self._recording.log(f"{path}/{name}", *archetypes, strict=True)
        if isinstance(record, Series):
            self._log_steps(path, record)

    def draw_models(
        self, path: str, poses: Mapping[int, Sequence[PoseEstimate | GroundTruth]], all_objects: Collection[int]
    ) -> None:
        """Draw the mesh of each object, logged by `log_mesh`, at poses below a path, and no mesh of other objects.

        The meshes of absent objects have to be hidden: the viewer would draw them where an earlier image has them.
        """
        for obj_id in {*all_objects, *poses} if path in MODEL_TINTS else ():
            instances = model_instances(poses[obj_id]) if poses.get(obj_id) else HIDDEN
            self._recording.log(f"models/{path}/{obj_id}", instances, strict=True)

    def log_mesh(self, model: Model) -> None:
        """Add a mesh for all images, once in each colour."""
        for path, tint in MODEL_TINTS.items():
            self._recording.log(f"models/{path}/{model.obj_id}", model_mesh(model, tint), static=True, strict=True)

    def close(self) -> bytes:
        """End the recording and return it whole."""
        content = self._bytes.read()
        self._recording.disconnect()
        del self._recording, self._bytes
        rerun_bindings.flush_and_cleanup_orphaned_recordings()  # else rerun keeps the bytes and a thread of each
        return content or b""

    def _log_steps(self, path: str, series: Series) -> None:
        """Let the viewer plot a series over its own steps."""
        times = [
            rr.TimeColumn("step", sequence=series.steps),
            rr.TimeColumn(self._timeline, sequence=[self._time] * len(series.steps)),
        ]
        self._recording.send_columns(path, times, rr.Scalars.columns(scalars=series.values), strict=True)
