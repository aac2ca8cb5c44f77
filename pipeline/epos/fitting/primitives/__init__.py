"""What both schemes are built of: correspondences laid out for speed, P3P, sampling, scoring, refinement (compiled)."""
