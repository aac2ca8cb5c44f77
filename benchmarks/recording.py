"""What recording costs.

    python benchmarks/recording.py [--images N]

A stage with the recorder that records nothing against the same stage without any recorder, the time to write and
the size of one image's recording with everything that the two methods show, and the time to read an entity back.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

from pipeline.recording import NullRecorder, Recorder, RecordingReader, StageRecorder, recording_name
from pipeline.scene import Camera, ImageKey, PoseEstimate

HEIGHT, WIDTH, CELL_PX, FRAGMENTS, OBJECTS = 480, 640, 4, 64, 8
CAMERA = Camera(np.array([[572.4, 0, 325.3], [0, 573.6, 242.0], [0, 0, 1]]), WIDTH, HEIGHT)
RANDOM = np.random.default_rng(0)
REPEATS = 400
ENTITIES_READ = (
    "image",
    "image/rgb",
    "image/depth",
    "hashmatch/nms",
    "estimates/0",
    "epos/correspondences/1",
    "epos/fragments/1",
    "epos/hypotheses/1",
)


def bare_stage(object_probability: np.ndarray, fragments: np.ndarray) -> np.ndarray:
    """Correspondences of one object as EPOS forms them, from its probability maps."""
    rows, columns = np.nonzero(object_probability > 0.1)
    likely = fragments[rows, columns]
    cell, fragment = np.nonzero(likely > 0.5 * likely.max(axis=1, keepdims=True))
    confidence = object_probability[rows, columns][cell] * likely[cell, fragment]
    pixels = np.stack([columns, rows], axis=-1)[cell] * CELL_PX
    return np.concatenate([pixels[np.argsort(-confidence)], fragment[:, None]], axis=1)


def recorded_stage(object_probability: np.ndarray, fragments: np.ndarray, recorder: StageRecorder) -> np.ndarray:
    """The same, showing each of its steps."""
    rows, columns = np.nonzero(object_probability > 0.1)
    likely = fragments[rows, columns]
    recorder.heatmap("method/probability", object_probability, cell_px=CELL_PX)
    recorder.probabilities("epos/fragments/1", likely, cells=np.empty((0, 2)), grid=(120, 160), cell_px=CELL_PX)
    cell, fragment = np.nonzero(likely > 0.5 * likely.max(axis=1, keepdims=True))
    confidence = object_probability[rows, columns][cell] * likely[cell, fragment]
    recorder.scalars("method/confidence", confidence)
    pixels = np.stack([columns, rows], axis=-1)[cell] * CELL_PX
    recorder.correspondences("epos/correspondences/1", 1, pixels, pixels, confidence, fragment_ids=fragment)
    recorder.text("log", "formed")
    return np.concatenate([pixels[np.argsort(-confidence)], fragment[:, None]], axis=1)


def seconds(call: Callable[[], object]) -> float:
    """Wall time of one call."""
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


def measure_null_recorder() -> None:
    """Both ways in turn, so that what else the machine does hits both alike."""
    probability = RANDOM.random((120, 160), dtype=np.float32) * (RANDOM.random((120, 160)) > 0.97) * 4
    fragments = RANDOM.random((120, 160, FRAGMENTS), dtype=np.float32)
    recorder = NullRecorder()
    bare, recorded = [], []
    for _ in range(REPEATS):
        bare.append(seconds(lambda: bare_stage(probability, fragments)))
        recorded.append(seconds(lambda: recorded_stage(probability, fragments, recorder)))
    calls = 100_000
    image = np.zeros((4, 4, 3), np.uint8)
    call = seconds(lambda: [recorder.image("image/rgb", image) for _ in range(calls)]) / calls
    print(f"stage without recorder          {median(bare) * 1e3:8.3f} ms")
    print(
        f"stage with NullRecorder         {median(recorded) * 1e3:8.3f} ms, ratio {median(recorded) / median(bare):.4f}"
    )
    print(f"one call of NullRecorder        {call * 1e9:8.0f} ns")


def show_all(recorder: StageRecorder) -> None:
    """Record all that EPOS and HashMatch show of an image with eight objects."""
    noise = RANDOM.normal(120, 5, (HEIGHT, WIDTH, 3))
    recorder.image("image/rgb", np.clip(noise + np.arange(WIDTH)[:, None] / 8, 0, 255).astype(np.uint8))
    depth = 1 + np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)) / 2000
    recorder.depth("image/depth", depth.round(3).astype(np.float32))
    for stage in ("windows", "objectness", "hashing", "verification", "nms"):
        recorder.heatmap(f"hashmatch/{stage}", RANDOM.integers(0, 9, (96, 128)), cell_px=5, unit="candidates")
    cells = np.argwhere(np.ones((20, 30), bool)).astype(np.int16)
    for obj_id in range(1, OBJECTS + 1):
        likely = RANDOM.random((len(cells), FRAGMENTS)).astype(np.float16)
        points = RANDOM.random((len(cells), FRAGMENTS, 3)).astype(np.float16)
        fragments = f"epos/fragments/{obj_id}"
        recorder.probabilities(fragments, likely, cells=cells, grid=(120, 160), cell_px=CELL_PX, points_in_model=points)
        pixels, points, confidence = RANDOM.random((2000, 2)) * 480, RANDOM.random((2000, 3)) / 10, RANDOM.random(2000)
        recorder.correspondences(f"epos/correspondences/{obj_id}", obj_id, pixels, points, confidence)
        recorder.hypotheses(f"epos/hypotheses/{obj_id}", obj_id, RANDOM.random((400, 4, 4)), RANDOM.random(400))
    recorder.poses("estimates", [PoseEstimate(1, 0, obj_id, 0.5, np.eye(4)) for obj_id in range(1, OBJECTS + 1)])


def write_image(folder: Path, im_id: int) -> None:
    """Write the recording of an image."""
    key = ImageKey(1, im_id)
    with Recorder(folder / recording_name(key), "benchmark", key, CAMERA, model_ids=range(1, OBJECTS + 1)) as recorder:
        show_all(recorder)


def measure_files(folder: Path, images: int) -> None:
    """Write many recordings, read one of them."""
    first = seconds(lambda: write_image(folder, 0))
    memory = peak_memory_mb()
    times = [seconds(lambda: write_image(folder, im_id)) for im_id in range(1, images)]  # noqa: B023
    making = median(seconds(lambda: show_all(NullRecorder())) for _ in range(10))
    path = folder / recording_name(ImageKey(1, 0))
    print(f"write the first image           {first * 1e3:8.1f} ms (imports rerun)")
    print(
        f"write an image (median)         {(median(times) - making) * 1e3:8.1f} ms, {path.stat().st_size / 1e6:.2f} MB"
    )
    print(f"peak memory                     {memory:8.0f} MB after 1 image, {peak_memory_mb():.0f} MB after {images}")
    opened = median(seconds(lambda: RecordingReader.open(path)) for _ in range(20))
    print(f"open and verify                 {opened * 1e3:8.2f} ms")
    reader = RecordingReader.open(path)
    for entity in ENTITIES_READ:
        spent = median(seconds(lambda: reader.read(entity)) for _ in range(50))  # noqa: B023
        print(f"read {entity:27s}{spent * 1e3:8.2f} ms")


def peak_memory_mb() -> float:
    """Largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--images", type=int, default=30)
    measure_null_recorder()
    with tempfile.TemporaryDirectory() as folder:
        measure_files(Path(folder), arguments.parse_args().images)


if __name__ == "__main__":
    main()
