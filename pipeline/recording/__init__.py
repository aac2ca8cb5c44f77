"""Recording what the stages of a method saw, and reading it back; the only package that imports rerun.

    with run.recorder(key, camera) as recorder:
        recorder.heatmap("hashmatch/objectness", counts, unit="edgels")

    reader = RecordingReader.open(run.recording_path(key))
    counts = reader.read("hashmatch/objectness", Heatmap).values

rerun itself is imported when the first recorder or reader is made.
"""

from pipeline.recording.blueprint import BLUEPRINT_FILE, save_blueprint
from pipeline.recording.entities import ENTITIES, Entity, find_entity
from pipeline.recording.files import (
    DamagedRecordingError,
    EmptyRecordingError,
    NotARecordingError,
    RecordingError,
    TruncatedRecordingError,
    UnfinishedRecordingError,
    recorded_image,
    recording_name,
)
from pipeline.recording.reader import RecordingReader
from pipeline.recording.recorder import MODELS_FILE, NullRecorder, Recorder, StageRecorder, save_models, saved_models
from pipeline.recording.records import (
    ColorImage,
    Correspondences,
    DepthMap,
    Heatmap,
    Hypotheses,
    Mask,
    Probabilities,
    Record,
    Series,
    Table,
    Text,
    View,
)

__all__ = [
    "BLUEPRINT_FILE",
    "ENTITIES",
    "MODELS_FILE",
    "ColorImage",
    "Correspondences",
    "DamagedRecordingError",
    "DepthMap",
    "EmptyRecordingError",
    "Entity",
    "Heatmap",
    "Hypotheses",
    "Mask",
    "NotARecordingError",
    "NullRecorder",
    "Probabilities",
    "Record",
    "Recorder",
    "RecordingError",
    "RecordingReader",
    "Series",
    "StageRecorder",
    "Table",
    "Text",
    "TruncatedRecordingError",
    "UnfinishedRecordingError",
    "View",
    "find_entity",
    "recorded_image",
    "recording_name",
    "save_blueprint",
    "save_models",
    "saved_models",
]
