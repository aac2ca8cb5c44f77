"""The demo: eight parts modelled by code, the dataset of them, and made results.

python -m pipeline.synth.demo --out assets
"""
