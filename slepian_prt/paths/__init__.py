"""How light is followed through a Mitsuba scene: materials, media, and paths from receivers to the distant light."""
