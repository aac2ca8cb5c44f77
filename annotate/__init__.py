"""Ground-truth pose alignment and depth correction: pure functions and the edit session."""
