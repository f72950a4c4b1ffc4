"""The recipe of the networks in `hsvaos/detect`: simulate, integrate, train, export (extra `train`)."""
