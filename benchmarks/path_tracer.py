"""Cost of ray-traced images: seconds per image and preset, per stage; and what the denoiser makes of few samples.

    python benchmarks/path_tracer.py [--scenes NAME ...] [--width 640 --height 480] [--quality]

Wall and CPU seconds (user and system, all threads), medians over the cameras; the first image of a scene, which
compiles code for it, is listed apart. Nothing is asserted. Set INSPECTOR_MITSUBA_VARIANT to compare variants.
"""

import os
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pipeline.geometry import inverse, transform
from pipeline.scene import Camera
from pipeline.synth.cameras import CameraRanges, sample_view
from pipeline.synth.demo.part_files import part_model
from pipeline.synth.materials import random_material
from pipeline.synth.tracing.denoising import denoise
from pipeline.synth.tracing.mitsuba_scene import Object
from pipeline.synth.tracing.mitsuba_variant import mitsuba
from pipeline.synth.tracing.path_tracer import PRESETS, PathTracer, Preset
from pipeline.synth.tracing.tone_mapping import photograph
from pipeline.synth.worlds import FURNISHED, build_world
from pipeline.synth.worlds.world import Stage, World


@dataclass(frozen=True)
class Config:
    """What to measure."""

    scenes: tuple[str, ...] = (*FURNISHED, "cube_room")
    presets: tuple[str, ...] = ("low", "bop20", "medium")
    """`high` takes some ten times as long as `medium`."""
    width: int = 640
    height: int = 480
    cameras: int = 3
    quality: bool = False
    """Also compare few samples, denoised, with 50 and with 400."""


def cost(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and CPU seconds of one call."""
    before, start = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    work()
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def arrangement(stage: Stage, rng: np.random.Generator) -> list[Object]:
    """Our parts, standing apart on a stage."""
    objects: list[Object] = []
    for k, at in enumerate(stage.polygon * 0.5):
        model = part_model(k + 1)
        pose = stage.world_from_stage @ transform(np.eye(3), np.array([*at, -model.vertices[:, 2].min()]))
        objects.append((model, random_material(rng), pose))
    return objects


def camera_about(world: World, stage: Stage, rng: np.random.Generator, config: Config) -> tuple[Camera, np.ndarray]:
    """A camera half a metre to a metre from the stage, inside the room and clear of furniture."""
    focal = 0.9 * config.width
    K = np.array([[focal, 0, config.width / 2 - 0.5], [0, focal, config.height / 2 - 0.5], [0, 0, 1.0]])
    centre = stage.world_from_stage[:3, 3]
    ranges = CameraRanges(elevation_deg=(20, 60), distance=(0.5, 1.0), roll_deg=(0, 0))
    for _ in range(500):
        pose = sample_view(ranges, centre, rng)
        eye = pose[:3, 3]
        if (eye > world.room[0]).all() and (eye < world.room[1]).all() and world.clearance(eye[None])[0] > 0.08:
            return Camera(K, config.width, config.height), inverse(pose)
    raise RuntimeError(f"no camera about {stage.name}")


def measure(name: str, config: Config, table: Table) -> None:
    """Rows of one scene."""
    rng = np.random.default_rng(7)
    world = build_world(name, 1)
    stage = world.stages[0]
    objects = arrangement(stage, rng)
    made: list[PathTracer] = []
    table.add_row(name, "scene", *_cells([cost(lambda: made.append(PathTracer(world, objects)))]))
    tracer = made[0]
    views = [camera_about(world, stage, rng, config) for _ in range(config.cameras)]
    first = cost(lambda: tracer.render(*views[0], Preset(4, 1)))
    table.add_row("", "first image", *_cells([first]))
    for preset in config.presets:
        costs = [cost(lambda view=view, preset=preset: tracer.render(*view, preset, 1)) for view in [views[0], *views]][
            1:
        ]
        table.add_row("", preset, *_cells(costs))
    _stages(tracer, views, table)


def _stages(tracer: PathTracer, views: list[tuple[Camera, np.ndarray]], table: Table) -> None:
    """Where the time of one image goes."""
    bop20 = PRESETS["bop20"]
    raw = Preset(bop20.samples_per_pixel, bop20.max_reflections, denoised=False)
    radiance = [tracer.radiance(*view, raw) for view in views]
    guides = [tracer.guides(*view) for view in views]
    table.add_row("", "  bop20: paths", *_cells([cost(lambda v=v: tracer.radiance(*v, raw)) for v in views]))
    table.add_row("", "  guides", *_cells([cost(lambda v=v: tracer.guides(*v)) for v in views]))
    table.add_row(
        "", "  denoising", *_cells([cost(lambda k=k: denoise(radiance[k], *guides[k])) for k in range(len(views))])
    )
    table.add_row("", "  tone mapping", *_cells([cost(lambda r=r: photograph(r)) for r in radiance]))
    table.add_row("", "object ids", *_cells([cost(lambda v=v: tracer.object_ids(*v)) for v in views]))


def _cells(costs: list[tuple[float, float]]) -> list[str]:
    return [f"{statistics.median(column):.2f}" for column in zip(*costs, strict=True)]


def quality(name: str, config: Config, table: Table) -> None:
    """PSNR of the developed pictures against one of 400 samples, with and without the denoiser."""
    rng = np.random.default_rng(7)
    world = build_world(name, 1)
    stage = world.stages[0]
    tracer = PathTracer(world, arrangement(stage, rng))
    view = camera_about(world, stage, rng, config)
    reference = tracer.render(*view, Preset(400, 3), 99)
    for samples in (4, 8, 16, 24, 36, 50):
        made = [tracer.render(*view, Preset(samples, 3, denoised), 1) for denoised in (False, True)]
        table.add_row(name, str(samples), *(f"{psnr(image, reference):.1f}" for image in made))


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB of 8-bit images."""
    error = np.mean((image.astype(float) - reference) ** 2)
    return float(10 * np.log10(255.0**2 / error))


def main(config: Config) -> None:
    """Print the tables."""
    console = Console()
    load = os.getloadavg()[0]
    console.print(f"{mitsuba().variant()}, {os.cpu_count()} cores, load {load:.1f}, {config.width} x {config.height}")
    table = Table("scene", "what", "wall s", "CPU s")
    for name in config.scenes:
        measure(name, config, table)
    console.print(table)
    if config.quality:
        table = Table("scene", "samples", "PSNR raw, dB", "PSNR denoised, dB")
        for name in config.scenes:
            quality(name, config, table)
        console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Config))
