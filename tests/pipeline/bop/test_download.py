import errno
import hashlib
import http.server
import io
import json
import shutil
import subprocess
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from rich.console import Console

from inspector.commands.download import DownloadConfig, run
from pipeline.bop.archives import unpack
from pipeline.bop.download import default_parts, download_dataset
from pipeline.bop.hub import Hub, RemoteFile, Step, list_archives
from pipeline.exceptions import FormatError, InputError, UnknownIdError

BASE = {"lmo/camera.json": b"{}", "lmo/test_targets_bop19.json": b"[]"}
MODELS = {"models/obj_000001.ply": b"ply" * 1000}
TEST = {f"test/000002/rgb/{i:06d}.png": bytes([i % 256]) * 30_000 for i in range(40)}


@dataclass
class FakeHub:
    """A local stand-in for the hub, which redirects to a second address for the bytes, as the real one does."""

    files: dict[str, bytes]
    ranges: bool = True
    cut_after: list[int] = field(default_factory=list)
    """Bytes after which to cut each of the next answers."""
    busy: int = 0
    """How many of the next requests for bytes to answer with 503."""
    wrong_digest: str = ""
    """File whose listed checksum is not that of its bytes."""
    requests: list[tuple[str, str | None]] = field(default_factory=list)
    """File and Range header of every request for bytes."""
    url: str = ""

    def hub(self) -> Hub:
        return Hub(endpoint=self.url, attempts=3, first_wait_s=0.0, timeout_s=5.0)

    def listing(self) -> list[dict]:
        entries = [{"type": "directory", "path": "folder", "oid": "0"}]
        for name, data in self.files.items():
            digest = hashlib.sha256(b"other" if name == self.wrong_digest else data).hexdigest()
            entries.append(
                {"type": "file", "path": name, "size": 130, "oid": "0", "lfs": {"oid": digest, "size": len(data)}}
            )
        small = b"hello"
        oid = hashlib.sha1(b"blob 5\0" + small).hexdigest()
        return [*entries, {"type": "file", "path": "README.md", "size": 5, "oid": oid}]


class Handler(http.server.BaseHTTPRequestHandler):
    fake: FakeHub

    def do_GET(self) -> None:
        path, _, query = self.path.partition("?")
        repository = "bop-benchmark/lmo"
        if path == f"/api/datasets/{repository}/tree/main":
            self.send_listing(second="page=2" in query)
        elif path.startswith(f"/datasets/{repository}/resolve/main/"):
            self.answer(302, b"", {"Location": f"/bytes/{path.rpartition('/')[2]}"})
        elif path.startswith("/bytes/"):
            self.send_bytes(path.rpartition("/")[2])
        else:
            self.answer(401, b'{"error": "Invalid username or password."}')  # what the hub says of unknown names

    def send_listing(self, second: bool) -> None:
        entries = self.fake.listing()
        half = len(entries) // 2
        link = {} if second else {"Link": f'<{self.fake.url}{self.path}&page=2>; rel="next"'}
        self.answer(200, json.dumps(entries[half:] if second else entries[:half]).encode(), link)

    def send_bytes(self, name: str) -> None:
        wanted = self.headers.get("Range")
        self.fake.requests.append((name, wanted))
        data = self.fake.files[name]
        if self.fake.busy:
            self.fake.busy -= 1
            self.answer(503, b"")
        elif wanted and self.fake.ranges:
            begin = int(wanted.removeprefix("bytes=").removesuffix("-"))
            self.answer(206, data[begin:], {"Content-Range": f"bytes {begin}-{len(data) - 1}/{len(data)}"})
        else:
            self.answer(200, data)

    def answer(self, status: int, body: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        for key, value in {"Content-Length": str(len(body)), **(headers or {})}.items():
            self.send_header(key, value)
        self.end_headers()
        if status in (200, 206) and self.path.startswith("/bytes/") and self.fake.cut_after:
            body = body[: self.fake.cut_after.pop(0)]
        self.wfile.write(body)

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def fake_hub() -> Iterator[FakeHub]:
    fake = FakeHub(
        {
            "lmo_base.zip": zipped(BASE),
            "lmo_models.zip": zipped(MODELS),
            "lmo_test_bop19.zip": zipped(TEST),
            "lmo_test_all.zip": zipped({"test/000002/rgb/9.png": b"9"}),
        }
    )
    handler = type("BoundHandler", (Handler,), {"fake": fake})
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    fake.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    yield fake
    server.shutdown()
    server.server_close()
    thread.join()


def zipped(files: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def part_files(root: Path) -> list[Path]:
    return sorted((root / ".download").glob("*.part"))


def assert_complete(root: Path) -> None:
    for name, data in {**MODELS, **TEST}.items():
        assert (root / name).read_bytes() == data
    assert (root / "camera.json").read_bytes() == b"{}"
    assert not (root / "lmo").exists()
    assert {path.suffix for path in (root / ".download").iterdir()} == {".done", ""}


def test_full_download_unpacks_what_one_evaluates_on(fake_hub, tmp_path):
    steps: list[Step] = []
    root = download_dataset("lmo", tmp_path, hub=fake_hub.hub(), progress=steps.append)
    assert root == tmp_path / "lmo"
    assert_complete(root)
    assert [name for name, _ in fake_hub.requests] == ["lmo_base.zip", "lmo_models.zip", "lmo_test_bop19.zip"]
    assert {step.action for step in steps} == {"download", "check", "unpack"}
    ends = {(step.action, step.subject): step for step in steps}
    assert all(step.done == step.total for step in ends.values())


def test_complete_parts_are_skipped_until_the_hub_has_a_new_version(fake_hub, tmp_path):
    root = download_dataset("lmo", tmp_path, ["base", "models"], hub=fake_hub.hub())
    fake_hub.requests.clear()
    download_dataset("lmo", tmp_path, ["base", "models"], hub=fake_hub.hub())
    assert fake_hub.requests == []
    fake_hub.files["lmo_models.zip"] = zipped({**MODELS, "models/obj_000005.ply": b"new"})
    download_dataset("lmo", tmp_path, ["base", "models"], hub=fake_hub.hub())
    assert (root / "models/obj_000005.ply").read_bytes() == b"new"


def test_cut_connection_is_continued_where_it_broke(fake_hub, tmp_path):
    fake_hub.cut_after = [100_000, 200_000]
    root = download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub())
    assert [wanted for _, wanted in fake_hub.requests] == [None, "bytes=100000-", "bytes=300000-"]
    assert len(list((root / "test/000002/rgb").iterdir())) == 40


def test_more_cuts_than_attempts_are_fine_while_bytes_arrive(fake_hub, tmp_path):
    fake_hub.cut_after = [10_000] * 10
    download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub())
    assert len(fake_hub.requests) == 11


def test_no_new_bytes_gives_up_in_one_line_and_a_second_run_continues(fake_hub, tmp_path):
    fake_hub.cut_after = [100_000, 0, 0, 0]
    with pytest.raises(
        InputError, match=r"lmo_test_bop19.zip: the connection ended after 100000 of \d+ bytes; gave up after 3"
    ):
        download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub())
    assert [part.stat().st_size for part in part_files(tmp_path / "lmo")] == [100_000]
    download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub())
    assert fake_hub.requests[-1] == ("lmo_test_bop19.zip", "bytes=100000-")


def test_busy_server_is_tried_again(fake_hub, tmp_path):
    fake_hub.busy = 2
    download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert len(fake_hub.requests) == 3


def test_server_without_ranges_is_read_from_the_start(fake_hub, tmp_path):
    fake_hub.ranges = False
    fake_hub.cut_after = [100_000]
    root = download_dataset("lmo", tmp_path, ["base", "models", "test_bop19"], hub=fake_hub.hub())
    assert_complete(root)


def test_part_that_is_too_long_is_started_again(fake_hub, tmp_path):
    archive = list_archives("lmo", fake_hub.hub())["models"][0]
    work = tmp_path / "lmo" / ".download"
    work.mkdir(parents=True)
    (work / f"{archive.digest[:12]}-lmo_models.zip.part").write_bytes(b"x" * (archive.size + 5))
    download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert fake_hub.requests == [("lmo_models.zip", None)]


def test_part_of_another_version_is_not_continued(fake_hub, tmp_path):
    fake_hub.cut_after = [1000, 0, 0, 0]
    with pytest.raises(InputError, match="gave up"):
        download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    fake_hub.files["lmo_models.zip"] = zipped({"models/obj_000001.ply": b"other" * 900})
    root = download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert fake_hub.requests[-1] == ("lmo_models.zip", None)
    assert (root / "models/obj_000001.ply").read_bytes() == b"other" * 900
    assert part_files(root) == []


def test_wrong_checksum_is_one_line_and_the_file_is_removed(fake_hub, tmp_path):
    fake_hub.wrong_digest = "lmo_models.zip"
    with pytest.raises(
        FormatError, match=r"^lmo_models.zip: checksum \w{12}... instead of \w{12}...; the file is removed"
    ):
        download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert part_files(tmp_path / "lmo") == []
    assert not (tmp_path / "lmo" / "models").exists()


def test_unknown_name_lists_the_known_ones(fake_hub, tmp_path):
    for name in ("lmoo", "../lmo", "a/b"):
        with pytest.raises(UnknownIdError, match=r"is not in BOP on the hub; available: .*lmo.*ycbv"):
            download_dataset(name, tmp_path, hub=fake_hub.hub())
    assert list(tmp_path.iterdir()) == []


def test_unknown_part_lists_the_known_ones(fake_hub, tmp_path):
    with pytest.raises(
        UnknownIdError, match="part tset is not in lmo on the hub; available: base, models, test_all, test_bop19"
    ):
        download_dataset("lmo", tmp_path, ["tset"], hub=fake_hub.hub())


def test_no_network_is_one_line(tmp_path):
    hub = Hub(endpoint="http://127.0.0.1:9", first_wait_s=0.0)
    with pytest.raises(InputError, match=r"^http://127.0.0.1:9: no connection \(.*refused.*\); check the network"):
        download_dataset("lmo", tmp_path, hub=hub)


def test_endpoint_must_be_http(tmp_path):
    with pytest.raises(InputError, match="must start with http"):
        download_dataset("lmo", tmp_path, hub=Hub(endpoint="file:///etc"))


def test_disk_too_small_is_refused_before_the_first_byte(fake_hub, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)._replace(free=1_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    with pytest.raises(InputError, match=r"\d\.\d\d GB needed, 0.00 GB free; free some space or choose another folder"):
        download_dataset("lmo", tmp_path, hub=fake_hub.hub())
    assert fake_hub.requests == []


def test_disk_that_fills_up_leaves_a_part_to_continue(fake_hub, tmp_path):
    def full_after_some(step: Step) -> None:
        if step.done > 300_000:
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(InputError, match="GB needed"):
        download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub(), progress=full_after_some)
    assert part_files(tmp_path / "lmo")[0].stat().st_size > 0
    assert_resumes(fake_hub, tmp_path)


def test_ctrl_c_leaves_a_part_to_continue(fake_hub, tmp_path):
    def interrupt(step: Step) -> None:
        if step.done > 300_000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub(), progress=interrupt)
    assert_resumes(fake_hub, tmp_path)


def assert_resumes(fake_hub: FakeHub, tmp_path: Path) -> None:
    have = part_files(tmp_path / "lmo")[0].stat().st_size
    root = download_dataset("lmo", tmp_path, ["test_bop19"], hub=fake_hub.hub())
    assert fake_hub.requests[-1] == ("lmo_test_bop19.zip", f"bytes={have}-")
    assert (root / "test/000002/rgb/000039.png").read_bytes() == TEST["test/000002/rgb/000039.png"]


def test_ctrl_c_while_unpacking_moves_nothing_and_needs_no_second_download(fake_hub, tmp_path):
    def interrupt(step: Step) -> None:
        if step.action == "unpack":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub(), progress=interrupt)
    assert not (tmp_path / "lmo" / "models").exists()
    fake_hub.requests.clear()
    download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert fake_hub.requests == []
    assert (tmp_path / "lmo" / "models" / "obj_000001.ply").exists()


def test_mended_files_are_not_overwritten_unless_asked(fake_hub, tmp_path):
    mended = tmp_path / "lmo" / "models" / "obj_000001.ply"
    mended.parent.mkdir(parents=True)
    mended.write_bytes(b"mended")
    with pytest.raises(InputError, match=r"obj_000001.ply: exists and differs from the archive \(1 such files\)"):
        download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub())
    assert mended.read_bytes() == b"mended"
    download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub(), overwrite=True)
    assert mended.read_bytes() == MODELS["models/obj_000001.ply"]


def test_second_download_into_the_same_folder_is_refused(fake_hub, tmp_path):
    def second(step: Step) -> None:
        with pytest.raises(InputError, match="another download into this folder is running"):
            download_dataset("lmo", tmp_path, ["base"], hub=fake_hub.hub())

    download_dataset("lmo", tmp_path, ["models"], hub=fake_hub.hub(), progress=second)


@pytest.mark.parametrize("name", ["../outside.txt", "/etc/outside.txt", "a/../../outside.txt", "..\\outside.txt"])
def test_archive_that_points_outside_is_refused(name, tmp_path):
    archive = tmp_path / "evil.zip"
    archive.write_bytes(zipped({"fine.txt": b"1", name: b"2"}))
    with pytest.raises(
        FormatError, match=r"evil.zip: entry .* is a path outside the dataset; refused, nothing was unpacked"
    ):
        unpack([archive], tmp_path / "root", scratch=tmp_path / "scratch")
    assert [path.name for path in tmp_path.iterdir()] == ["evil.zip"]


def test_archive_with_a_link_is_refused(tmp_path):
    info = zipfile.ZipInfo("link")
    info.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as archive:
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(FormatError, match="is a link"):
        unpack([tmp_path / "evil.zip"], tmp_path / "root", scratch=tmp_path / "scratch")


def test_damaged_archive_changes_nothing(tmp_path):
    data = bytearray(zipped({"a.txt": b"a" * 1000, "b.txt": b"b" * 1000}))
    data[data.rindex(b"b" * 500)] ^= 1
    (tmp_path / "bad.zip").write_bytes(data)
    with pytest.raises(FormatError, match=r"bad.zip: not a usable zip archive \(Bad CRC-32"):
        unpack([tmp_path / "bad.zip"], tmp_path / "root", scratch=tmp_path / "scratch")
    assert not (tmp_path / "root").exists()


def split_archive(folder: Path, files: dict[str, bytes]) -> list[Path]:
    """A split archive by the zip command, in order."""
    if not shutil.which("zip"):
        pytest.skip("the zip command is absent")
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    names = sorted({name.split("/")[0] for name in files})
    subprocess.run(["zip", "-q", "-r", "-0", "-s", "64k", "lmo_train_pbr.zip", *names], cwd=folder, check=True)
    return [*sorted(folder.glob("*.z[0-9]*")), folder / "lmo_train_pbr.zip"]


def test_split_archive_is_downloaded_and_unpacked(fake_hub, tmp_path):
    images = {f"train_pbr/000000/rgb/{i:06d}.jpg": bytes([i]) * (20_000 + i) for i in range(30)}
    parts = split_archive(tmp_path, images)
    assert len(parts) > 5
    fake_hub.files.update({part.name: part.read_bytes() for part in parts})
    root = download_dataset("lmo", tmp_path / "to", ["train_pbr"], hub=fake_hub.hub())
    assert [name for name, _ in fake_hub.requests] == [part.name for part in parts]
    for name, data in images.items():
        assert (root / name).read_bytes() == data


def test_split_archive_with_a_missing_part_is_one_line(tmp_path):
    parts = split_archive(tmp_path, {f"a/{i}.bin": bytes([i]) * 30_000 for i in range(10)})
    with pytest.raises(FormatError, match=r"lmo_train_pbr.zip: not a usable zip archive \(.*a part is missing"):
        unpack([parts[0], *parts[2:]], tmp_path / "root", scratch=tmp_path / "scratch")


def test_default_parts_follow_the_table_and_else_the_listing():
    def listing(*parts: str) -> dict[str, tuple[RemoteFile, ...]]:
        return {part: (RemoteFile("x/y", f"new_{part}.zip", 1, "0", "sha256"),) for part in sorted(parts)}

    assert default_parts("new", listing("base", "models", "test_all", "train_pbr")) == ("base", "models", "test_all")
    assert default_parts("new", listing("base", "test_all", "test_bop24", "val")) == ("base", "test_bop24")
    tless = {
        part: (RemoteFile("x/tless", f"tless_{part}.zip", 1, "0", "sha256"),)
        for part in ("base", "models", "test_kinect_bop19", "test_primesense_bop19")
    }
    assert default_parts("tless", tless) == ("base", "models", "test_primesense_bop19")


def test_command_lists_archives_and_downloads(fake_hub, tmp_path):
    console = Console(file=io.StringIO(), width=100)
    config = DownloadConfig("lmo", to=tmp_path, parts="base, models", endpoint=fake_hub.url)
    assert run(config, console) == 0
    assert (tmp_path / "lmo" / "camera.json").exists()
    assert run(DownloadConfig("lmo", to=tmp_path, list=True, endpoint=fake_hub.url), console) == 0
    text = console.file.getvalue()
    assert "is complete; see it with: inspector serve" in text
    rows = {line.split("│")[1].strip(): line for line in text.splitlines() if line.startswith("│")}
    assert "complete" in rows["base"]
    assert "by default" in rows["test_bop19"]
    assert "default" not in rows["test_all"]
