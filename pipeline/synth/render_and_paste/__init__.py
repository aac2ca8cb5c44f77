"""Render & paste: the baseline of training images (thesis sec. synth_experiments).

with RenderAndPaste(models, camera, PasteSettings(backgrounds=Path("photographs"))) as source:
    image = source.image(np.random.default_rng(7))           # objects in random poses
    image = source.image(rng, [(obj_id, camera_from_model)]) # in the poses of another image
image.rgb, image.depth, image.ground_truth, image.masks, image.visible_masks
"""

from pipeline.synth.render_and_paste.backgrounds import PhotoFolder
from pipeline.synth.render_and_paste.lights import LightError, LightRanges
from pipeline.synth.render_and_paste.painter import RenderAndPaste
from pipeline.synth.render_and_paste.pasting import PastedImage
from pipeline.synth.render_and_paste.scenery import made_up_scenery
from pipeline.synth.render_and_paste.settings import PasteSettings, PasteSettingsError, ViewRanges

__all__ = [
    "LightError",
    "LightRanges",
    "PasteSettings",
    "PasteSettingsError",
    "PastedImage",
    "PhotoFolder",
    "RenderAndPaste",
    "ViewRanges",
    "made_up_scenery",
]
