"""The effective dimension of light transport: how many functions it takes over neighbourhoods of a model."""
