"""How light is followed through a scene of Mitsuba."""
