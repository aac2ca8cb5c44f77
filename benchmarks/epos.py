"""What EPOS costs an image: network, correspondences and fitting apart, with 1, 3 and 10 instances, and peak memory.

    python benchmarks/epos.py                                         # both networks with random weights, on the demo
    python benchmarks/epos.py path/to/lmo --checkpoint network.pt     # a trained network on its test images

Fitting is measured on correspondences of known quality, so that it does not depend on how well a network was trained: made
ones (`pipeline.epos.fitting.synthetic`), and those of the dataset's images by the oracle with made-up noise
(`pipeline.epos.oracle`). Times on a CPU are processor seconds, medians. The thesis: 0.75 s an image with an Nvidia P100,
of which fitting 0.52 s. Nothing is asserted.
"""

import argparse
import resource
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
import torch

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.epos.checkpoint import TrainedNetwork, TrainedObject, load_network
from pipeline.epos.config import EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.synthetic import K, make_scene
from pipeline.epos.fitting.warm_up import warm_up
from pipeline.epos.fragments import fragments_of
from pipeline.epos.networks.config import Backbone, NetworkConfig
from pipeline.epos.networks.network import EposNetwork, chosen_device
from pipeline.epos.oracle import OracleNoise, OracleSettings, make_oracle
from pipeline.epos.prediction import see
from pipeline.recording import NullRecorder

DEMO = Path(__file__).resolve().parents[1] / "assets" / "demo"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path, nargs="?", default=DEMO)
    parser.add_argument("--checkpoint", type=Path)
    parser.add_argument("--images", type=int, default=5)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    dataset, device = open_dataset(options.dataset), chosen_device(options.device)
    print(f"torch {torch.__version__} on {device}, {options.threads} threads, {options.precision}")
    fragments_cost(dataset)
    warm_up("pooled")
    fitting_cost()
    oracle_cost(dataset, options.images)
    tell_memory()
    if options.checkpoint:
        trained = load_network(options.checkpoint, device)
        network_cost(trained, dataset, options, device)
        whole_cost(trained, dataset, options)
        tell_memory()
        return
    for backbone in ("light", "xception65"):
        network_cost(untrained(backbone, dataset, device), dataset, options, device)
        tell_memory()


def tell_memory() -> None:
    """The most memory that the process has had."""
    print(f"peak memory of the process so far: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


def fragments_cost(dataset: Dataset) -> None:
    """Splitting each model into 64 fragments, for the first time."""
    models = [dataset.model(obj_id, "display") for obj_id in dataset.obj_ids]
    begun = process_time()
    for model in models:
        fragments_of(model)
    print(f"fragments: {(process_time() - begun) / len(models):.3f} s an object")


def untrained(backbone: Backbone, dataset: Dataset, device: torch.device) -> TrainedNetwork:
    """A network with random weights for the objects of the dataset, with 64 fragments each."""
    models = [dataset.model(obj_id, "display") for obj_id in dataset.obj_ids]
    objects = tuple(TrainedObject.of(model, fragments_of(model)) for model in models)
    network = EposNetwork(NetworkConfig(backbone), [64] * len(objects)).move(device).eval()
    return TrainedNetwork(network, objects)


def network_cost(trained: TrainedNetwork, dataset: Dataset, options: argparse.Namespace, device: torch.device) -> None:
    """The network without heads of fragments, on an image of the dataset."""
    rgb = dataset.rgb(next(dataset.images()))
    assert rgb is not None
    clock = process_time if device.type == "cpu" else perf_counter
    seconds = []
    for _ in range(options.images + 1):
        begun = clock()
        see(trained.network, rgb, options.precision)  # its answer is on the CPU: the device has finished
        seconds.append(clock() - begun)
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
            begun = process_time()
            fit_poses(scene.correspondences, K, instances=count)
            seconds.append(process_time() - begun)
        size = np.mean([len(scene.correspondences) for scene in scenes])
        print(f"fitting {count} instances, {size:.0f} correspondences: {1000 * np.median(seconds[1:]):.1f} ms")


def oracle_cost(dataset: Dataset, images: int) -> None:
    """What follows the network, on images of the dataset: all objects of an image together."""
    settings = OracleSettings(noise=OracleNoise(0.1, 0.25, 0.3, 0.1))
    epos = make_oracle(settings, dataset).epos
    targets = dataset.targets()
    rows = []
    for key in list(dict.fromkeys(target.image for target in targets))[: images + 1]:
        epos.estimate(dataset.image(key), [target for target in targets if target.image == key], NullRecorder())
        rows.append((epos.seconds["correspondences"], epos.seconds["fitting"], epos.counts["objects"]))
    establishing, fitting, objects = np.median(rows[1:], axis=0)
    print(
        f"{dataset.name} by the oracle with noise, {objects:.0f} objects an image: "
        f"correspondences {1000 * establishing:.1f} ms, fitting {1000 * fitting:.1f} ms an image (wall time)"
    )


if __name__ == "__main__":
    main()
