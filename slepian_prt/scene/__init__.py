"""What is rendered and with what: variants of Mitsuba, meshes, scenes, environments."""
