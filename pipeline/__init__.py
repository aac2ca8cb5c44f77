"""The pipeline: BOP data, rendering, pose estimators, recording and evaluation (no viewer code)."""
