"""What a run leaves for people to look at: pictures, GeoJSON, GeoTIFF, an HTML page."""
