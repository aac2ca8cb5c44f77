"""HashMatch: detection and 6D pose of texture-less objects in RGB-D images (thesis ch. HashMatch)."""
