"""Following a ground-truth instance through the cascade, to say where it was lost."""
