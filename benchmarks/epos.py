"""What EPOS costs an image: network, correspondences and fitting apart, with 1, 3 and 10 instances, and peak memory.

    python benchmarks/epos.py assets/demo --checkpoint network.pt     # a trained network on its test images
    python benchmarks/epos.py assets/demo --backbone xception65       # random weights: the network's cost alone

Fitting is measured on correspondences of known quality (`pipeline.epos.fitting.synthetic`), so that it does not depend on
how well a network was trained. The thesis: 0.75 s an image with an Nvidia P100, of which fitting 0.52 s.
"""

import argparse
import resource
from pathlib import Path
from time import perf_counter

import numpy as np
import torch

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.epos.checkpoint import TrainedNetwork, TrainedObject, load_network, model_bounds
from pipeline.epos.config import EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.synthetic import K, make_scene
from pipeline.epos.fragments import fragments_of
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork, chosen_device
from pipeline.epos.prediction import see
from pipeline.recording import NullRecorder


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--backbone", choices=("light", "xception65"), default="light")
    parser.add_argument("--images", type=int, default=5)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    dataset, device = open_dataset(options.dataset), chosen_device(options.device)
    print(f"torch {torch.__version__} on {device}, {options.threads} threads, {options.precision}")
    fragments_cost(dataset)
    trained = network_of(options, dataset, device)
    network_cost(trained, dataset, options, device)
    if options.checkpoint:
        whole_cost(trained, dataset, options)
    fitting_cost()
    print(f"peak memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def fragments_cost(dataset: Dataset) -> None:
    """Splitting each model into 64 fragments, for the first time."""
    models = [dataset.model(obj_id, "display") for obj_id in dataset.obj_ids]
    begun = perf_counter()
    for model in models:
        fragments_of(model)
    print(f"fragments: {(perf_counter() - begun) / len(models):.3f} s an object")


def network_of(options: argparse.Namespace, dataset: Dataset, device: torch.device) -> TrainedNetwork:
    """The network of the checkpoint, else one with random weights for the objects of the dataset."""
    if options.checkpoint:
        return load_network(options.checkpoint, device)
    models = [dataset.model(obj_id, "display") for obj_id in dataset.obj_ids]
    objects = tuple(TrainedObject(model.obj_id, fragments_of(model), model_bounds(model)) for model in models)
    network = EposNetwork(NetworkConfig(options.backbone), [64] * len(objects)).to(device).eval()
    return TrainedNetwork(network, objects)


def network_cost(trained: TrainedNetwork, dataset: Dataset, options: argparse.Namespace, device: torch.device) -> None:
    """The network without heads of fragments, on an image of the dataset."""
    rgb = dataset.rgb(next(dataset.images()))
    assert rgb is not None
    seconds = []
    for _ in range(options.images + 1):
        begun = perf_counter()
        see(trained.network, rgb, options.precision)
        seconds.append(perf_counter() - begun)
    size = sum(p.numel() for p in trained.network.parameters()) / 1e6
    name = trained.network.config.backbone
    print(
        f"network {name} ({size:.1f} M weights), {rgb.shape[1]} x {rgb.shape[0]}: {np.median(seconds[1:]):.3f} s an image"
    )
    if device.type == "cuda":
        print(f"peak memory of the device: {torch.cuda.max_memory_allocated(device) / 2**20:.0f} MB")


def whole_cost(trained: TrainedNetwork, dataset: Dataset, options: argparse.Namespace) -> None:
    """All stages on test images, by the estimator's own clock; the first image is left out."""
    settings = EposSettings(options.checkpoint, precision=options.precision)
    estimator = EposEstimator(trained, settings)
    targets = [target for target in dataset.targets() if target.obj_id in trained.obj_ids]
    keys = list(dict.fromkeys(target.image for target in targets))[: options.images + 1]
    rows = []
    for key in keys:
        estimator.estimate(dataset.image(key), [t for t in targets if t.image == key], NullRecorder())
        rows.append(list(estimator.seconds.values()))
    for stage, seconds in zip(estimator.seconds, np.median(rows[1:], axis=0), strict=True):
        print(f"{stage}: {1000 * seconds:.1f} ms an image (median of {len(rows) - 1})")


def fitting_cost() -> None:
    """Fitting of one object's instances, by their number."""
    for count in (1, 3, 10):
        scenes = [make_scene(seed, instances=count) for seed in range(6)]
        seconds = []
        for scene in scenes:
            begun = perf_counter()
            fit_poses(scene.correspondences, K, instances=count)
            seconds.append(perf_counter() - begun)
        print(f"fitting {count} instances: {1000 * np.median(seconds[1:]):.1f} ms")


if __name__ == "__main__":
    main()
