"""How good the finds are, where the truth is known: boxes in views, and persons on the ground."""
