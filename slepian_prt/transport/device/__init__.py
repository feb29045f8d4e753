"""Transport that stays where rays are traced: from hits to transfer vectors on Mitsuba's arrays, for CUDA."""
