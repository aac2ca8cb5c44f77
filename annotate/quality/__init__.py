"""How good the ground truth of a dataset is, judged by its own images (thesis sec. tless_gt_eval).

report = audit(open_dataset(path))
report.objects[0].depth.median_abs      # metres, the thesis's med_|delta|
report.suspects                         # worst first, with reasons
"""

from annotate.quality.agreement import Agreement, Sighting, agreements
from annotate.quality.audit import QualityConfig, audit
from annotate.quality.depth_difference import DepthDifferences, DepthStatistics
from annotate.quality.instances import ContourDistance, InstanceMeasures, measure_instances
from annotate.quality.report import InstanceQuality, ObjectQuality, QualityReport, Suspect
from annotate.quality.suspects import suspects

__all__ = [
    "Agreement",
    "ContourDistance",
    "DepthDifferences",
    "DepthStatistics",
    "InstanceMeasures",
    "InstanceQuality",
    "ObjectQuality",
    "QualityConfig",
    "QualityReport",
    "Sighting",
    "Suspect",
    "agreements",
    "audit",
    "measure_instances",
    "suspects",
]
