"""What a job knows about its scene. `scene` has the value that goes to every stage.

`photo_analysis` and `surface_analysis` look at the photos and at the mesh, and say which parts of the method the scene does
not need.
"""
