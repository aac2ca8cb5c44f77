"""The networks of EPOS: a backbone and a decoder that give features at each cell, and heads that read them."""
