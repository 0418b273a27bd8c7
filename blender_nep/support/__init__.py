"""The support plane on which an object stands, such as a table.

It is looked for in this order: `in_photos`, by its pattern; `at_foot`, by the shadow around the hull's foot; `in_mesh`, by
the rim at which the object's sphere cuts the mesh. `plane` is the plane itself. `foot` closes the object's foot on it.
`texture` has its colors, `agreed_colors` finds them for stage 1, and `light` for stage 2: what the object sees of the plane.
"""
