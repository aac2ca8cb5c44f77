"""The scheme of the thesis: GC-RANSAC proposes instances, Progressive-X and PEARL consolidate them."""
