"""How fast this machine is at each stage of the chain: the command `hsvaos bench`."""
