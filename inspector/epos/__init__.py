"""What the inspector shows of EPOS: probabilities, fragments, correspondences, hypotheses."""
