"""ObjectSynth: worlds, arrangements, cameras, sensors, renderers, and whole datasets made by them (thesis ch. synthesis)."""
