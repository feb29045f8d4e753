"""From a scene to transfer vectors: the effects plan, and what it asks to simulate."""
