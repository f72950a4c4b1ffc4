"""From integral images to people: detections in a view, and their places on the ground."""
