"""Rows of the run of a method that is not ours, under any choice."""

from collections.abc import Callable

import pytest
from third_party_method import make_run
from tiny_dataset import FIRST, make_dataset

from inspector.epos.choice import EposChoice
from inspector.epos.recording import EposRecording
from inspector.epos.row import EposRow
from inspector.epos.thresholds import Thresholds
from inspector.frame import frame_of
from inspector.opening import open_workspace
from inspector.selection import RowKey, Selection
from inspector.workspace import Workspace
from pipeline.bop.dataset import open_dataset

OF_RUN = Thresholds(0.1, 0.5, 4.0)
BOX_2 = RowKey(*FIRST, 2, 2, -1)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    folder = tmp_path_factory.mktemp("third_party")
    dataset = make_dataset(folder / "tiny")
    return open_workspace(make_run(folder / "run", open_dataset(dataset)))


@pytest.fixture
def row_of(workspace: Workspace) -> Callable[..., EposRow]:
    def make(key: RowKey = BOX_2, **chosen) -> EposRow:
        selection = Selection(row=key, epos=EposChoice(**chosen))
        frame = frame_of(workspace, selection)
        assert frame is not None
        assert workspace.recordings is not None
        reader = workspace.recordings.reader(frame.key)
        assert reader is not None
        return EposRow(frame, EposRecording(reader, key.obj_id), selection.epos, OF_RUN)

    return make
