"""The 3D window of one browser, described by what should be in it: only what changed is sent.

All coordinates are those of the image's camera (OpenCV: x right, y down, z forward), in metres.
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from inspector.nodes import Cloud, ColoredMesh, Lines, Mesh, Node, Picture, Viewpoint
from inspector.viewport import plane_of
from pipeline.scene import ImageKey


class _Shown(NamedTuple):
    node: Node
    handle: Any


class Canvas:
    """Keeps the nodes of one browser's scene equal to the last drawing."""

    def __init__(self, client: viser.ClientHandle, on_pick: Callable[[ImageKey], None]) -> None:
        """Draw for one browser; `on_pick` is told the image whose camera was clicked."""
        self._client = client
        self._on_pick = on_pick
        self._shown: dict[str, _Shown] = {}
        self._lock = threading.Lock()

    def show(self, drawing: Mapping[str, Node]) -> None:
        """Make the scene hold exactly these nodes; names that stay are updated in place."""
        with self._lock, self._client.atomic():
            for name in self._shown.keys() - drawing.keys():
                self._shown.pop(name).handle.remove()
            for name, node in drawing.items():
                self._put(name, node)

    def set_visible(self, name: str, visible: bool) -> None:
        """Hide or show a node that is there, for blinking."""
        with self._lock:
            if name in self._shown:
                self._shown[name].handle.visible = visible

    def _put(self, name: str, node: Node) -> None:
        shown = self._shown.get(name)
        if shown is not None and type(shown.node) is type(node) and shown.node.token == node.token:
            same_look = _looks(shown.node) == _looks(node)
            if same_look or isinstance(node, Picture):
                if not same_look:
                    _place(shown.handle, node)
                shown.handle.visible = True
                self._shown[name] = _Shown(node, shown.handle)
                return
        # Adding under the same name replaces the node in the browser without a gap.
        handle = _ADD[type(node)](self._client.scene, f"/{name}", node)
        if isinstance(node, Viewpoint):
            handle.on_click(lambda _: self._on_pick(node.image))
        self._shown[name] = _Shown(node, handle)


def _looks(node: Node) -> tuple:
    """What of a node besides its token decides how it is shown."""
    match node:
        case Picture():
            return (node.z, node.edges, node.camera.width, node.camera.height, node.camera.K.tobytes())
        case Mesh():
            return (node.color, node.opacity, node.wireframe)
        case ColoredMesh():
            return ()
        case Cloud():
            return (node.size,)
        case Lines():
            return (node.color if isinstance(node.color, tuple) else None, node.width)
        case Viewpoint():
            return (node.scale,)


def _place(handle: Any, node: Node) -> None:
    assert isinstance(node, Picture)
    handle.render_width, handle.render_height, handle.position = plane_of(node.camera, node.z, node.edges)


def _add_picture(scene: viser.SceneApi, name: str, node: Picture) -> viser.ImageHandle:
    pixels = node.pixels()
    width, height, position = plane_of(node.camera, node.z, node.edges)
    transparent = pixels.shape[2] == 4
    return scene.add_image(
        name,
        pixels,
        width,
        height,
        format="png" if transparent else "jpeg",
        jpeg_quality=None if transparent else 95,
        cast_shadow=False,
        receive_shadow=False,
        position=position,
    )


def _add_mesh(scene: viser.SceneApi, name: str, node: Mesh) -> viser.MeshHandle:
    return scene.add_mesh_simple(
        name,
        node.vertices().astype(np.float32),
        node.faces.astype(np.uint32),
        color=node.color,
        opacity=None if node.opacity >= 1 else node.opacity,
        wireframe=node.wireframe,
        side="double",
        cast_shadow=False,
        receive_shadow=False,
    )


def _add_colored_mesh(scene: viser.SceneApi, name: str, node: ColoredMesh) -> viser.GlbHandle:
    import trimesh

    mesh = trimesh.Trimesh(node.vertices(), node.faces, vertex_colors=_linear(node.colors()), process=False)
    return scene.add_mesh_trimesh(name, mesh, cast_shadow=False, receive_shadow=False)


def _add_cloud(scene: viser.SceneApi, name: str, node: Cloud) -> viser.PointCloudHandle:
    points, colors = node.points()
    # float16 would round points at 1 m to half a millimetre.
    return scene.add_point_cloud(
        name,
        points.astype(np.float32),
        colors,
        point_size=node.size,
        point_shape="rounded",
        precision="float32",
        point_shading="flat",
    )


def _add_lines(scene: viser.SceneApi, name: str, node: Lines) -> viser.LineSegmentsHandle:
    return scene.add_line_segments(
        name, node.segments.astype(np.float32), _ends(node.color), thickness=node.width, thickness_units="screen"
    )


def _ends(color: tuple[int, int, int] | np.ndarray) -> tuple[int, int, int] | np.ndarray:
    """Colours of both ends of each segment, as viser wants them."""
    return color if isinstance(color, tuple) else _linear(color)[:, None].repeat(2, axis=1)


def _linear(colors: np.ndarray) -> np.ndarray:
    """Colours without the screen's gamma: for those the browser takes colours of vertices, which else look washed out."""
    return (255 * (colors / 255.0) ** 2.2).round().astype(np.uint8)


def _add_viewpoint(scene: viser.SceneApi, name: str, node: Viewpoint) -> viser.CameraFrustumHandle:
    rotation = Rotation.from_matrix(node.camera_from_other[:3, :3])
    return scene.add_camera_frustum(
        name,
        fov=2 * float(np.arctan(node.camera.height / (2 * node.camera.K[1, 1]))),
        aspect=node.camera.width / node.camera.height,
        scale=node.scale,
        thickness=1.5,
        thickness_units="screen",
        color=(110, 150, 220),
        cast_shadow=False,
        receive_shadow=False,
        wxyz=rotation.as_quat(scalar_first=True),
        position=node.camera_from_other[:3, 3],
    )


_ADD: dict[type, Callable[[viser.SceneApi, str, Any], Any]] = {
    Picture: _add_picture,
    Mesh: _add_mesh,
    ColoredMesh: _add_colored_mesh,
    Cloud: _add_cloud,
    Lines: _add_lines,
    Viewpoint: _add_viewpoint,
}
