"""The datasets that are open: the one that the server was started with, and those that were asked for since."""

import threading
from pathlib import Path

from inspector.workspace import Workspace
from pipeline.bop.dataset import open_dataset
from pipeline.exceptions import InputError


class Workspaces:
    """Workspaces by dataset; any thread may ask."""

    def __init__(self, first: Workspace) -> None:
        """Begin with the workspace that browsers see when they open the page."""
        self.first = first
        self._open = [first]
        self._lock = threading.Lock()

    def __iter__(self):
        return iter(tuple(self._open))

    def of(self, name: str, split: str) -> Workspace:
        """Return the workspace of a dataset's split; one that lies beside an open dataset is opened and started.

        Raises InputError if there is no such dataset, or it cannot be opened.
        """
        with self._lock:
            for workspace in self._open:
                if (workspace.dataset.name, workspace.dataset.split) == (name, split):
                    return workspace
            workspace = Workspace(open_dataset(self._beside(name), split))
            self._open.append(workspace)
        workspace.start()
        return workspace

    def stop(self) -> None:
        """End the work on all of them."""
        for workspace in self:
            workspace.stop()

    def _beside(self, name: str) -> Path:
        roots = [workspace.dataset.root for workspace in self._open]
        folders = {folder for root in roots for folder in (root.absolute().parent, root.resolve().parent)}
        for folder in sorted(folders):
            if name not in ("", "..") and Path(name).name == name and (folder / name).is_dir():
                return folder / name
        where = ", ".join(map(str, sorted(folders)))
        raise InputError(f"dataset {name}: no such folder in {where}; put it there, or start: inspector serve {name}")
