"""The image pyramid and its windows (thesis sec. Object Detection by Template Matching).

A level of scale s_w is the image made s_w times as large. A template that matches there shows the object at s_w times
the distance at which it was rendered (the thesis's test T1 says so, too; where it divides t_t by s_w, in sec.
Refinement, s_w is the inverse).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch import channels
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.level import Level
from pipeline.hashmatch.objectness import edgels
from pipeline.hashmatch.response_maps import spread
from pipeline.hashmatch.templates import Templates
from pipeline.scene import Image

LARGEST_LEVEL_PX = 4_000_000
"""Larger levels are not made: they would take gigabytes, and show hardly more than noise."""


@dataclass(frozen=True, eq=False)
class Base:
    """What is computed once per image."""

    image: Image
    depth: Float[np.ndarray, "h w"]
    distance: Float[np.ndarray, "h w"]
    normals: Float[np.ndarray, "h w 3"]
    """Relative to the viewing rays; zero where there is none."""
    normal_bits: UInt8[np.ndarray, "h w"]
    """One bit per pixel; 0 without normal."""
    normal_bins: UInt8[np.ndarray, "h w"]
    edgel: Bool[np.ndarray, "h w"]
    masked: Bool[np.ndarray, "h w"]
    """Pixels that matching leaves out: no distance and no normal there."""
    focal_px: float


def check_image(image: Image) -> None:
    """Raise InputError for an image on which HashMatch cannot work."""
    scene_id, im_id = image.key
    where, K = f"scene {scene_id}, image {im_id}", image.camera.K
    if image.depth is None:
        raise InputError(f"{where}: has no depth image, which HashMatch needs; run it on the images that have one")
    shape = (image.camera.height, image.camera.width)
    found = f"{image.depth.shape[1]} x {image.depth.shape[0]}"
    if image.depth.shape != shape:
        raise FormatError(f"{where}: depth image has {found} pixels, its camera {shape[1]} x {shape[0]}; register it")
    if image.rgb is not None and image.rgb.shape[:2] != shape:
        raise FormatError(f"{where}: colour and depth images differ in size ({found} pixels of depth); register them")
    if not (np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0):
        raise FormatError(f"{where}: K has focal lengths {K[0, 0]} and {K[1, 1]}; correct cam_K in scene_camera.json")
    if not (image.depth > 0).any():
        raise FormatError(f"{where}: its depth image is empty; check the file and depth_scale in scene_camera.json")


def prepare(image: Image, edgel_threshold: float, masked: Bool[np.ndarray, "h w"] | None = None) -> Base:
    """Compute what all levels share. Raises InputError for images that cannot be worked on.

    Masked pixels, which show what is known already, are left out of matching (thesis sec. Robotic Application: those
    of a gripper); their depth edges stay, as they are the outlines of what they hide.
    """
    check_image(image)
    assert image.depth is not None
    K = image.camera.K
    depth = np.nan_to_num(image.depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
    normals = channels.normals(depth, K)
    bins = channels.normal_bins(normals)
    distance = channels.distances(depth, K)
    hidden = np.zeros(depth.shape, bool) if masked is None else masked
    bins[hidden], distance[hidden] = channels.NONE, 0
    return Base(
        image=image,
        depth=depth,
        distance=distance,
        normals=normals,
        normal_bits=np.where(bins == channels.NONE, 0, 1 << (bins & 7)).astype(np.uint8),
        normal_bins=bins,
        edgel=edgels(depth, edgel_threshold),
        masked=hidden,
        focal_px=float(np.sqrt(K[0, 0] * K[1, 1])),
    )


def level_indices(base: Base, templates: Sequence[Templates], config: HashMatchConfig) -> list[int]:
    """Which levels to make.

    Those of the config, and with `fit_scales` as many more as objects at the measured distances need to fit the window.
    """
    lowest, highest = -config.scales_down, config.scales_up
    there = base.distance[base.distance > 0]
    if config.fit_scales and templates and len(there):
        measured = np.percentile(there, (2, 98))
        for own in templates:
            scales = measured / own.distance * own.focal_px / base.focal_px
            low, high = np.rint(np.log(scales) / np.log(config.scale_factor))
            lowest, highest = min(lowest, int(low)), max(highest, int(high))
    height, width = base.depth.shape
    fitting = range(max(lowest, -16), min(highest, 16) + 1)
    return [i for i in fitting if width * height * config.scale_factor ** (2 * i) <= LARGEST_LEVEL_PX]


def make_level(base: Base, index: int, config: HashMatchConfig) -> Level:
    """One level. Depth and normals are looked up, not interpolated, so that no surface appears between two."""
    scale, overhang = config.scale_factor**index, config.overhang_px
    height, width = base.depth.shape
    size = (max(1, round(width * scale)), max(1, round(height * scale)))

    def looked_up(values: np.ndarray, empty: int = 0) -> np.ndarray:
        resized = cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT)
        return np.pad(resized, overhang, constant_values=empty)

    def response(bits: np.ndarray) -> np.ndarray:
        found = spread(bits, config.neighborhood_px)
        found[masked] = 0
        return found

    masked = looked_up(base.masked.astype(np.uint8)) > 0
    bits, hue = _color_maps(base, size, config)
    return Level(
        index=index,
        scale=scale,
        size=size,
        overhang=overhang,
        distance=looked_up(base.distance),
        normal_bins=looked_up(base.normal_bins, channels.NONE),
        normal_response=response(looked_up(base.normal_bits)),
        gradient_response=response(np.pad(bits, overhang)),
        hue=np.pad(hue, overhang, constant_values=channels.NONE),
        edgel=looked_up(base.edgel.astype(np.uint8)) > 0,
        masked=masked,
        neighborhood=config.neighborhood_px // 2 * 2 + 1,
    )


def _color_maps(
    base: Base, size: tuple[int, int], config: HashMatchConfig
) -> tuple[UInt8[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
    rgb = base.image.rgb
    if rgb is None:
        return np.zeros(size[::-1], np.uint8), np.full(size[::-1], channels.NONE, np.uint8)
    resized = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA if size[0] < rgb.shape[1] else cv2.INTER_LINEAR)
    magnitude, orientation = channels.gradient_orientations(resized, config.gradient_threshold)
    return channels.gradient_bits(magnitude, orientation), channels.hues(resized)
