"""Transfer meets light.

Radiance of the receivers is in `operator`, `relight`, `damping` and `series`, which know nothing of what draws it;
`camera`, `pictures`, `outputs` and the integrator in `mitsuba` draw it on a mesh.
"""
