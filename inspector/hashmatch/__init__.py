"""What the inspector shows of HashMatch: how candidates thin out, windows, templates, swarms."""
