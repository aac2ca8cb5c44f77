"""All that is known about one row of the target table: loaded and rendered when first asked for, and then kept."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from inspector.image_cache import LoadedImage
from inspector.layers import supersampled
from inspector.selection import RowKey, Selection
from inspector.workspace import Workspace
from pipeline.bop.errors import Mspd, Mssd, Pose, mspd, mssd
from pipeline.bop.vsd import TAUS, Vsd, vsd
from pipeline.exceptions import InputError
from pipeline.geometry import distance_from_depth, inverse
from pipeline.rendering import Box, Rendering, render, render_depths
from pipeline.scene import Camera, GroundTruth, Image, ImageKey, Model, PoseEstimate

Role = Literal["ground_truth", "estimate", "compared"]
ROLES: tuple[Role, ...] = ("ground_truth", "estimate", "compared")

FINE_PIXELS = 1_000_000
"""Overlays of images with up to this many pixels are drawn at twice the resolution."""


NEIGHBOURS_SHOWN = 100
"""Cameras of other images drawn in the 3D view; more are thinned out."""


class Instance(NamedTuple):
    """An object in the image besides the selected one."""

    model: Model
    camera_from_model: Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class Frame:
    """One row of the table for one browser; nothing in it changes, so it can be shared between threads."""

    workspace: Workspace
    row: RowKey
    method: int
    compare: int | None
    generations: tuple[int, int]
    """How often the two methods were assessed: before that their estimates are unknown, and a run grows."""

    @property
    def key(self) -> ImageKey:
        """The image of the row."""
        return ImageKey(self.row.scene_id, self.row.im_id)

    @cached_property
    def _loaded(self) -> LoadedImage:
        return self.workspace.images.get(self.key)

    @property
    def image(self) -> Image:
        """The image with its camera, as far as it can be read."""
        return self._loaded.image

    @property
    def problems(self) -> tuple[str, ...]:
        """What of the image cannot be read, one line each."""
        return self._loaded.problems

    @property
    def camera(self) -> Camera:
        """Camera of the image; InputError if it cannot be read."""
        return self.image.camera

    @cached_property
    def model(self) -> Model:
        """The object's model as used in evaluation."""
        return self.workspace.dataset.model(self.row.obj_id)

    @cached_property
    def ground_truth(self) -> GroundTruth | None:
        """The annotated instance; None for a row that has none."""
        if self.row.gt_index < 0:
            return None
        found = (gt for gt in self.annotations if gt.index == self.row.gt_index and gt.obj_id == self.row.obj_id)
        return next(found, None)

    @cached_property
    def annotations(self) -> tuple[GroundTruth, ...]:
        """All annotated instances of the image."""
        return self.workspace.dataset.ground_truth(self.key)

    @cached_property
    def estimate(self) -> PoseEstimate | None:
        """The estimate of the method under inspection that is held against the row."""
        return self.workspace.estimate_of(self.method, self.row)

    @cached_property
    def compared(self) -> PoseEstimate | None:
        """The estimate of the method compared with."""
        return None if self.compare is None else self.workspace.estimate_of(self.compare, self.row)

    @cached_property
    def others(self) -> tuple[Instance, ...]:
        """All other annotated instances of the image; where nothing is annotated, all other estimates."""
        shown = [(gt.obj_id, gt.camera_from_model) for gt in self.annotations if gt.index != self.row.gt_index]
        if not self.annotations and self.workspace.methods:
            results = self.workspace.methods[self.method].results
            estimates = [results.estimate(row) for row in results.rows(self.key).tolist() if row != self.row.estimate]
            shown = [(estimate.obj_id, estimate.camera_from_model) for estimate in estimates]
        models = self.workspace.dataset.model
        return tuple(Instance(models(obj_id), pose) for obj_id, pose in shown if self.has_model(obj_id))

    def pose(self, role: Role) -> Float[np.ndarray, "4 4"] | None:
        """`camera_from_model` in metres of the ground truth or an estimate; None where there is none."""
        holder = getattr(self, role)
        return None if holder is None else holder.camera_from_model

    @property
    def fineness(self) -> int:
        """How many times finer than the image its overlays are drawn."""
        return 2 if self.camera.width * self.camera.height <= FINE_PIXELS else 1

    @cached_property
    def fine_camera(self) -> Camera:
        """The image's camera with the pixels of the overlays."""
        return supersampled(self.camera, self.fineness)

    @cached_property
    def _silhouettes(self) -> dict[Role, Rendering]:
        poses: dict[Role, Pose] = {role: pose for role in ROLES if (pose := self.pose(role)) is not None}
        return {role: render(self.model, self.fine_camera, pose, pixel_center=0.0) for role, pose in poses.items()}

    @cached_property
    def _witnesses(self) -> dict[Role, tuple[Mssd, Mspd]]:
        truth = self.pose("ground_truth")
        found: dict[Role, tuple[Mssd, Mspd]] = {}
        for role in ROLES[1:] if truth is not None else ():
            pose = self.pose(role)
            if pose is not None and truth is not None:
                found[role] = (mssd(self.model, pose, truth), mspd(self.model, self.camera.K, pose, truth))
        return found

    def witnesses(self, role: Role) -> tuple[Mssd, Mspd] | None:
        """MSSD (metres) and MSPD (pixels of this image) of an estimate with the vertices that decide them."""
        return self._witnesses.get(role)

    def silhouette(self, role: Role) -> Rendering | None:
        """The model in the pose in pixels of `fine_camera`, cut to the box around it; None without a pose."""
        return self._silhouettes.get(role)

    @cached_property
    def other_silhouettes(self) -> tuple[Rendering, ...]:
        """The models of `others` in pixels of `fine_camera`."""
        return tuple(render(o.model, self.fine_camera, o.camera_from_model, pixel_center=0.0) for o in self.others)

    def edges(self, box: Box) -> tuple[float, float, float, float]:
        """Outer edges (left, top, right, bottom) of a box of `fine_camera`'s pixels, in pixels of the image."""
        left, top, right, bottom = ((x - 0.5 - (self.fineness - 1) / 2) / self.fineness for x in box)
        return left, top, right, bottom

    def rendered(self, role: Role) -> Rendering | None:
        """The model in the pose at the image's own pixels (centres at integers)."""
        pose = self.pose(role)
        return None if pose is None else render(self.model, self.camera, pose, pixel_center=0.0)

    @cached_property
    def _for_evaluation(self) -> list[Rendering]:
        """The model at the estimate and at the ground truth, sampled as the benchmark does."""
        found, truth = self.pose("estimate"), self.pose("ground_truth")
        assert found is not None
        assert truth is not None
        return render_depths(self.model, self.camera, np.stack([found, truth]))

    def vsd(self, tau: float, delta: float) -> Vsd:
        """VSD of the estimate with its maps at one misalignment tolerance; `tau` and `delta` in metres.

        Needs depth, a ground truth and an estimate.
        """
        return self._vsd([tau / self.model.diameter], delta)

    def vsd_values(self, delta: float) -> Float[np.ndarray, "10"]:
        """VSD at BOP's ten misalignment tolerances; `delta` in metres."""
        return self._vsd(TAUS, delta).values

    def _vsd(self, taus: Sequence[float], delta: float) -> Vsd:
        assert self.image.depth is not None
        estimate, truth = self._for_evaluation
        return vsd(estimate, truth, self.image.depth, self.camera.K, self.model.diameter, taus, delta)

    @cached_property
    def distance_test(self) -> Float[np.ndarray, "h w"]:
        """Measured distance from the camera centre, metres, 0 where not measured. Needs depth."""
        assert self.image.depth is not None
        return distance_from_depth(self.camera.K, self.image.depth)

    def visible_mask(self, gt_index: int) -> Bool[np.ndarray, "h w"] | None:
        """The dataset's mask of the visible part of an instance; None where it has none."""
        return self.workspace.dataset.mask(self.key, gt_index, visible=True)

    @cached_property
    def neighbours(self) -> tuple[tuple[int, Float[np.ndarray, "4 4"]], ...]:
        """Other images of the scene: id and pose of their cameras in this camera; empty without world poses."""
        if self.camera.world_from_camera is None:
            return ()
        camera_from_world = inverse(self.camera.world_from_camera)
        found = []
        for im_id in self.workspace.dataset.image_ids(self.key.scene_id):
            world_from_other = self.workspace.dataset.camera(ImageKey(self.key.scene_id, im_id)).world_from_camera
            if im_id != self.key.im_id and world_from_other is not None:
                found.append((im_id, camera_from_world @ world_from_other))
        return tuple(found[:: -(-len(found) // NEIGHBOURS_SHOWN) or 1])

    def has_model(self, obj_id: int) -> bool:
        """Whether the object's model can be read."""
        try:
            self.workspace.dataset.model(obj_id)
        except InputError:
            return False
        return True


def frame_of(workspace: Workspace, selection: Selection) -> Frame | None:
    """Return the frame of a selection; None where no row is selected."""
    if selection.row is None:
        return None
    generations = workspace.generation(selection.method), workspace.generation(selection.compare)
    return Frame(workspace, selection.row, selection.method, selection.compare, generations)
