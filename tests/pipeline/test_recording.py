"""Recordings: everything that is logged comes back exactly, and damaged files are told apart in one line."""

import contextlib
import dataclasses
import hashlib
import resource
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.exceptions import InputError, MissingFileError, UnknownIdError
from pipeline.recording import (
    ENTITIES,
    ColorImage,
    Correspondences,
    DamagedRecordingError,
    DepthMap,
    EmptyRecordingError,
    Heatmap,
    Hypotheses,
    Mask,
    NotARecordingError,
    NullRecorder,
    Probabilities,
    Recorder,
    RecordingError,
    RecordingReader,
    Series,
    StageRecorder,
    Table,
    Text,
    TruncatedRecordingError,
    UnfinishedRecordingError,
    View,
    find_entity,
    recorded_image,
    recording_name,
    save_blueprint,
    save_models,
    saved_models,
)
from pipeline.recording.records import KINDS
from pipeline.scene import Camera, GroundTruth, ImageKey, Model, PoseEstimate

KEY = ImageKey(2, 3)
CAMERA = Camera(np.array([[572.4114, 0, 325.2611], [0, 573.57043, 242.04899], [0, 0, 1]]), 64, 48, np.eye(4) * 0.3)
RANDOM = np.random.default_rng(0)


def sheared_pose() -> np.ndarray:
    """A pose whose rotation is not orthonormal, as some datasets have."""
    pose = np.eye(4)
    pose[:3] = RANDOM.normal(size=(3, 4))
    return pose


RECORDS: list[Any] = [
    ColorImage(RANDOM.integers(0, 256, (48, 64, 3), dtype=np.uint8)),
    ColorImage(np.zeros((1, 1, 3), np.uint8)),
    ColorImage(RANDOM.integers(0, 256, (5, 7, 3), dtype=np.uint8)[::-1, ::2]),
    DepthMap(RANDOM.random((48, 64), dtype=np.float32)),
    DepthMap(RANDOM.random((48, 1))),
    DepthMap(np.zeros((0, 4), np.float32)),
    Heatmap(np.array([[np.nan, np.inf], [-0.0, 1e-300]]), unit="m"),
    Heatmap(np.full((3, 2), np.nan, np.float32)),
    Heatmap(RANDOM.integers(0, 9, (12, 16)), cell_px=4, unit="candidates"),
    Heatmap(RANDOM.random((12, 16)).astype(np.float16), cell_px=4),
    Mask(RANDOM.random((48, 64)) > 0.5),
    Mask(RANDOM.random((64, 48)).T > 0.5),
    Probabilities(
        RANDOM.random((6, 5)).astype(np.float16),
        RANDOM.integers(0, 12, (6, 2)).astype(np.int16),
        (12, 16),
        4,
        ("background", "obj 1", "obj 5", "ü", ""),
        RANDOM.normal(size=(6, 5, 3)).astype(np.float32),
    ),
    Probabilities(np.zeros((0, 64), np.float32), np.zeros((0, 2), np.int64), (12, 16)),
    Correspondences(5, RANDOM.random((95, 2)) * 640, RANDOM.normal(size=(95, 3)), RANDOM.random(95)),
    Correspondences(5, np.zeros((2, 2), np.float32), np.zeros((2, 3)), np.array([0.5, np.nan]), np.array([63, 0])),
    Correspondences(5, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0)),
    PoseEstimate(2, 3, 5, 0.1 + 0.2, sheared_pose(), 0.75),
    PoseEstimate(2, 3, 5, float("-inf"), sheared_pose()),
    GroundTruth(5, sheared_pose(), 3, 0.93, 1234, (1.0, 2.5, 30.0, 40.0)),
    GroundTruth(5, sheared_pose(), 0),
    Hypotheses(5, RANDOM.normal(size=(4, 4, 4)), RANDOM.random(4)),
    Hypotheses(
        5,
        RANDOM.normal(size=(2, 4, 4)),
        np.array([0.1, 0.4], np.float32),
        np.array([0, 7]),
        np.array([0, 1], np.int32),
        np.array([[3, 1, 4], [-1, -1, -1]]),
        ("sample", "local optimization"),
    ),
    Series(np.array([1.0, 0.5, np.nan]), np.array([0, 10, 20])),
    Series(np.zeros(0), np.zeros(0, np.int64)),
    Text("stopped after 400 iterations:\n'ε' < 0.5", "WARN"),
    Table({}),
    Table({"template": np.arange(3), "window px": RANDOM.random((3, 4)), "name": np.array(["a", "", "ßc"])}),
    Table({"pixels": RANDOM.random((2, 2)), "points_in_camera": RANDOM.random((2, 3)), "T1": np.array([True, False])}),
    Table({"big": np.array([2**64 - 1], np.uint64), "small": np.array([-128], np.int8), "none": np.zeros((1, 0))}),
]


def assert_same(found: Any, expected: Any) -> None:
    assert type(found) is type(expected)
    if isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        assert found.shape == expected.shape
        np.testing.assert_array_equal(found, expected)
    elif isinstance(expected, Mapping):
        assert list(found) == list(expected)
        for name in expected:
            assert_same(found[name], expected[name])
    elif dataclasses.is_dataclass(expected):
        for field in dataclasses.fields(expected):
            assert_same(getattr(found, field.name), getattr(expected, field.name))
    else:
        assert found == expected


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where recordings of these tests go."""
    return tmp_path / "recordings" / recording_name(KEY)


@pytest.fixture
def written(path: Path) -> Path:
    """A small recording."""
    with Recorder(path, "run", KEY, CAMERA) as recorder:
        recorder.image("image/rgb", RECORDS[0].rgb)
        recorder.text("log", "first")
        recorder.text("log", "second", "WARN")
    return path


def test_every_kind_reads_back_exactly(path: Path) -> None:
    with Recorder(path, "run", KEY, CAMERA) as recorder:
        for number, record in enumerate(RECORDS):
            recorder.log(f"method/{number}", record)
    reader = RecordingReader.open(path)
    for number, record in enumerate(RECORDS):
        assert_same(reader.read(f"method/{number}"), record)
    assert {type(record) for record in RECORDS} == set(KINDS) - {View}
    assert reader.key == KEY
    assert_same(reader.view.camera, CAMERA)


def test_each_method_logs_its_kind(path: Path) -> None:
    image, depth, mask = RECORDS[0].rgb, RECORDS[3].depth, RECORDS[10].mask
    estimates = [PoseEstimate(2, 3, obj_id, 0.5, sheared_pose()) for obj_id in (5, 5, 6)]
    truths = [GroundTruth(5, sheared_pose(), 4), GroundTruth(6, sheared_pose(), 1)]
    with Recorder(path, "run", KEY, CAMERA, model_ids=(5, 6, 8)) as recorder:
        recorder.image("image/rgb", image)
        recorder.depth("image/depth", depth)
        recorder.heatmap("hashmatch/nms", depth, unit="candidates")
        recorder.mask("vsd/0-1/visible_gt", mask)
        recorder.probabilities("epos/fragments/5", depth[:6, :5], cells=np.zeros((6, 2), int), grid=(12, 16))
        recorder.correspondences("epos/correspondences/5", 5, np.zeros((1, 2)), np.zeros((1, 3)), np.ones(1))
        recorder.hypotheses("epos/hypotheses/5", 5, np.eye(4)[None], np.ones(1), labels=["final"])
        recorder.scalars("epos/training/loss", np.array([3.0, 2.0]))
        recorder.table("hashmatch/candidates/nms", {"votes": np.array([3, 4])})
        recorder.text("log", "done")
        recorder.poses("estimates", estimates)
        recorder.poses("ground_truth", truths)
    reader = RecordingReader.open(path)
    assert all(find_entity(found).kind == kind for found, kind in reader.kinds().items())  # type: ignore[union-attr]
    assert_same(reader.read("image/rgb", ColorImage).rgb, image)
    assert_same(reader.read("hashmatch/nms", Heatmap), Heatmap(depth, 1, "candidates"))
    assert_same(reader.read("epos/training/loss", Series).steps, np.array([0, 1]))
    assert reader.read("epos/hypotheses/5", Hypotheses).labels == ("final",)
    for found, expected in zip(reader.estimates(), estimates, strict=True):
        assert_same(found, expected)
    for found, expected in zip(reader.ground_truth(), reversed(truths), strict=True):
        assert_same(found, expected)


def test_several_records_at_one_path_keep_their_order(path: Path) -> None:
    with Recorder(path, "run", KEY) as recorder:
        for number in range(300):
            values = np.full((2, 2), number, np.float32 if number % 2 else np.int64)
            recorder.heatmap("method/step", values)
    reader = RecordingReader.open(path)
    assert [int(record.values[0, 0]) for record in reader.read_all("method/step")] == list(range(300))
    assert reader.read("method/step").values.dtype == np.float32
    assert reader.view.camera is None


def test_paths_are_sorted_by_number(path: Path) -> None:
    with Recorder(path, "run", KEY) as recorder:
        recorder.poses("estimates", [PoseEstimate(2, 3, 1, float(number), np.eye(4)) for number in range(12)])
    reader = RecordingReader.open(path)
    assert reader.paths("estimates/*") == [f"estimates/{number}" for number in range(12)]
    assert [estimate.score for estimate in reader.estimates()] == list(range(12))


def test_arrays_that_are_read_cannot_be_changed(written: Path) -> None:
    rgb = RecordingReader.open(written).read("image/rgb", ColorImage).rgb
    with pytest.raises(ValueError, match="read-only"):
        rgb[0, 0] = 0


def test_dense_probabilities() -> None:
    sparse = Probabilities(np.array([[0.25, 0.75]]), np.array([[3, 1]]), (2, 5))
    dense = sparse.dense()
    assert dense.shape == (2, 5, 2)
    assert dense[1, 3].tolist() == [0.25, 0.75]
    assert dense.sum() == 1.0


def shapes_are_checked_before() -> bool:
    """Whether the tests run with jaxtyping's import hook, which reports wrong shapes in its own words."""
    try:
        Mask(np.zeros(2, bool))
    except ValueError:
        return False
    except Exception:
        return True
    raise AssertionError("a mask of one dimension was taken")


@pytest.mark.skipif(shapes_are_checked_before(), reason="jaxtyping's import hook is on and looks first")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Mask(np.zeros((2, 2))), "Mask.mask is float64; expected bool"),
        (lambda: ColorImage(np.zeros((2, 2, 3))), "ColorImage.rgb is float64; expected uint8"),
        (lambda: DepthMap(np.zeros(3)), r"DepthMap.depth has shape \(3,\); expected \(h w\)"),
        (
            lambda: Correspondences(1, np.zeros((4, 2)), np.zeros((5, 3)), np.zeros(4)),
            r"Correspondences.points_in_model has shape \(5, 3\); expected \(n 3\), n = 4",
        ),
        (
            lambda: Hypotheses(1, np.zeros((4, 4)), np.zeros(4)),
            r"Hypotheses.camera_from_model has shape \(4, 4\); expected \(n 4 4\)",
        ),
        (
            lambda: Probabilities(np.zeros((1, 3)), np.zeros((1, 2), int), (1, 1), labels=("a",)),
            "labels has 1 names; expected 3",
        ),
        (lambda: Table({"a": np.zeros(2), "b": np.zeros(3)}), "Table columns differ in length: {'a': 2, 'b': 3}"),
    ],
)
def test_wrong_shapes_are_named(make: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_paths_are_checked_against_the_table(path: Path) -> None:
    with Recorder(path, "run", KEY) as recorder:
        with pytest.raises(
            UnknownIdError, match="entity path epos/objects is not in the table of entities; available:"
        ):
            recorder.mask("epos/objects", np.zeros((2, 2), bool))
        with pytest.raises(ValueError, match="entity path image/rgb is for image, not for mask"):
            recorder.mask("image/rgb", np.zeros((2, 2), bool))
        with pytest.raises(ValueError, match="letters, digits"):
            recorder.mask("method/my mask", np.zeros((2, 2), bool))
        with pytest.raises(ValueError, match=r"cannot record columns.a of dtype complex128"):
            recorder.table("method/x", {"a": np.zeros(2, complex)})
        recorder.mask("method/somebody/mask", np.zeros((2, 2), bool))
    assert RecordingReader.open(path).kinds() == {"image": "view", "method/somebody/mask": "mask"}


@pytest.mark.skipif(shapes_are_checked_before(), reason="jaxtyping's import hook is on and looks first")
def test_only_records_are_recorded(path: Path) -> None:
    with pytest.raises(ValueError, match="cannot record a ndarray; known: View, ColorImage"):
        Recorder(path, "run", KEY).log("method/x", np.zeros(3))  # pyright: ignore[reportArgumentType]


def test_the_table_has_known_kinds_and_no_path_twice() -> None:
    assert {entity.kind for entity in ENTITIES} <= set(KINDS.values())
    examples = [entity.path.replace("{", "").replace("}", "") for entity in ENTITIES]
    assert [find_entity(example) for example in examples] == list(ENTITIES)


def test_nothing_is_left_when_the_stage_fails(path: Path) -> None:
    def stage(recorder: Recorder) -> None:
        with recorder:
            recorder.text("log", "begun")
            raise RuntimeError("stage")

    with pytest.raises(RuntimeError, match="stage"):
        stage(Recorder(path, "run", KEY, CAMERA))
    assert not path.parent.exists() or list(path.parent.iterdir()) == []


def test_writing_again_replaces_file_and_checksum(written: Path) -> None:
    before = written.read_bytes()
    with Recorder(written, "run", KEY) as recorder:
        recorder.text("log", "again")
    assert written.read_bytes() != before
    assert RecordingReader.open(written).read_all("log") == [Text("again")]
    assert sorted(item.name for item in written.parent.iterdir()) == [written.name, written.name + ".sha256"]


def test_a_failing_disk_leaves_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(RecordingError, match="No space left on device; free space"):
        Recorder(path, "run", KEY).finish()
    assert list(path.parent.iterdir()) == []


def test_a_visible_recording_always_has_its_checksum(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever step of writing the process dies at."""
    for number in range(4):
        with Recorder(path, "run", KEY) as recorder:
            recorder.text("log", str(number))
        steps = 0

        def dying(self: Path, target: Path, limit: int = number) -> None:
            nonlocal steps
            steps += 1
            if steps > limit:
                raise KeyboardInterrupt
            self.rename(target)

        monkeypatch.setattr(Path, "replace", dying)
        with contextlib.suppress(KeyboardInterrupt):
            Recorder(path, "run", KEY).finish()
        monkeypatch.undo()
        if path.exists():
            assert RecordingReader.open(path).verified


def test_checksum_is_what_sha256sum_reads(written: Path) -> None:
    line = written.with_name(written.name + ".sha256").read_text()
    assert line == f"{hashlib.sha256(written.read_bytes()).hexdigest()}  {written.name}\n"


def damage(kind: str, content: bytes) -> bytes:
    if kind == "flipped":
        middle = len(content) // 2
        return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]
    return {"empty": b"", "truncated": content[:-100], "magic": b"\x89PNG" + content[4:]}[kind]


@pytest.mark.parametrize(
    ("kind", "error", "message"),
    [
        ("empty", EmptyRecordingError, r"the recording is empty \(0 bytes\)"),
        ("truncated", TruncatedRecordingError, r"cut off after \d+ bytes"),
        ("magic", NotARecordingError, r"starts with b'.*PNG', not b'RRF2'"),
        ("flipped", DamagedRecordingError, "SHA-256 is .* not .* as written"),
    ],
)
def test_damage_is_told_in_one_line(written: Path, kind: str, error: type[InputError], message: str) -> None:
    written.write_bytes(damage(kind, written.read_bytes()))
    with pytest.raises(error, match=message) as caught:
        RecordingReader.open(written)
    assert str(caught.value).startswith(str(written))
    assert "\n" not in str(caught.value)


def test_absent_recording(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="no such recording"):
        RecordingReader.open(tmp_path / "000001_000001.rrd")


def test_no_checksum_is_a_warning(written: Path, caplog: pytest.LogCaptureFixture) -> None:
    written.with_name(written.name + ".sha256").unlink()
    reader = RecordingReader.open(written)
    assert not reader.verified
    assert "no checksum beside it" in caplog.text
    assert len(reader.read_all("log")) == 2


def test_no_footer_and_no_checksum(written: Path) -> None:
    written.with_name(written.name + ".sha256").unlink()
    written.write_bytes(written.read_bytes()[:-64])
    with pytest.raises(UnfinishedRecordingError, match="no footer and no checksum: its writer was stopped"):
        RecordingReader.open(written)


def test_damage_without_checksum_is_no_traceback(written: Path) -> None:
    written.with_name(written.name + ".sha256").unlink()
    content = bytearray(written.read_bytes())
    content[-200:-40] = bytes(160)  # the index of the file
    written.write_bytes(content)
    with pytest.raises(DamagedRecordingError, match="cannot be decoded") as caught:
        RecordingReader.open(written).read("image/rgb")
    assert "\n" not in str(caught.value)


def test_absent_entity_and_wrong_kind(written: Path) -> None:
    reader = RecordingReader.open(written)
    with pytest.raises(UnknownIdError, match=r"entity image/depth is not in .*; available: image, image/rgb, log"):
        reader.read("image/depth")
    with pytest.raises(DamagedRecordingError, match="log is of kind text, not mask"):
        reader.read("log", Mask)


def test_one_reader_serves_several_threads(written: Path) -> None:
    reader = RecordingReader.open(written)
    expected = RECORDS[0].rgb

    def read(number: int) -> bool:
        if number % 2:
            return bool((reader.read("image/rgb", ColorImage).rgb == expected).all())
        return [text.text for text in reader.read_all("log")] == ["first", "second"]

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, range(64)))


def test_several_recorders_at_once(tmp_path: Path) -> None:
    def write(number: int) -> Path:
        path = tmp_path / recording_name(ImageKey(1, number))
        with Recorder(path, "run", ImageKey(1, number)) as recorder:
            recorder.heatmap("hashmatch/nms", np.full((20, 20), number))
        return path

    with ThreadPoolExecutor(4) as pool:
        for number, path in enumerate(pool.map(write, range(16))):
            reader = RecordingReader.open(path)
            assert reader.key.im_id == number
            assert (reader.read("hashmatch/nms", Heatmap).values == number).all()


def test_a_finished_recorder_is_forgotten(tmp_path: Path) -> None:
    """Rerun keeps the data and a thread of every recording until it is told to clean up."""

    def write(number: int) -> None:
        with Recorder(tmp_path / f"{number}.rrd", "run", ImageKey(1, number)) as recorder:
            recorder.image("image/rgb", np.random.default_rng(number).integers(0, 256, (500, 500, 3), dtype=np.uint8))
        (tmp_path / f"{number}.rrd").unlink()

    def resident_mb() -> float:
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6

    for number in range(10):
        write(number)
    memory, threads = resident_mb(), len(list(Path("/proc/self/task").iterdir()))
    for number in range(60):
        write(number)
    assert resident_mb() - memory < 20  # 45 MB were written
    assert len(list(Path("/proc/self/task").iterdir())) <= threads + 2


def test_null_recorder_has_the_same_methods_and_does_nothing() -> None:
    recorder: StageRecorder = NullRecorder()
    with recorder as same:
        assert same is recorder
        recorder.image("no/such/path", "no image")  # pyright: ignore[reportArgumentType]
    assert not recorder.enabled
    methods = [name for name, value in vars(StageRecorder).items() if callable(value) and not name.startswith("_")]
    assert all(name in vars(NullRecorder) for name in methods)


def test_file_names() -> None:
    assert recording_name(ImageKey(2, 1234567)) == "000002_1234567.rrd"
    assert recorded_image("000002_1234567.rrd") == ImageKey(2, 1234567)
    for name in ("models.rrd", "layout.rbl", ".000002_000003.rrd.12", "000002_000003.rrd.sha256"):
        assert recorded_image(name) is None


def test_models_and_layout_for_the_viewer(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float64) / 10
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    assert saved_models(tmp_path) == frozenset()
    save_models(tmp_path, "run", [Model(obj_id, corners, faces, 0.14) for obj_id in (1, 12)])
    assert saved_models(tmp_path) == {1, 12}
    save_blueprint(tmp_path / "layout.rbl")
    assert (tmp_path / "layout.rbl").read_bytes().startswith(b"RRF2")


@pytest.mark.parametrize("module", ["pipeline.recording", "pipeline.run", "pipeline.estimator"])
def test_rerun_is_imported_only_when_needed(module: str) -> None:
    code = f"import sys, {module}; print(sorted({{'rerun', 'pyarrow', 'torch'}} & set(sys.modules)))"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert output.stdout.strip() == "[]"
