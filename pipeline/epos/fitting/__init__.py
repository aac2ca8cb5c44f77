"""Robust fitting of the poses of an object's instances to potential 2D-3D correspondences (thesis sec. epos_fitting).

`fit.fit_poses` is the entrance; `results.FittingTrace` records how it came to its answer. Two schemes stand behind it:
`pooled` (the default, the variant that measures best) and `progressive_x` (the thesis's own), both made of `primitives`.
"""
