"""The Web GIS: tiles, features and images of what was made, and the viewer."""
