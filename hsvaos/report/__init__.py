"""What a run leaves on disk: pictures, arrays, finds, GeoTIFF and an HTML page."""
