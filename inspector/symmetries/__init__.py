"""Candidates of global symmetries in the browser: looked at, accepted or refused, and written to `models_info.json`."""
