"""Whole BOP datasets made from object models alone (thesis ch. synthesis): plan, images, files, resuming."""
