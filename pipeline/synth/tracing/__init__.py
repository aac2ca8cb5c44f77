"""Photorealistic rendering by path tracing with Mitsuba 3 (thesis sec. synth_pbr)."""
