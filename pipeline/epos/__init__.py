"""EPOS: 6D poses of objects with symmetries from RGB, by surface fragments (thesis ch. method_epos)."""
