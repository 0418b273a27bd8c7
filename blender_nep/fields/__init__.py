"""Stage 1: the object field F_o and the environment field F_e, learned together. `training.learn_fields` is the entry.

`object_sphere` and `seen_through` use the same parts for the search for cameras, which needs masks of the object.
"""
