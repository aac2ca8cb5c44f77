"""Search for the global symmetries of a model: axes about which it can be turned and looks the same (thesis sec. symmetries)."""
