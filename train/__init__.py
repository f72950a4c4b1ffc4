"""The recipe of the networks of `hsvaos/detect`: simulate, train, export (extra `train`)."""
