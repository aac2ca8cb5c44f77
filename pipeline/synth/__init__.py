"""Synthesis: our own parts as code, physics, shading, sensors, and the demo dataset made from them."""
