"""Stage 2: materials that explain the photos under the light that reaches the mesh.

`training.learn_materials` is the entry.
"""
