"""A forest that can be flown: procedural trees, people, photos, flights with ground truth."""
