"""What `models_info.json` says of object models: read with their meshes, and its symmetries written, all else kept."""
