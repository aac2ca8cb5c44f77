"""The SQLite file of the leaderboard: its schema, its transactions, and its errors told in one line.

Every transaction opens the file anew, so threads and processes share nothing but the file. It keeps SQLite's rollback
journal: unlike a write-ahead log that works in home folders on a network and in folders that may only be read, and
there is never more than the one file to copy. Nothing else may open the file: closing it would drop SQLite's locks.
"""

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from pipeline.exceptions import FormatError, InputError

DATABASE_FILE = "leaderboard.sqlite"

BUSY_SECONDS = 30.0
"""How long to wait for other threads and processes."""

_APPLICATION_ID = 0x424F504C  # "BOPL", in the header of the file

MIGRATIONS: tuple[tuple[str, ...], ...] = (
    (
        """CREATE TABLE submissions (
            id INTEGER PRIMARY KEY AUTOINCREMENT, method TEXT NOT NULL, dataset_name TEXT NOT NULL,
            split TEXT NOT NULL, description TEXT NOT NULL, properties TEXT NOT NULL, sha256 TEXT NOT NULL,
            file_name TEXT NOT NULL, rows INTEGER NOT NULL, time_per_image REAL, added TEXT NOT NULL,
            UNIQUE (sha256, dataset_name, split, method))""",
        """CREATE TABLE evaluations (
            id INTEGER PRIMARY KEY AUTOINCREMENT,
            submission_id INTEGER NOT NULL REFERENCES submissions ON DELETE CASCADE,
            fingerprint TEXT NOT NULL, task TEXT NOT NULL, with_vsd INTEGER NOT NULL, version INTEGER NOT NULL,
            vsd REAL, mssd REAL NOT NULL, mspd REAL NOT NULL, per_object TEXT NOT NULL, targets INTEGER NOT NULL,
            why_no_vsd TEXT NOT NULL, seconds REAL NOT NULL, added TEXT NOT NULL, about TEXT NOT NULL,
            instances BLOB NOT NULL,
            UNIQUE (submission_id, fingerprint, task, with_vsd, version))""",
        """CREATE TABLE jobs (
            id INTEGER PRIMARY KEY AUTOINCREMENT,
            submission_id INTEGER NOT NULL REFERENCES submissions ON DELETE CASCADE,
            root BLOB NOT NULL, split TEXT NOT NULL, sensor TEXT, with_vsd INTEGER NOT NULL, again INTEGER NOT NULL,
            begun INTEGER NOT NULL, failure TEXT NOT NULL, worker TEXT NOT NULL)""",
    ),
)
"""What brings a file from each version of the schema (SQLite's `user_version`) to the next."""


class DamagedRowError(Exception):
    """A row that cannot be what was written; `Database` tells the user."""


class Database:
    """Transactions on the database in a folder; the file is made by the first one that writes."""

    def __init__(self, folder: Path) -> None:
        """Look at the file if there is one.

        Raises:
            FormatError: it is damaged or no leaderboard.
            InputError: it cannot be opened or is of a newer version.

        """
        self.path = folder.absolute() / DATABASE_FILE
        with self.reading():
            pass

    @contextlib.contextmanager
    def reading(self) -> Iterator[sqlite3.Connection]:
        """One state of the data, not to be changed; of a file that does not exist yet, the empty one."""
        with self._explained(), contextlib.closing(self._open_to_read()) as connection:
            yield connection

    @contextlib.contextmanager
    def writing(self) -> Iterator[sqlite3.Connection]:
        """A transaction with no other one that writes beside it, done as a whole or, if the block raises, not at all."""
        with self._explained():
            self._make_folder()
            with contextlib.closing(self._connect("rwc")) as connection:
                connection.execute("BEGIN IMMEDIATE")
                try:
                    self._migrate(connection)
                    yield connection
                    connection.execute("COMMIT")
                except BaseException:
                    with contextlib.suppress(sqlite3.Error):  # SQLite has done it already after most errors
                        connection.execute("ROLLBACK")
                    raise

    def _open_to_read(self) -> sqlite3.Connection:
        """A connection in a transaction, to the file or to nothing."""
        if self.path.exists():
            connection = self._connect("rw")
            try:
                connection.execute("BEGIN")
                version = self._version(connection)
                if version == len(MIGRATIONS):
                    return connection
            except BaseException:
                connection.close()
                raise
            connection.close()
            if version > 0:
                with self.writing():  # brings it up to date
                    pass
                return self._open_to_read()
        nothing = self._configured(sqlite3.connect(":memory:", isolation_level=None))
        self._migrate(nothing)
        return nothing

    def _connect(self, mode: str) -> sqlite3.Connection:
        address = f"{self.path.as_uri()}?mode={mode}"
        return self._configured(sqlite3.connect(address, uri=True, timeout=BUSY_SECONDS, isolation_level=None))

    def _configured(self, connection: sqlite3.Connection) -> sqlite3.Connection:
        connection.row_factory = sqlite3.Row
        connection.execute("PRAGMA foreign_keys = ON")
        return connection

    def _version(self, connection: sqlite3.Connection) -> int:
        """Version of the schema, 0 of an empty file. Raises InputError unless it is a leaderboard that we know."""
        version, application = (_pragma(connection, name) for name in ("user_version", "application_id"))
        empty = version == application == 0 and not connection.execute("SELECT 1 FROM sqlite_schema").fetchone()
        if not empty and (application != _APPLICATION_ID or version < 1):
            raise FormatError(f"{self.path}: is another program's database; move it away, or set INSPECTOR_DATA")
        if version > len(MIGRATIONS):
            raise InputError(
                f"{self.path}: is of version {version}, this program knows up to {len(MIGRATIONS)}; "
                "update the program, or set INSPECTOR_DATA to another folder"
            )
        return version

    def _migrate(self, connection: sqlite3.Connection) -> None:
        version = self._version(connection)
        for statements in MIGRATIONS[version:]:
            for statement in statements:
                connection.execute(statement)
        if version < len(MIGRATIONS):
            connection.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")

    def _make_folder(self) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.path.parent}: cannot be made ({error.strerror}); {_ELSEWHERE}") from error

    @contextlib.contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except (DamagedRowError, UnicodeDecodeError) as error:
            raise self._damaged(str(error)) from error
        except OSError as error:
            raise InputError(f"{self.path}: cannot be opened ({error.strerror}); {_ELSEWHERE}") from error
        except sqlite3.IntegrityError:  # a rule of the schema: the caller's
            raise
        except sqlite3.Error as error:
            raise self._explanation(error) from error

    def _explanation(self, error: sqlite3.Error) -> Exception:
        """What a user is told; an error in our own use of SQLite stays as it is."""
        code = getattr(error, "sqlite_errorname", "")
        match code.removeprefix("SQLITE_").partition("_")[0]:
            case "FULL":
                return InputError(f"{self.path}: the disk is full, nothing was changed; free space and try again")
            case "READONLY" | "CANTOPEN" | "PERM":
                return InputError(f"{self.path}: cannot be written or opened ({error}); {_ELSEWHERE}")
            case "BUSY" | "LOCKED":
                return InputError(f"{self.path}: has been in use for {BUSY_SECONDS:.0f} s; end what uses it, try again")
            case "IOERR":
                return InputError(f"{self.path}: cannot be read or written ({error}); check the disk, try again")
            case "NOTADB" | "CORRUPT":
                return self._damaged(str(error))
        # What names a table or holds text comes from a damaged file if it comes from SQLite; our statements are tested.
        return self._damaged(str(error)) if isinstance(error, sqlite3.OperationalError) else error

    def _damaged(self, how: str) -> FormatError:
        return FormatError(
            f"{self.path}: is damaged ({how}); restore a copy or move it away; the uploads beside it in files/ remain"
        )


_ELSEWHERE = "make it writable, or set INSPECTOR_DATA to a folder that you may write to"


def _pragma(connection: sqlite3.Connection, name: str) -> int:
    return connection.execute(f"PRAGMA {name}").fetchone()[0]
