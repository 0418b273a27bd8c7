"""Table 1 of the paper (Wang et al., CVPR 2024), as printed.

The scenes of the paper are its authors' own: other models in other rooms. The paper does not say how its Chamfer distance is
normalized. So the paper's figures stand beside ours only to show the form of the table and the order of magnitude.
"""

METHODS = ("Nerfacto", "NeuS", "NeRO", "NeP")
CHAMFER = {
    "Bunny": (0.05498, 0.00852, 0.00153, 0.00147),
    "Box": (0.07028, 0.03339, 0.00412, 0.00135),
    "Beethoven": (0.04038, 0.01706, 0.00197, 0.00146),
    "Suzanne": (0.05753, 0.00754, 0.00264, 0.00227),
    "Nefertiti": (0.05299, 0.01053, 0.00587, 0.00167),
    "Avg.": (0.05523, 0.01541, 0.00322, 0.00164),
}
"""Scene -> the Chamfer distance of each of METHODS."""
MATERIALS = {
    "Bunny": ((0.002, 0.022, 0.044), (0.002, 0.016, 0.022)),
    "Box": ((0.003, 0.068, 0.056), (0.001, 0.019, 0.067)),
    "Beethoven": ((0.007, 0.030, 0.031), (0.004, 0.026, 0.027)),
    "Suzanne": ((0.004, 0.030, 0.024), (0.001, 0.022, 0.029)),
    "Nefertiti": ((0.020, 0.103, 0.040), (0.008, 0.021, 0.035)),
    "Avg.": ((0.007, 0.051, 0.039), (0.003, 0.020, 0.036)),
}
"""Scene -> for each of the last two METHODS, the mean squared errors of roughness, metallic and albedo."""
