"""Render & paste: objects drawn by OpenGL over photographs or made-up backgrounds (thesis sec. synth_experiments)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from threading import Lock
from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from pipeline.exceptions import UnknownIdError
from pipeline.rendering import SceneRendering
from pipeline.scene import Camera, GroundTruth, Model
from pipeline.synth.augmentation import augment
from pipeline.synth.cameras.visibility import silhouette_pixels
from pipeline.synth.materials import random_color
from pipeline.synth.render_and_paste.backgrounds import Backgrounds, MadeUpBackgrounds, PhotoFolder
from pipeline.synth.render_and_paste.gl_context import require_opengl
from pipeline.synth.render_and_paste.lights import LightRanges, sample_light
from pipeline.synth.render_and_paste.pasting import PastedImage, merge, paste
from pipeline.synth.render_and_paste.placing import sample_poses
from pipeline.synth.render_and_paste.rasterizer import Drawing, Rasterizer
from pipeline.synth.render_and_paste.settings import PasteSettings, PasteSettingsError
from pipeline.synth.render_and_paste.shots import Painted

Pose = Float[np.ndarray, "4 4"]


_OPENING = Lock()
"""Held while a context is made, so that threads share one."""


class RenderAndPaste:
    """Makes training images, one per call; what an image shows depends on the generator alone.

    The OpenGL context is made by the first image, so an instance may be sent to other processes before that: each
    makes its own. A process that was forked after the first image cannot make images (GlError says so). Threads take
    turns.
    """

    def __init__(self, models: Sequence[Model], camera: Camera, settings: PasteSettings | None = None) -> None:
        """Check everything.

        Raises PasteSettingsError, MissingFileError for a folder without photographs, and GlError where OpenGL does not
        work, which is tried out in a child process once per program: that takes seconds.
        """
        if not models:
            raise PasteSettingsError("no models to render; give at least one")
        self._models = {model.obj_id: model for model in models}
        if len(self._models) < len(models):
            raise PasteSettingsError(f"two models of the same object among {[model.obj_id for model in models]}")
        self._camera = camera
        self._settings = settings or PasteSettings()
        folder = self._settings.backgrounds
        self._backgrounds: Backgrounds = (
            MadeUpBackgrounds() if folder is None else PhotoFolder(folder, self._settings.crop)
        )
        self._rasterizer: Rasterizer | None = None
        require_opengl()  # here, so that forked processes need not try it again

    def image(
        self,
        rng: np.random.Generator,
        poses: Sequence[tuple[int, Pose]] | None = None,
        camera: Camera | None = None,
    ) -> PastedImage:
        """Make an image: in random poses, or in given ones (object id, `camera_from_model`), as those of a PBR image.

        Given objects are annotated in their order, also those that are hidden or out of sight. `camera` replaces that
        of the constructor for this image.
        Raises UnknownIdError, PasteSettingsError for a pose that is no finite 4x4 matrix, GlError where OpenGL does not work.
        """
        camera, clock = camera or self._camera, _Clock()
        with clock.stage("poses"):
            placed = self._given(poses) if poses is not None else self._sampled(camera, rng)
            painted = [self._painted(model, pose, rng) for model, pose in placed]
            light = sample_light(self._settings.lights, rng)
        with clock.stage("drawing"):
            drawings = self._opened().draw(painted, camera, light)
        with clock.stage("annotating"):
            painted, drawings, scene = self._visible(painted, drawings, camera, keep_all=poses is not None)
            truths = tuple(_ground_truth(i, item, scene, camera) for i, item in enumerate(painted))
        with clock.stage("background"):
            background = self._backgrounds.image(rng, camera.width, camera.height)
        with clock.stage("pasting"):
            rgb = paste(background, drawings, scene, self._settings.edge_blur)
        with clock.stage("augmentation"):
            if self._settings.augmentation is not None:
                rgb = augment(rgb, rng, self._settings.augmentation)
        return PastedImage(rgb, camera, scene, truths, clock.seconds)

    def close(self) -> None:
        """Free the OpenGL context; a later image makes a new one."""
        rasterizer, self._rasterizer = self._rasterizer, None
        if rasterizer is not None:
            rasterizer.close()

    def __enter__(self) -> RenderAndPaste:
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the OpenGL context, which belongs to this process."""
        return {**self.__dict__, "_rasterizer": None}

    def _opened(self) -> Rasterizer:
        with _OPENING:
            if self._rasterizer is None:
                self._rasterizer = Rasterizer()
            return self._rasterizer

    def _given(self, poses: Sequence[tuple[int, Pose]]) -> list[tuple[Model, Pose]]:
        for obj_id, pose in poses:
            if obj_id not in self._models:
                raise UnknownIdError("object", obj_id, "the models to render", self._models)
            if np.shape(pose) != (4, 4) or not np.isfinite(pose).all():
                raise PasteSettingsError(f"pose of object {obj_id} is no finite 4x4 matrix; give camera_from_model")
        return [(self._models[obj_id], pose) for obj_id, pose in poses]

    def _sampled(self, camera: Camera, rng: np.random.Generator) -> list[tuple[Model, Pose]]:
        return sample_poses(list(self._models.values()), camera, self._settings, rng)

    def _painted(self, model: Model, pose: Pose, rng: np.random.Generator) -> Painted:
        ranges: LightRanges = self._settings.lights
        gloss, sharpness, color = rng.uniform(*ranges.gloss), rng.uniform(*ranges.sharpness), random_color(rng)
        uncolored = model.colors is None and model.texture is None
        repainted = self._settings.repaint == "all" or (self._settings.repaint == "uncolored" and uncolored)
        return Painted(model, pose, color if repainted else None, gloss, sharpness)

    def _visible(
        self, painted: list[Painted], drawings: list[Drawing], camera: Camera, keep_all: bool
    ) -> tuple[list[Painted], list[Drawing], SceneRendering]:
        """Leave out, one by one, the object of which others hide most, while that is too much."""
        scene = merge(drawings, camera)
        while not keep_all and len(painted) > self._settings.objects[0]:
            shares = [_seen(scene, i) for i in range(len(painted))]
            worst = int(np.argmin(shares))
            if shares[worst] >= self._settings.min_visible:
                break
            painted, drawings = painted[:worst] + painted[worst + 1 :], drawings[:worst] + drawings[worst + 1 :]
            scene = merge(drawings, camera)
        return painted, drawings, scene


class _Clock:
    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self.seconds[name] = perf_counter() - start


def _visible_crop(scene: SceneRendering, index: int) -> Bool[np.ndarray, "h w"]:
    return scene.instance_ids[scene.renderings[index].box.slices] == index


def _seen(scene: SceneRendering, index: int) -> float:
    """Share of the silhouette inside the image that no other object hides."""
    pixels = np.count_nonzero(scene.renderings[index].mask_crop)
    return float(np.count_nonzero(_visible_crop(scene, index)) / pixels) if pixels else 0.0


def _ground_truth(index: int, item: Painted, scene: SceneRendering, camera: Camera) -> GroundTruth:
    """Annotation with its visible fraction: of the whole silhouette, also where it reaches beyond the image (BOP)."""
    alone, visible = scene.renderings[index], _visible_crop(scene, index)
    pixels = int(np.count_nonzero(visible))
    whole = silhouette_pixels((item.model, item.camera_from_model), camera, alone) if pixels else 1
    bbox = (-1.0, -1.0, -1.0, -1.0)  # BOP's way of saying that nothing is seen
    if pixels:
        columns, rows = np.flatnonzero(visible.any(axis=0)), np.flatnonzero(visible.any(axis=1))
        x, y = alone.box.x0 + columns[0], alone.box.y0 + rows[0]
        bbox = float(x), float(y), float(columns[-1] - columns[0] + 1), float(rows[-1] - rows[0] + 1)
    truth = GroundTruth(item.model.obj_id, item.camera_from_model, index)
    return replace(truth, visible_fraction=pixels / whole, visible_pixels=pixels, bbox_visible=bbox)
