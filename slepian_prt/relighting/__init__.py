"""Transfer meets light: radiance per vertex, coloured meshes and pictures."""
