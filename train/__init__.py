"""The recipe of `hsvaos/detect/person.onnx`: simulate, integrate, train, export (extra `train`)."""
