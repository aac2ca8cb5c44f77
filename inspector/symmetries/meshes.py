"""A model prepared for showing: in the size of the scene, with sharp edges, with its own colours, or cut finely."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.scene import Model

if TYPE_CHECKING:
    from trimesh import Trimesh

SHARP_EDGE = np.radians(35)
"""Faces at a larger angle get a sharp edge between them."""
FINE_EDGE = 0.025
"""Longest edge of the finely cut mesh, in scene units, so that distances within large faces show."""
GROWN = 0.0015
"""Scene units."""
MOST_SMOOTHED = 150_000
"""Faces; larger meshes are shown as they are."""


@dataclass(frozen=True, eq=False)
class ShownModel:
    """A model in scene units: its bounding sphere has about diameter 1, its middle is the origin."""

    middle: Float[np.ndarray, "3"]
    """Of the bounding box, model frame, metres."""
    scale: float
    """Scene units per metre."""
    vertices: Float[np.ndarray, "v 3"]
    """Repeated along sharp edges."""
    faces: Int[np.ndarray, "f 3"]
    grown_vertices: Float[np.ndarray, "v 3"]
    """A little outside the surface: drawn over it, they do not flicker."""
    fine_vertices: Float[np.ndarray, "w 3"]
    """Of the finely cut mesh."""
    fine_faces: Int[np.ndarray, "g 3"]
    own_look: "Trimesh | None"
    """With the model's colours or texture, None if it has none."""

    def in_scene(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the model frame (metres) in scene units."""
        return (points - self.middle) * self.scale

    def in_model(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Points of the scene in the model frame (metres)."""
        return points / self.scale + self.middle

    def pose(self, turn: Float[np.ndarray, "4 4"]) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "3"]]:
        """A transform of the model frame as quaternion (w x y z) and position in scene units."""
        from scipy.spatial.transform import Rotation

        shift = (turn[:3, :3] @ self.middle + turn[:3, 3] - self.middle) * self.scale
        return Rotation.from_matrix(turn[:3, :3]).as_quat(scalar_first=True), shift


def shown_model(model: Model) -> ShownModel:
    """Prepare a model for showing."""
    import trimesh

    used = model.vertices[np.unique(model.faces)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    scale = 0.5 / max(float(np.linalg.norm(used - middle, axis=1).max()), 1e-9)
    vertices = (model.vertices - middle) * scale
    mesh = trimesh.Trimesh(vertices, model.faces, process=False)
    if len(model.faces) <= MOST_SMOOTHED:
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        smooth = trimesh.graph.smooth_shade(mesh, SHARP_EDGE, None)
        fine = trimesh.remesh.subdivide_to_size(smooth.vertices, smooth.faces, FINE_EDGE, max_iter=20)
    else:
        smooth, fine = mesh, (vertices, model.faces)
    return ShownModel(
        middle=middle,
        scale=scale,
        vertices=np.asarray(smooth.vertices),
        faces=np.asarray(smooth.faces, np.int32),
        grown_vertices=np.asarray(smooth.vertices + GROWN * smooth.vertex_normals),
        fine_vertices=np.asarray(fine[0]),
        fine_faces=np.asarray(fine[1], np.int32),
        own_look=_own_look(model, vertices),
    )


def colored(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], colors: UInt8[np.ndarray, "v 3"]
) -> "Trimesh":
    """A mesh with a colour for each vertex, and smooth normals."""
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)
    _ = mesh.vertex_normals  # else the file would have none, and every face would be flat
    return mesh


def _own_look(model: Model, vertices: Float[np.ndarray, "v 3"]) -> "Trimesh | None":
    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if model.texture is not None and model.texture_uv is not None:
        material = PBRMaterial(baseColorTexture=Image.fromarray(model.texture), metallicFactor=0.0, roughnessFactor=1.0)
        visual = TextureVisuals(uv=model.texture_uv, material=material)
        mesh = trimesh.Trimesh(vertices, model.faces, visual=visual, process=False)
        _ = mesh.vertex_normals
        return mesh
    if model.colors is None:
        return None
    return colored(vertices, model.faces, model.colors)
