"""What a user would pick instead of HashMatch: Open3D's global registration (FPFH features, RANSAC, ICP).

OpenCV's detector by point-pair features, `cv2.ppf_match_3d`, is a contrib module, which the opencv-python-headless that
is installed does not have (checked with 5.0.0).
"""

import numpy as np

from pipeline.geometry import points_from_depth
from pipeline.scene import Image, Model, Target


def registered(model: Model, image: Image, target: Target) -> list[tuple[int, np.ndarray]]:
    """Poses of a model in the whole cloud of an image, once per instance; explained points are taken away."""
    import open3d as o3d

    assert image.depth is not None
    voxel = model.diameter / 20
    o3d.utility.random.seed(0)
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(model.vertices), o3d.utility.Vector3iVector(model.faces)
    )
    source = mesh.sample_points_uniformly(20_000).voxel_down_sample(voxel)
    scene = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_from_depth(image.camera.K, image.depth)[0]))
    scene = scene.voxel_down_sample(voxel)
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=2.5 * voxel, max_nn=50)
    source.estimate_normals(search)
    registration, poses = o3d.pipelines.registration, []
    for _ in range(target.inst_count):
        scene.estimate_normals(search)
        scene.orient_normals_towards_camera_location()
        features = [
            registration.compute_fpfh_feature(cloud, o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel, max_nn=100))
            for cloud in (source, scene)
        ]
        found = registration.registration_ransac_based_on_feature_matching(
            source, scene, *features, True, 1.5 * voxel, registration.TransformationEstimationPointToPoint(False), 3,
            [registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
             registration.CorrespondenceCheckerBasedOnDistance(1.5 * voxel)],
            registration.RANSACConvergenceCriteria(100_000, 0.999),
        )  # fmt: skip
        found = registration.registration_icp(
            source, scene, voxel, found.transformation, registration.TransformationEstimationPointToPlane()
        )
        poses.append((model.obj_id, np.asarray(found.transformation)))
        placed = o3d.geometry.PointCloud(source)
        placed.transform(found.transformation)
        away = np.asarray(scene.compute_point_cloud_distance(placed)) > 1.5 * voxel
        scene = scene.select_by_index(np.flatnonzero(away).tolist())
    return poses
