"""HashMatch on two images of the demo, with fewer templates than it has by default on the whole sphere."""

from pathlib import Path

from pipeline.bop.dataset import open_dataset
from pipeline.bop.vsd import vsd_of_poses
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.estimator import HashMatchEstimator
from pipeline.recording import NullRecorder

DEMO = Path(__file__).resolve().parents[3] / "assets" / "demo"


def test_most_parts_of_two_demo_images_are_found(tmp_path: Path):
    dataset = open_dataset(DEMO)
    keys = list(dataset.images())[:2]
    targets = {key: [target for target in dataset.targets() if target.image == key] for key in keys}
    sought = sorted({target.obj_id for key in keys for target in targets[key]})
    config = HashMatchConfig(
        views="sphere", in_plane="circle", angle_step_deg=20, rescans=0, drawn_per_instance=150, cache=tmp_path
    )
    estimator = HashMatchEstimator.of_dataset(dataset, config, sought)
    found = []
    for key in keys:
        image = dataset.image(key)
        assert image.depth is not None
        estimates = estimator.estimate(image, targets[key], NullRecorder())
        for gt in dataset.ground_truth(key):
            if gt.visible_fraction is not None and gt.visible_fraction < 0.1:
                continue
            model = dataset.model(gt.obj_id)
            errors = [
                vsd_of_poses(
                    model, image.camera, estimate.camera_from_model, gt.camera_from_model, image.depth,
                    taus=[0.02 / model.diameter], variant="bop18",
                ).values[0]
                for estimate in estimates
                if estimate.obj_id == gt.obj_id
            ]  # fmt: skip
            found.append(min(errors, default=1.0) < 0.3)
    assert len(found) >= 10
    assert sum(found) >= 0.7 * len(found)
