"""Templates that are rendered from the object models (thesis sec. Experimental Evaluation, "Templates and Parameters")."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.template_making import check_model, templates_of_views
from pipeline.hashmatch.template_source import PART, digest_of, parts_of
from pipeline.hashmatch.templates import Templates, joined
from pipeline.hashmatch.viewpoints import in_plane_angles, view_rotations, without_symmetric
from pipeline.hashmatch.views import fitting_distance, render_views
from pipeline.scene import Model


@dataclass(frozen=True)
class RenderedTemplates:
    """See `TemplateSource`; raises InputError for models that cannot be rendered."""

    models: Mapping[int, Model]
    """With colour, where there is one."""
    config: HashMatchConfig
    focal_px: float

    def digest(self, obj_id: int) -> str:
        """See `TemplateSource`."""
        config, model = self.config, self.models[obj_id]
        check_model(model)
        arrays = (model.normals, model.colors, model.texture, model.texture_uv)
        symmetries = model.symmetries if config.skip_symmetric_views and len(model.symmetries) > 1 else None
        return digest_of(model, config, self.focal_px, config.views, *arrays, symmetries)

    def parts(self, obj_id: int) -> list[int]:
        """See `TemplateSource`."""
        return parts_of(len(self._rotations(obj_id)), len(in_plane_angles(self.config)))

    def learn(self, obj_id: int, part: int) -> Templates:
        """See `TemplateSource`."""
        model = self.models[obj_id]
        check_model(model)
        rotations = self._rotations(obj_id)[part * PART : (part + 1) * PART]
        views = render_views(model, rotations, fitting_distance(model, self.focal_px), self.focal_px)
        colored = model.colors is not None or (model.texture is not None and model.texture_uv is not None)
        return templates_of_views(model, views, self.config, self.focal_px, colored)

    def _rotations(self, obj_id: int) -> Float[np.ndarray, "n 3 3"]:
        rotations = view_rotations(self.config)
        if self.config.skip_symmetric_views:
            return without_symmetric(rotations, self.models[obj_id], self.config.angle_step_deg)
        return rotations


def learn(model: Model, config: HashMatchConfig, focal_px: float) -> Templates:
    """All templates of an object, rendered, without a cache."""
    source = RenderedTemplates({model.obj_id: model}, config, focal_px)
    return joined([source.learn(model.obj_id, part) for part in range(len(source.parts(model.obj_id)))])
