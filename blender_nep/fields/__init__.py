"""Stage 1: the object field F_o and the environment field F_e, learned together. `training.learn_fields` is the entry.

`cameras.object_sphere` uses the same parts for the search for cameras. It uses no masks.
"""
