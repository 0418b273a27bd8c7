"""Finds the cameras of photos (structure from motion by pycolmap), and writes a capture with them.

`photo_folder` says what photos there are, `matching` is the process that runs pycolmap, `structure_from_motion`
starts and follows that process for each way of `ways`, `found_cameras` judges the result, and `written_capture` writes
transforms.json.
"""
