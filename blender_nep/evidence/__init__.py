"""What photos show of a point: which photos, unhidden, at what angle, in what color, and whether they agree.

`observation` has the two questions, `visible` and `observe`; `occluders` what may hide a point; `small_photos` and
`full_photos` where colors come from; `agreement` the ways in which photos agree on a color; `sdf_grid` the SDF of an object
in the cells of a cube.
"""
