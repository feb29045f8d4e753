"""Transfer vectors clustered, projected on few functions, coded and filed."""
