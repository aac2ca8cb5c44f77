"""Talking to the hub that BOP publishes on (Hugging Face): listing a dataset's archives and fetching one file.

Bytes go to a `.part` file named by the checksum of the whole, so that any interruption can be continued and two
versions never mix; the checksum is verified before the file gets its final name.
"""

import hashlib
import http.client
import json
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal, NamedTuple

from pipeline.bop.facts import dataset_facts, known_datasets
from pipeline.exceptions import FormatError, InputError, UnknownIdError

_LISTING_ATTEMPTS = 3  # without a network the user should read so within seconds
_GONE = (401, 403, 404)  # the hub answers 401 for a repository that does not exist
_PASSING = (408, 429, 500, 502, 503, 504)
_CHUNK = 1 << 18


@dataclass(frozen=True)
class Hub:
    """Where and how patiently to fetch."""

    endpoint: str = "https://huggingface.co"
    attempts: int = 6
    """Tries in a row without a single new byte before giving up."""
    first_wait_s: float = 1.0
    """Seconds before the second try; doubled for each further one."""
    timeout_s: float = 30.0
    """Seconds of silence after which a connection counts as cut."""

    def url(self, path: str) -> str:
        """Address of a path on the hub; raises InputError for an endpoint that is not http."""
        if not re.match(r"https?://", self.endpoint):
            raise InputError(f"endpoint {self.endpoint!r}: must start with http:// or https://")
        return f"{self.endpoint.rstrip('/')}/{path}"

    def wait(self, failures: int) -> None:
        """Wait longer after every failure in a row."""
        time.sleep(self.first_wait_s * 2 ** max(failures - 1, 0))


DEFAULT_HUB = Hub()


@dataclass(frozen=True)
class RemoteFile:
    """A file of a dataset on the hub."""

    repository: str
    """Owner and name on the hub."""
    name: str
    size: int
    """Bytes."""
    digest: str
    """Hexadecimal SHA-256, or for small files that are not in large file storage the git blob id."""
    algorithm: Literal["sha256", "git"]


class Step(NamedTuple):
    """Progress of one action on one file, in bytes."""

    action: Literal["download", "check", "unpack"]
    subject: str
    done: int
    total: int


ProgressCallback = Callable[[Step], None]


class _CutError(Exception):
    """A transfer ended early or the server has a passing fault: worth another try."""


def list_archives(name: str, hub: Hub = DEFAULT_HUB) -> dict[str, tuple[RemoteFile, ...]]:
    """List the archives of a dataset on the hub by part ("base", "models", "test_bop19", ...), split ones in order.

    Raises UnknownIdError for a name that the hub does not hold and InputError without a connection.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
        raise _unknown(name)
    repository = dataset_facts(name).hub_repository
    url: str | None = hub.url(f"api/datasets/{repository}/tree/main?recursive=true")
    files: list[RemoteFile] = []
    while url:
        page, url = _page(url, name, hub)
        files += [_remote_file(repository, entry) for entry in page if entry.get("type") == "file"]
    return _group(files, prefix=repository.rpartition("/")[2] + "_")


def fetch(
    file: RemoteFile, folder: Path, hub: Hub = DEFAULT_HUB, progress: ProgressCallback = lambda step: None
) -> Path:
    """Fetch one file into `folder`, continuing what is there, verify its checksum and return its path.

    Raises InputError when the server gives nothing more, FormatError for a wrong checksum (the file is removed).
    """
    complete = folder / f"{file.digest[:12]}-{file.name}"
    part = complete.with_name(complete.name + ".part")
    for outdated in set(folder.glob(f"*-{file.name}*")) - {complete, part}:
        outdated.unlink()
    if complete.exists():
        return complete
    part.touch()
    failures = 0
    while (before := part.stat().st_size) != file.size:
        try:
            _fetch_rest(file, part, hub, progress)
        except _CutError as error:
            failures = 0 if part.stat().st_size > before else failures + 1
            if failures >= hub.attempts:
                raise InputError(
                    f"{file.name}: {error}; gave up after {failures} tries, run again to continue"
                ) from error
            hub.wait(failures)
    _verify(part, file, progress)
    return part.replace(complete)


def _fetch_rest(file: RemoteFile, part: Path, hub: Hub, progress: ProgressCallback) -> None:
    """Append what is missing; a server that ignores the range is read from the start."""
    have = part.stat().st_size if part.stat().st_size < file.size else 0
    url = hub.url(f"datasets/{file.repository}/resolve/main/{file.name}")
    try:
        with _open(url, hub, {"Range": f"bytes={have}-"} if have else {}) as response:
            begin = _begin(response)
            if begin not in (0, have):
                raise _CutError(f"the server answered with bytes from {begin} instead of {have}")
            with part.open("ab" if begin else "wb") as sink:
                _copy(response, sink, file, begin, progress)
    except urllib.error.HTTPError as error:
        if error.code != 416:
            raise InputError(f"{url}: the server answers {error.code} {error.reason}") from error
        part.write_bytes(b"")  # the range lies outside of what the server has: start again
        raise _CutError("the server refused to continue") from error


def _copy(
    response: http.client.HTTPResponse, sink: IO[bytes], file: RemoteFile, begin: int, progress: ProgressCallback
) -> None:
    done = begin
    progress(Step("download", file.name, done, file.size))
    while True:
        try:
            chunk = response.read(_CHUNK)
        except (OSError, http.client.HTTPException) as error:
            raise _CutError(f"the connection broke after {done} of {file.size} bytes") from error
        if not chunk:
            break
        sink.write(chunk)
        done += len(chunk)
        progress(Step("download", file.name, done, file.size))
    if done < file.size:
        raise _CutError(f"the connection ended after {done} of {file.size} bytes")


def _begin(response: http.client.HTTPResponse) -> int:
    """First byte of an answer: 0 unless it is the range that was asked for."""
    if response.status != 206:
        return 0
    found = re.match(r"bytes (\d+)-", response.headers.get("Content-Range", ""))
    return int(found[1]) if found else -1


@contextmanager
def _open(url: str, hub: Hub, headers: dict[str, str] | None = None) -> Iterator[http.client.HTTPResponse]:
    request = urllib.request.Request(url, headers={"User-Agent": "pose-inspector", **(headers or {})})
    try:
        response = urllib.request.urlopen(request, timeout=hub.timeout_s)
    except urllib.error.HTTPError as error:
        if error.code in _PASSING:
            raise _CutError(f"the server answers {error.code} {error.reason}") from error
        raise
    except (OSError, http.client.HTTPException) as error:  # URLError is an OSError
        raise _CutError(f"no connection ({getattr(error, 'reason', error)})") from error
    with response:
        yield response


def _page(url: str, name: str, hub: Hub) -> tuple[list[dict], str | None]:
    """One page of the hub's file listing and the address of the next one, which stands in the Link header."""
    for failures in range(1, _LISTING_ATTEMPTS + 1):
        try:
            with _open(url, hub) as response:
                following = re.search(r'<([^>]+)>;\s*rel="next"', response.headers.get("Link", ""))
                return json.loads(response.read()), following[1] if following else None
        except _CutError as error:
            if failures == _LISTING_ATTEMPTS:
                raise InputError(
                    f"{hub.endpoint}: {error}; check the network, or name a mirror with --endpoint"
                ) from error
            hub.wait(failures)
        except urllib.error.HTTPError as error:
            if error.code in _GONE:
                raise _unknown(name) from error
            raise InputError(f"{url}: the server answers {error.code} {error.reason}") from error
        except (ValueError, OSError, http.client.HTTPException) as error:
            raise InputError(f"{url}: the answer is not the hub's file listing; check --endpoint") from error
    raise AssertionError("unreachable")


def _unknown(name: str) -> UnknownIdError:
    return UnknownIdError("dataset", name, "BOP on the hub", known_datasets())


def _remote_file(repository: str, entry: dict) -> RemoteFile:
    large = entry.get("lfs")
    try:
        if large:
            digest = large["oid"].removeprefix("sha256:")
            return RemoteFile(repository, entry["path"], int(large["size"]), digest, "sha256")
        return RemoteFile(repository, entry["path"], int(entry["size"]), entry["oid"], "git")
    except (KeyError, TypeError, ValueError) as error:
        raise FormatError(
            f"{entry.get('path', 'a file')}: the hub's file listing lacks {error}; check --endpoint"
        ) from error


def _group(files: list[RemoteFile], prefix: str) -> dict[str, tuple[RemoteFile, ...]]:
    """Group archives by part; only plain names count, so that nothing on the hub can choose a path on this disk."""
    groups: dict[str, list[RemoteFile]] = {}
    for file in sorted(files, key=lambda file: (file.name.endswith(".zip"), len(file.name), file.name)):
        if found := re.fullmatch(r"([A-Za-z0-9][\w.-]*)\.(zip|z\d\d+)", file.name):
            groups.setdefault(found[1].removeprefix(prefix), []).append(file)
    return {part: tuple(group) for part, group in sorted(groups.items()) if group[-1].name.endswith(".zip")}


def _verify(part: Path, file: RemoteFile, progress: ProgressCallback) -> None:
    digest = hashlib.sha256() if file.algorithm == "sha256" else hashlib.sha1(b"blob %d\0" % file.size)
    done = 0
    with part.open("rb") as source:
        while chunk := source.read(1 << 20):
            digest.update(chunk)
            done += len(chunk)
            progress(Step("check", file.name, done, file.size))
    if digest.hexdigest() != file.digest:
        part.unlink()
        raise FormatError(
            f"{file.name}: checksum {digest.hexdigest()[:12]}... instead of {file.digest[:12]}...; "
            "the file is removed, download it again"
        )
