"""The recordings of the run that is open: read for our own views, and served to rerun's viewer."""

import secrets
import threading
from pathlib import Path

from inspector.recording_server import RecordingServer
from pipeline.exceptions import InputError
from pipeline.recording import RecordingReader
from pipeline.run import Run
from pipeline.scene import ImageKey

RECORDINGS_KEPT = 8
"""Opened recordings kept."""


class Recordings:
    """The recordings of a run; may be used from any thread."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._readers: dict[Path, tuple[int, RecordingReader]] = {}
        self._server: RecordingServer | None = None
        self._origins: set[str] = set()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._readers)

    def reader(self, key: ImageKey) -> RecordingReader | None:
        """Open the recording of an image, anew when it was written anew; None without one, InputError if damaged."""
        path = self._run.recording_path(key)
        if not path.is_file():
            return None
        written = path.stat().st_mtime_ns
        known = self._readers.get(path)
        if known is None or known[0] != written:
            reader = RecordingReader.open(path)
            with self._lock:
                while len(self._readers) >= RECORDINGS_KEPT:
                    self._readers.pop(next(iter(self._readers)))
                known = self._readers[path] = (written, reader)
        return known[1]

    def stages(self) -> frozenset[str]:
        """First parts of the paths of what is recorded, such as `epos`; of the method's name alone before there is any."""
        for image in self._run.finished_images():
            try:
                reader = self.reader(image)
            except InputError:  # the window says it when it comes to the image
                continue
            if reader is not None:
                return frozenset(path.split("/")[0] for path in reader.kinds())
        return frozenset({self._run.info.method})

    def rerun_url(self, key: ImageKey) -> str:
        """Address of rerun's web viewer on the recording of an image, served to this machine only.

        Raises MissingFileError if the image has no recording, InputError if no server can be started.
        """
        with self._lock:
            if self._server is None:
                self._server = RecordingServer(self._run.root, secrets.token_urlsafe(24), self._origins)
                self._server.start()
        return self._server.viewer_url(key)

    def allow_origins(self, origins: set[str]) -> None:
        """Say under which addresses browsers have the inspector open; only those may show recordings."""
        self._origins = origins

    def stop(self) -> None:
        """Stop serving."""
        with self._lock:
            if self._server is not None:
                self._server.stop()
                self._server = None
