"""What all tests share: the real data (skipped with a reason where it is absent), and shape checks on."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

REPOSITORY = Path(__file__).resolve().parent.parent
# How long something takes on a busy machine is no fault.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


@pytest.fixture(scope="session", autouse=True)
def own_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Tests, and the programs that they start, keep their leaderboards in a folder that goes away."""
    folder = tmp_path_factory.mktemp("inspector_data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("INSPECTOR_DATA", str(folder))
        yield folder


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data; tests that use it are skipped where it is absent."""
    folder = Path(os.environ.get("INSPECTOR_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real data absent: {folder} (set INSPECTOR_SHARED_DATA)")
    return folder


@pytest.fixture(scope="session")
def lmo(shared_data: Path) -> Path:
    """Root of the LM-O subset: 50 test images of scene 2, depth for image 3 only, no gt_info, no masks."""
    return shared_data / "lmo"


@pytest.fixture(scope="session")
def ycbv(shared_data: Path) -> Path:
    """Root of the YCB-V subset: scene 1 with ground truth, scene 901 without."""
    return shared_data / "ycbv"
