"""Scoring results as the BOP Challenge does: 6D localization and detection, SiSo, ADD, curves, several datasets."""
