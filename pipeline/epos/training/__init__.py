"""Training the network of EPOS (thesis sec. epos_network_training)."""
