"""The flight in a browser: drag the focal surface through the forest (`hsvaos view`)."""
