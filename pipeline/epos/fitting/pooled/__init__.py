"""One search for all instances of an object: the default scheme."""
