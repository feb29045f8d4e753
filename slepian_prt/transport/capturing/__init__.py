"""Transfer toward the pixels of a camera: one render, relit under any distant light."""
