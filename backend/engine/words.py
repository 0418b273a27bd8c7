"""Puts the engine's messages into the words of Blender's panel, for an artist who has no command line. No bpy in this file.

The engine sends codes with values (blender_nep/messages.py), names of errors (blender_nep/errors.py), and its own English.
These tables hold the panel's English. If they lack what an engine of another version sends, the panel shows that engine's.

`translate` turns one text of these tables into another language. The add-on passes Blender's `pgettext_iface` when it
draws. Values are put in the place of `{...}` after the translation. docs/translating.md says how to add a language.
"""

import string
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from .printed_text import one_line

Translate = Callable[[str], str]

PARTS = {
    "environment field": "the surroundings",
    "color detail of the environment field": "fine detail of far surroundings",
    "mask term": "comparing with masks",
    "pixels outside the sphere": "pixels beside the object's sphere",
    "surface extraction": "making a mesh",
    "object field": "learning the shape",
    "irradiance": "diffuse light",
    "indirect light": "reflections of the object in itself",
    "second bounces": "light that the object reflects twice",
    "narrow cones": "sharp reflections",
    "unseen light": "light that no photo shows",
    "camera response": "the camera's tone curve",
    "object gains": "evening out how bright the object is from photo to photo",
    "photographer": "the photographer in the reflections",
    "further steps of both fields": "the rest of learning shape and light",
    "material boundaries": "boundaries between materials",
    "materials that vary from place to place": "materials that vary from place to place",
    "votes of all pixels": "finding the material of every pixel",
    "fine textures": "fine textures",
    "asking again whether it is metal": "checking again whether the object is metal",
    "support": "finding the table",
    "hull": "starting from the outline in all photos",
    "hidden_pixels": "finding things before the object",
    "fine_paint": "fine paint",
    "levels": "a finer grid for the shape",
    "carve": "cutting away what is not the object",
    "cavities": "opening the inside",
    "relief": "fine relief",
    "object_pixels": "finding the pixels of the object",
    "residual": "what materials leave unexplained",
    "spread": "how much the light of a metal varies",
    "hue": "the hue of reflections",
    "third_moment": "the reflections of colored paint",
    "regions": "what small places tell of metal and paint",
}
"""Parts of the work that the engine may leave out: the engine's name of a part -> the panel's words."""

MESSAGES = {
    # cameras that were found from photos alone
    "cameras.video": "Taking frames from the video ({percent:.0f} %)",
    "cameras.video_frames": "{count} of the {frames} frames of {video} became photos. Most cameras read the rows of a frame "
    "one after the other, which bends what moves: film slowly. Photos give better cameras.",
    "cameras.video_fast": "The camera moved fast: in many frames, the picture moves by {percent:.0f} % of its width in a "
    "second. Such frames are blurred and bent. Film more slowly",
    "cameras.video_damaged": "{count} of {frames} frames of the video cannot be read. It may be damaged, or not copied to "
    "its end",
    "cameras.video_interlaced": "The video is interlaced: each frame shows two moments. Film progressively (such as 30p), "
    "or deinterlace the video first",
    "cameras.video_hdr": "The video is HDR (HLG): its curve was undone as the standard says, but what the camera did to the "
    "contrast remains. Film without HDR, if you can",
    "cameras.photos": "Read {step} of {steps} photos",
    "cameras.surroundings": "Looked at the surroundings: {percent:.0f} %",
    "cameras.features": "Looked for details in {step} of {steps} photos",
    "cameras.matches": "Compared {step} of {steps} pairs of photos",
    "cameras.places": "Placed {step} of {steps} photos",
    "cameras.placed": "{count} of {photos} photos were placed. The details that they share agree within {error:.2f} pixels.",
    "cameras.turntable": "In {percent:.0f} % of the photos the surroundings stand still: taken as a turntable, so only "
    "details on what turned were used.",
    "cameras.by_masks": "Only details on the object of the masks were used, because those on the surroundings contradict "
    "them. The object may have turned on a turntable",
    "cameras.turntable_shifted": "In {percent:.0f} % of the photos the surroundings stand still, but shifted. "
    "Details of the surroundings were used, too. If the object turned on a turntable, put masks of the object into the "
    "folder masks",
    "cameras.turntable_unsure": "In {percent:.0f} % of the photos the surroundings stand still, but the cameras that were "
    "found move. If the object turned on a turntable, put masks of the object into the folder masks",
    "cameras.sure": "The cameras look right.",
    "cameras.not_placed": "{count} {count:photo was|photos were} not placed, because {count:it shares|they share} too few "
    "details with the others: {names}. Take more photos in between, or leave {count:it|them} out",
    "cameras.many_not_placed": "Only {count} of {photos} photos were placed, so a part of the object may be missing. The "
    "others share too few details with them: {list}. Take more photos in between, or take these out of the folder if the "
    "placed ones show the whole object",
    "cameras.next_way": "{count} of {photos} photos are placed so far: trying another way, which takes longer",
    "cameras.way_all_pairs": "The second way found them: finer details, and all photos compared with each other.",
    "cameras.way_affine": "The third way found them: details of surfaces that are seen at a grazing angle.",
    "cameras.groups": "The photos fall into {count} groups that share no details; the largest one is used. Take photos "
    "between the groups",
    "cameras.unsure": "The {count:place of this photo is|places of these photos are} unsure: {names}. Look whether "
    "{count:it is|they are} blurred, zoomed or cropped, or take more photos near {count:it|them}",
    "cameras.gap": "There is no photo within {degrees:.0f} degrees around the object, between {before} and {after}. Take "
    "some from there, if you can",
    "cameras.sphere": "Looking for the object",
    "cameras.sphere_unsure": "The object's place and size are a guess. Press Propose Bounds, and move and scale the sphere",
    "cameras.good_as_given": "The given cameras are kept: their features agree within {error:.2f} pixels already",
    "cameras.improved": "The cameras were improved: their features agree within {after:.2f} pixels instead of "
    "{before:.2f}. They were turned by {degrees:.3f} degrees and moved by {percent:.2f} % of their distance (medians)",
    "cameras.backup": "The cameras that were replaced are kept in the folder, in {file}.",
    "cameras.kept": "{count} {count:photo shows|photos show} too few points of the scene, and {count:keeps its|keep their} "
    "given {count:camera|cameras}: {names}",
    # warnings about a capture
    "capture.photos_rescaled": "{count} {count:photo differs|photos differ} in size from what the capture says, and "
    "{count:is|are} used all the same: {names}",
    "capture.frames_twice": "{count} {count:photo is|photos are} listed twice with the same camera: {names}",
    "capture.cameras_in_object": "{count} {count:photo is|photos are} left out: {count:its camera stands|their cameras "
    "stand} where the object is, as if no place had been found: {names}",
    "capture.two_forms": "{place} holds the model as binary and as text, and they differ: {used} counts ({photos} photos)",
    "capture.photos_without_pose": "{count} {count:photo is|photos are} left out, because {count:it has|they have} no "
    "camera pose or {count:is|are} disabled: {names}",
    "capture.angles_disagree": "The vertical angle of view of {count} {count:photo|photos} does not fit the horizontal "
    "one: it is not used ({names})",
    "capture.focal_lengths_differ": "The focal lengths across and down of {count} {count:photo|photos} differ by "
    "{percent:.0f} %, which no usual lens has: look whether the cameras are right ({names})",
    "capture.principal_point_off": "The principal point of {count} {count:photo|photos} is far from the middle (at "
    "{across:.0f} % of the width and {down:.0f} % of the height): look whether the cameras are right ({names})",
    "capture.distortion_large": "The lens distortion of {count} {count:photo|photos} is larger than that of any usual lens: "
    "look whether the cameras are right ({names})",
    "capture.view_angle_odd": "The angle of view of {count} {count:photo|photos} is {degrees:.1f} degrees, which no usual "
    "lens has: look whether the focal length is right ({names})",
    "capture.skew_large": "The pixels of {count} {count:photo|photos} are skewed by {percent:.1f} %, which no usual "
    "camera has: look whether the cameras are right ({names})",
    "capture.cameras_scaled": "{count} {count:camera is|cameras are} scaled: only {count:its rotation and its position "
    "are|their rotations and positions are} used ({names})",
    "capture.cameras_transposed": "The rows and columns of the cameras' matrices are swapped. They are read that way",
    "capture.world_to_camera": "The cameras are given from the world to the camera, and are read so: they fit each other "
    "and the photos better then",
    "capture.rotations_turned": "The rotations of the cameras are given from the world to the camera, and are read so: "
    "they fit each other and the photos better then",
    "capture.opencv_axes": "The cameras have OpenCV's axes (Y down, looking along +Z), and are read so: they fit each "
    "other and the photos better then",
    "capture.mitsuba_axes": "The cameras have Mitsuba's axes (X left, Y up, looking along +Z), and are read so: they fit "
    "each other and the photos better then",
    "capture.opengl_axes": "The cameras have OpenGL's axes, although the file says Mitsuba's, and are read so: they fit "
    "each other and the photos better then",
    "capture.realityscan_angles": "The angles in {file} are not those of RealityScan. They are read so that all cameras "
    "look at one place, with the tops of the photos up",
    "capture.cameras_of_upright": "The {count:camera is for a photo that EXIF turns|cameras are for photos that EXIF "
    "turns} upright, and {count:was|were} turned to the pixels as they are stored: {names}",
    "capture.brackets": "The {photos} photos seem to be brackets of {size} exposures each, {stops:.1f} stops apart: merge "
    "each bracket to one photo, or leave only one exposure of each",
    "capture.photos_missing": "{count} of {photos} photos {count:is|are} missing and {count:is|are} left out: {names}",
    "capture.several_models": "Of {models} COLMAP models the largest ({photos} photos) is used. The others have {others}",
    "capture.masks_unmatched": "No image in the folder of masks has a photo's name, such as {example}. They are not used",
    "capture.masks_found": "{count} of {photos} photos have a mask in {place}. Turn Use Masks off if {count:it is|they are} "
    "of something else",
    "capture.masks_beside": "{count} of {photos} photos have a mask beside them. Turn Use Masks off if {count:it is|they "
    "are} of something else",
    "capture.masks_other_size": "{count} {count:mask has|masks have} another size than {count:its photo|their photos}, and "
    "{count:is|are} not used: {names}",
    "capture.masks_dim": "No value in the masks is above {percent:.2g} % of white: that value counts as white",
    "capture.masks_background": "White in the masks covers the surroundings, and black the object: the masks are inverted. "
    "Turn Use Masks off if that is wrong",
    "capture.masks_turned": "{count} {count:mask is|masks are} black where the others are white, "
    "and {count:is|are} inverted: {names}",
    "capture.masks_labels": "The masks show {count} things in different colors: the color where the cameras look "
    "({color}) is taken as the object. Paint the object white and the rest black if that is wrong",
    "capture.masks_pictures": "The masks are pictures before one color ({color}): what has another color is taken as the "
    "object. Masks in black and white are more exact",
    "capture.masks_colors_unclear": "The masks are colored, and no color covers the borders: only their red channel "
    "counts. Paint the object white and the rest black",
    "capture.alpha_inverted": "The photos are transparent where the object is: their alpha is inverted, and the photos "
    "count as whole ones. Turn Use Masks off if that is wrong",
    "capture.masks_do_not_fit": "The masks are not used: seen from the places of their cameras, they show no common body "
    "(it would explain {percent:.0f} % of a mask). Look whether each mask is that of its photo",
    "capture.masks_hardly_fit": "The masks hardly fit each other: seen from the places of their cameras, a common body "
    "explains {percent:.0f} % of a mask. Look whether each mask is that of its photo, and whether the cameras are right",
    "capture.masks_full": "{count} {count:photo|photos} left out: {count:its mask is|their masks are} white "
    "everywhere: {names}",
    "capture.alpha_usable": "The transparent pixels of the photos are not their surroundings: they ({percent:.1f} % of a "
    "photo) are left out, and the object is found without masks. Turn Use Masks off if that is wrong",
    "capture.masks_rescaled": "{count} {count:mask has|masks have} another size than {count:its photo|their photos}, and "
    "{count:is|are} scaled: {names}",
    "capture.masks_other_kind": "The files in {place} cannot be read as masks ({kinds}): save them as PNG",
    "capture.masks_usable": "White in the masks is not the object but what may be used: the black pixels ({percent:.1f} % "
    "of a photo) are left out. Turn Use Masks off if that is wrong",
    "capture.masks_not_used": "The masks are not used: {percent:.0f} % of a photo is black, and white does not show the "
    "object",
    "capture.masks_white": "The masks are not used: they are white everywhere, so they do not show the object",
    "capture.masks_one_for_all": "All photos have the same mask, so it cannot show the object",
    "capture.masks_alike": "All masks are the same picture: look whether they show the object. Turn Use Masks off if not",
    "capture.masks_unclear": "It is not clear what white in the masks means ({percent:.0f} % of a photo). It is taken as "
    "the object. Look at the masks, and turn Use Masks off if they show something else",
    "capture.masks_doubtful": "The masks are not used: white covers {percent:.0f} % of a photo and is not the object, and "
    "black may be the object or not. Paint the object white and the rest black, if you need the masks",
    "capture.masks_as_told": "White in the masks means {meaning}, as was asked for, although the masks look otherwise",
    "capture.same_place": "{count} {count:photo was|photos were} taken from the same place in the same direction as others "
    "and {count:adds|add} nothing to the shape: {names}",
    "capture.exr_is_linear": "OpenEXR photos are taken as linear, although the capture says sRGB",
    "capture.half_a_sphere": "The capture names only a center or only a radius of the object's sphere: it is ignored",
    "capture.masks_disagree": "The masks contradict each other: the object's sphere is estimated from the cameras",
    "capture.sphere_not_seen": "{count} of {photos} photos {count:does|do} not see the object's sphere: {names}",
    "capture.cameras_far": "The cameras are {radii:.0f} object radii away: the object is small. Are the bounds too small?",
    "capture.sphere_cut": "Most photos see less than half of the object's sphere. Are the bounds too large?",
    "capture.exposure_unclear": "The photos may differ in exposure, but show too little of the same surroundings to tell: "
    "if the camera was on automatic, take or develop them with one exposure",
    "capture.exposure_guessed": "The exposure of {count} {count:photo|photos} is a guess: {count:it shows|they show} hardly "
    "any of the surroundings that others show",
    "capture.pixels_not_finite": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:holds|hold} no "
    "valid number and {pixels:is|are} left out: {names}",
    "capture.pixels_negative": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:is|are} negative "
    "and {pixels:is|are} taken as black: {names}",
    "capture.pixels_too_bright": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:is|are} brighter "
    "than {limit:.0f} and {pixels:is|are} set to that value: {names}",
    "capture.photos_black": "{count} {count:photo is|photos are} black and {count:is|are} left out: {names}",
    "capture.photos_reduced": "There are {photos} photos, so each is scaled down to {pixels} pixels",
    "capture.masks_missing": "Masks are not used: {count} {count:photo has|photos have} none ({names})",
    "capture.alpha_for_mask": "{count} {count:photo has|photos have} no mask, unlike the others. {count:Its|Their} "
    "transparent pixels tell where the object is ({names})",
    "capture.masks_lacking": "{count} {count:photo|photos} left out: {count:it has|they have} no mask, unlike the others "
    "({names})",
    "capture.masks_empty": "{count} {count:photo|photos} left out: {count:its mask is|their masks are} empty: {names}",
    "capture.cut_outs_need_masks": "The photos are cut-outs and their surroundings are black: results need the masks",
    "capture.few_photos": "Only {photos} photos: 20 and more give a better shape",
    "capture.few_directions": "The cameras cover few directions: what no photo shows will be guessed",
    "capture.hole_above": "No photo was taken within {degrees:.0f} degrees of straight above",
    "capture.hole_below": "No photo was taken within {degrees:.0f} degrees of straight below",
    "capture.hole_beside": "No photo was taken within {degrees:.0f} degrees of azimuth {azimuth:.0f}, elevation "
    "{elevation:.0f}: take some between {before} and {after}",
    "capture.photos_blurred": "{count} {count:photo is|photos are} clearly more blurred than the photos beside "
    "{count:it|them}: {names}. Leave {count:it|them} out or take {count:it|them} again",
    "capture.other_light": "{count} {count:photo was|photos were} taken in another light than the others, and "
    "{count:is|are} left out: {names}. To learn from them all the same, choose Use All Photos under Advanced",
    "capture.photos_darker": "{count} {count:photo is|photos are} up to {stops:.1f} stops darker than the others: {names}. "
    "Develop all photos with one exposure, or leave {count:it|them} out",
    "capture.photos_brighter": "{count} {count:photo is|photos are} up to {stops:.1f} stops brighter than the others: "
    "{names}. Develop all photos with one exposure, or leave {count:it|them} out",
    "capture.sphere_clipped": "{percent:g} % of the pixels around the object are burnt out: expose less, or take photos "
    "with a larger range (raw, OpenEXR)",
    "capture.cameras_look_away": "The object's center is not in the picture of {count} {count:photo|photos}: {names}. Look "
    "whether {count:its camera is|their cameras are} right",
    "capture.cameras_near": "{count} {count:camera stands|cameras stand} much nearer to the object than the others: "
    "{names}. Look whether {count:its place is|their places are} right",
    "capture.cameras_distant": "{count} {count:camera stands|cameras stand} much farther from the object than the others: "
    "{names}. Look whether {count:its place is|their places are} right",
    "capture.sphere_small": "The object's sphere is only about {pixels:.0f} pixels wide in the photos: go nearer, use "
    "larger photos, or make the bounds smaller if the object is smaller",
    "capture.sphere_at_edges": "{percent:.0f} % of the photos cut off a part of the object's sphere: if the bounds are not "
    "too large, step back, so that the photos show the whole object and its surroundings",
    "capture.on_turntable": "In {percent:.0f} % of the photos the surroundings stand still although the cameras differ: "
    "taken as a turntable, on which the object turned. If you walked around the object, choose No in Advanced > On a "
    "Turntable",
    "capture.turntable_side": "The capture does not say how far the turntable had turned between the {rows} places of the "
    "camera: they are taken to be on the same side of the object",
    "capture.turntable_unfit": "The cameras do not fit a turntable, so a reconstruction would end: {reason}",
    "capture.turntable_left_out": "{count} {count:photo was|photos were} left out, because the camera did not stand still "
    "for at least 3 photos: {names}",
    "capture.highlights_clipped": "8-bit photos clip highlights: mirror-like parts will come out darker than they are",
    "capture.cut_outs": "Cut-outs show no surroundings: light can be learned from reflections alone",
    # warnings of a job
    "job.preview_ended": "There is no live preview any more: {reason}",
    "job.run_file_damaged": "The checkpoint is damaged: the job starts from its beginning",
    "job.result_damaged": "A finished part of the job is damaged, and is done again: {file}",
    "job.checkpoint_damaged": "A checkpoint is damaged and cannot be used: {file}",
    "job.steps_left_out": "{count} {count:step|steps} of learning shape and light {count:was|were} left out: the numbers "
    "were not finite",
    "job.cut_by_sphere": "The object reaches out of its bounds and is cut there ({percent:.0f} % of the surface is the "
    "cut): make the bounds larger, and reconstruct it again",
    "job.metal_unclear": "The photos hardly show whether the object is metal: if the result is wrong, choose it in "
    "Advanced > Material",
    "job.photos_not_explained": "The result does not explain its photos: {decibels:.1f} dB, and hues differ by "
    "{degrees:.1f} degrees. A usable one has at least {least:.0f} dB, and at most {most:.0f} degrees: shape, materials or "
    "light are wrong. Look at it beside its photos. Were all of them taken in one light? Then try the preset Balanced, or "
    "masks",
    "job.surroundings_not_explained": "The recovered light explains what the photos show beside the object to "
    "{decibels:.1f} dB only, and {least:.0f} dB is the least that usable light has: do not trust the materials. Were all "
    "photos taken in one light, and did nothing move? Look whether the cameras are right",
    # what a batch says
    "batch.looking": "Looking at capture {step} of {steps}",
    "batch.passed_over": "{count} {count:folder is|folders are} passed over, because {count:it holds|they hold} neither a "
    "capture nor photos (in itself or in images): {names}",
    "batch.captures_beside_photos": "{count} {count:folder with a capture or photos is|folders with captures or photos "
    "are} passed over, because the folder around {count:it|them} holds photos itself: choose {count:it|them}, too "
    "({names})",
    "batch.photos_deeper": "There are photos in {names}. Choose {count:that folder|these folders} to reconstruct them, too",
    "batch.progress": "{done} of {objects} objects are done, {running} running, {waiting} waiting, {failed} failed",
    "batch.object_done": "{name} is done in {time}: {faces} faces, {materials} {materials:material|materials}",
    "batch.object_failed": "{name} has failed: {reason}",
    "batch.object_stopped": "{name} has stopped",
    "batch.tried_again": "{name} is tried again: {reason}",
    "batch.alone": "{name} may need {needed} MB, and there are {memory} MB: it runs alone. If it fails, choose the preset "
    "Preview or smaller photos",
    "batch.put_back": "{name} waits for its turn again, because another object needs more memory than expected",
    "batch.leftovers": "{count} {count:job|jobs} of a batch that was killed {count:is|are} still ending",
    "batch.no_gallery": "The gallery cannot be written: {reason}",
    "batch.stopping": "Stopping {count} {count:job|jobs}",
    # notes on progress
    "progress.warming_up": "Warming up",
    # sentences about the scene
    "scene.surroundings": "The photos ({photos}) show the object among its surroundings, which are learned as its light.",
    "scene.cut_outs": "The photos ({photos}) are cut-outs: the light is learned from the object's reflections alone.",
    "scene.turntable": "The object turned, and the camera and the light stood still. environment.exr is the light around "
    "the object as it stood in the first photo.",
    "scene.masks_used": "Masks are there and are used.",
    "scene.masks_not_used": "No masks are used: the object is where the photos do not look like its surroundings.",
    "scene.object_clipped": "{percent:g} % of the object's pixels are burnt out and say nothing about the material.",
    "scene.sphere_clipped": "{percent:g} % of the pixels around the object are burnt out and do not show the material.",
    "scene.high_range": "The photos hold highlights brighter than white (HDR), and hardly any is burnt out.",
    "scene.hardly_clipped": "The photos end at white, but hardly a pixel is burnt out.",
    "scene.vignetting": "The photos are darker towards their corners (by {stops:.1f} stops), which is evened out.",
    "scene.curve_undone": "The different exposures show the camera's tone curve, which is undone.",
    "scene.exposure_differs": "The photos differ in exposure (by up to {stops:.1f} stops), which is evened out.",
    "scene.white_balance_differs": "The photos differ in white balance, which is evened out.",
    "scene.exposure_and_white_balance_differ": "The photos differ in exposure (by up to {stops:.1f} stops) and white "
    "balance, which is evened out.",
    "scene.sphere_size": "The object's sphere is {pixels:.0f} pixels wide and takes {percent:g} % of the photos.",
    "scene.object_size": "The object's sphere is {pixels:.0f} pixels wide and takes {percent:g} % of the photos; "
    "{object_percent:g} % of that is the object.",
    "scene.convex": "The object is convex.",
    "scene.reflects_little_in_itself": "The object hardly reflects in itself ({percent:g} % of all directions).",
    "scene.reflects_in_itself": "The object reflects in itself ({percent:g} % of all directions).",
    "scene.glossy": "Its brightness changes much from photo to photo: it is glossy.",
    "scene.hardly_glossy": "Its brightness changes a little from photo to photo: it is hardly glossy.",
    "scene.matte": "Its brightness hardly changes from photo to photo: it is matte.",
    "scene.explains_photos": "The result explains its photos to {decibels:.0f} dB; hues differ by {degrees:.0f} degrees.",
    "scene.explains_held_out": "The result explains held-out photos to {decibels:.0f} dB; hues differ by "
    "{degrees:.0f} degrees.",
    "scene.surroundings_explained": "The recovered light explains what they show beside the object to {decibels:.0f} dB.",
    "scene.acted": "Improved by: {parts:parts}.",
    "scene.left_out": "Left out: {parts:parts}, because {reason}.",
    "scene.left_out_saving": "Left out: {parts:parts}, because {reason} (saves about {seconds:.0f} s).",
    # reasons for leaving something out; they stand in the place of {reason} in the two sentences above
    "reason.cut_outs": "the photos are cut-outs",
    "reason.near_surroundings": "the surroundings are near",
    "reason.metal": "the object is metal",
    "reason.convex": "the object is convex",
    "reason.reflects_little_in_itself": "the object hardly reflects in itself",
    "reason.matte": "the object is matte and mirrors nothing",
    "reason.masks_ignored": "Use Masks is off",
    "reason.no_masks": "the capture has no masks",
    "reason.sphere_fills_photos": "the object's sphere fills all photos",
    "reason.mesh_given": "Known Mesh names a mesh",
    "reason.plateaued": "the error on pixels that are not learned from did not fall any more",
    "reason.palette_explains": "a few materials explain the photos",
    "reason.one_material": "one material explains the photos",
    "reason.metal_known": "the photos have already decided it clearly",
    "reason.light_seen": "the photos show all light that matters",
    "reason.preset": "the preset turns it off",
    "reason.class_chosen": "it was chosen whether the object is metal",
    "reason.no_metal": "nothing is metal",
    "reason.all_metal": "all of the object is metal",
    "reason.evidence_silent": "it says nothing of these materials",
    "reason.light_changes_fast": "light changes too fast between the samples of a photo",
    "reason.found_nothing": "nothing was found",
    "reason.few_pixels_beside": "the photos show too little beside the object",
    "reason.turntable_hides": "the photos of a turntable do not show what is behind the object",
    "reason.masks_show_outline": "the masks show the outline",
    "reason.no_hull": "the shape does not start from an outline",
    "reason.levels_there": "the shape has them already",
    "reason.wide_pixels": "the photos have too few pixels for it",
    "reason.curve_told": "the photos' exposures have told it before",
    "reason.equally_bright": "it is as bright in all photos",
    "reason.object_turned": "the object turned in its light",
    "reason.too_few_photos": "there are too few photos",
    "reason.no_photographer": "the photos show nobody who takes light",
    "reason.linear_photos": "the photos hold linear values",
    "reason.no_tone_curve": "the photos show none",
    "reason.light_not_shown": "the photos show too little of the light",
    "reason.turntable": "the object turned in the light",
    "reason.no_self_reflection": "the object does not reflect in itself",
}

ERRORS = {
    "engine.missing": ("", "Install the engine in the add-on's preferences, or name a Python that has it there."),
    "usage.no_cuda": ("No CUDA device can be used", "Choose the device CPU; everything runs on the CPU too."),
    "usage.asset_exists": ("{folder} already holds a result", "Choose another output folder, or Start Again."),
    "usage.run_exists": ("{folder} holds a job that did not end", "Resume it, or Start Again."),
    "usage.folder_in_use": (
        "The engine is at work in {folder} already",
        "Stop it or wait for its end, or choose another output folder.",
    ),
    "usage.cameras_exist": (
        "{folder} has cameras already",
        "Use them, or press Find Cameras Again in Cameras and Bounds, which replaces them. To take other frames of a video, "
        "choose the video again with Overwrite.",
    ),
    "usage.no_masks": ("Each photo needs a mask for this", "Put the masks into {folder}."),
    "unexpected.no_pyav": ("The installed engine cannot read videos", "Install the engine again in the preferences."),
    "unexpected.no_pycolmap": ("The installed engine cannot find cameras", "Install the engine again in the preferences."),
    "capture.photos_not_there": (
        "{count} of {photos} photos {count:is|are} missing: {names}",
        "Put {count:it|them} into {folder}. At least 3 photos are needed.",
    ),
    "capture.foreign_cameras": (
        "{folder} holds cameras of {program} ({file}) that cannot be read",
        "Export them in another form, such as a COLMAP project, or press Find Cameras.",
    ),
    "capture.photos_of_other_kinds": (
        "{folder} holds {photos} photos that cannot be read ({kinds})",
        "Convert them to PNG, TIFF or JPEG of the best quality.",
    ),
    "capture.no_cameras": ("{folder} holds {photos} photos, but no cameras", "Press Find Cameras first."),
    "capture.video": ("{folder} holds a video ({video}), but no photos or too few", "Press Find Cameras first."),
    "capture.several_videos": (
        "{folder} holds {videos} videos, and no photos or too few",
        "Press From a Video, and choose one of them.",
    ),
    "capture.video_unreadable": (
        "{video} cannot be read as a video ({reason})",
        "It may be damaged, or not copied to its end. MP4, MOV, MKV, WebM, AVI, MTS and WMV files are read.",
    ),
    "capture.no_video_stream": ("{video} holds no video", "Choose a video of the object."),
    "capture.video_size": ("The frames of {video} have {size} pixels, which cannot be read", "Save it in another size."),
    "capture.video_size_changes": (
        "The frames of {video} change their size within the video",
        "Cut the video where its size changes, and use one part.",
    ),
    "capture.video_colors": (
        "",
        "Film without HDR (no HDR10, no Dolby Vision, no log), or convert the video to SDR (BT.709).",
    ),
    "capture.video_without_frames": (
        "No frame of {video} can be read",
        "The file may be damaged, or not copied to its end.",
    ),
    "capture.video_too_still": (
        "{video} shows hardly more than one view: the camera stands still",
        "Walk around the object while you film it, and film its surroundings, too.",
    ),
    "capture.photos_elsewhere": ("{folder} holds the photos ({photos})", "Choose that folder."),
    "capture.too_few_photos": (
        "There {photos:is|are} {photos} {photos:photo|photos} in the folder: at least 3 are needed",
        "40 photos and more, all around the object, work well.",
    ),
    "capture.cameras_not_found": (
        "",
        "Put the object on a sheet with a print (a newspaper, a patterned cloth), let things stand around it, and take 40 "
        "photos or more that overlap by two thirds.",
    ),
    "capture.photo_unreadable": (
        "",
        "Take {photo} out of the folder, or copy it there again. It may be damaged, or not copied to its end.",
    ),
    "capture.mask_size": (
        "The mask {mask} has {mask_size} pixels, but its photo {photo} has {photo_size}",
        "Save the mask with the size of its photo, as the photo's file stores it: not turned. Or take it out of the folder.",
    ),
    "capture.folder_unreadable": (
        "{folder} cannot be read ({reason})",
        "Change its permissions, or copy the photos to another folder and choose that one.",
    ),
    "capture.cameras_not_improved": (
        "The cameras cannot be improved: only {placed} photos share details that fit them",
        "The photos show too little, or the cameras are wrong. Press Find Cameras Again, which does not need them.",
    ),
    "capture.lens_not_improved": (
        "The cameras have a lens model (k4 or a skew) that cannot be improved",
        "Use them as they are, or press Find Cameras Again.",
    ),
    "output.no_working_files": (
        "The system's folder for temporary files cannot be written ({reason})",
        "Change its permissions, or let the system's variable TMPDIR name another folder, and start Blender again.",
    ),
    "capture.turntable_no_rows": (
        "The camera stood still in only {kept} of {photos} photos: they are not from a turntable",
        "If you walked around the object, choose No in Advanced > On a Turntable. Else photograph again with the camera on "
        "a tripod.",
    ),
    "capture.turntable_row_moved": (
        "The camera did not stand still in a row of the turntable: {names}",
        "Correct the rows in the capture's file, or take them out, so that they are found from the cameras.",
    ),
    "usage.too_many_held_out": (
        "Of {photos} photos, only {learned} are left to learn from",
        "Hold fewer photos out.",
    ),
    "usage.no_mesh": ("There is no mesh {path}", "Check Advanced > Known Mesh."),
    "usage.report_damaged": ("{path} is damaged", "Start Again."),
    "usage.other_version": (
        "The job in {folder} was made by another version of the engine and cannot be resumed",
        "Finish it with that version, or Start Again.",
    ),
    "usage.unknown_run": (
        "Nothing shows that {folder} was made by the engine",
        "Choose another output folder, or move that folder away.",
    ),
    "usage.not_ours": (
        "{folder} holds {files}, and nothing shows that the engine has written that",
        "Choose another output folder, or move these files away.",
    ),
    "usage.output_is_capture": (
        "{folder} cannot be the output folder, because the job reads {path}",
        "Choose a folder of its own.",
    ),
    "usage.object_name": (
        "{path} calls an object {object}, which is no name of a folder of its own",
        "Somebody has changed the file. Choose another output folder.",
    ),
    "usage.other_run": (
        "The job in {folder} was begun with other settings and cannot be resumed: {different}",
        "Use the same capture and settings as then, or Start Again.",
    ),
    "usage.no_asset": ("{folder} holds no finished result", "Choose the folder of a finished reconstruction."),
    "usage.asset_of_other_version": (
        "The result in {folder} was made by another version of the engine and cannot be corrected",
        "Reconstruct it again to correct its materials.",
    ),
    "usage.no_such_material": ("There is no material {number} in this result; it has {count}", "Import the result again."),
    "usage.not_correctable": (
        "The folder checkpoints of {folder} is not complete, so its materials cannot be corrected",
        "Reconstruct it again to correct its materials.",
    ),
    "usage.told_to_be_metal": (
        "The job was told that the object is metal, so it has not gathered the light that other materials need",
        "Set Material to From the Photos or Not Metal, and press Start Again.",
    ),
    "usage.no_captures": ("There are no captures in {path}", "Choose capture folders, or a folder that holds captures."),
    "usage.no_list": ("{path} is no list of folders", "Choose capture folders, or a folder that holds captures."),
    "usage.batch_damaged": (
        "{path} is damaged",
        "Choose another output folder, or choose all captures and Start All Again.",
    ),
    "usage.other_batch": (
        "The batch in {folder} was started with other settings: {different}",
        "Use the same settings as then, choose another output folder, or choose all captures and Start All Again.",
    ),
    "objects_failed": ("Some objects failed: {names}", "The list says why. Reconstruct Shelf tries only these again."),
    "bounds": ("", "Press Propose Bounds. Then move and scale the sphere: the whole object inside, no camera inside."),
    "output.is_a_file": ("{path} is a file, not a folder", "Choose another output folder."),
    "output.is_a_link": (
        "{path} is a link, and nothing is written through a link",
        "Remove the link, or choose another output folder.",
    ),
    "output.disk_full": ("The disk is full: {path} cannot be written", "Free some space, then Resume."),
    "output.not_permitted": (
        "{path} may not be written ({reason})",
        "Choose another output folder, or change its permissions.",
    ),
    "output": ("", "Choose another output folder."),
    "learning.diverged": ("", "Try another Seed, or another preset."),
    "learning.not_finite": ("", "Check the photos for extreme values, and the bounds of the object."),
    "learning.no_surface": (
        "",
        "Check the bounds: the sphere must just hold the object. Masks, or a longer preset, may help too.",
    ),
    "stopped": ("Stopped. The checkpoint is written", "Resume goes on from there."),
    "stopped.input_closed": ("Stopped because Blender closed. The checkpoint is written", "Resume goes on from there."),
    "stopped.reading_photos": ("Stopped while the photos were read", "Resume starts again."),
    "stopped.cameras": ("Stopped. No cameras were written", "Press the button again."),
    "stopped.batch": ("Stopped. The checkpoints are written", "Reconstruct Shelf goes on with what is left."),
    "stopped.interrupted": ("Interrupted", "Work since the last checkpoint is lost. Resume goes on from there."),
    "unexpected.no_memory": ("The memory is full", "Choose the preset Preview, or smaller photos."),
    "unexpected.job_killed": (
        "The job was ended by {signal}",
        "Press Reconstruct Shelf again. If the memory was full, choose the preset Preview, or smaller photos.",
    ),
    "unexpected.job_not_started": (
        "The job's process could not be started ({reason})",
        "Close other programs, then press Reconstruct Shelf again.",
    ),
    "unexpected.job_crashed": ("The job ended with exit code {exit_code}", "Its log.txt may say why."),
    "unexpected.computer_lost": ("The computer that ran the job was lost", "Press Reconstruct Shelf again."),
}
"""Name of an error -> the panel's (message, hint). Where a text is empty, the panel shows the engine's own."""

CORRECTION_HINTS = {
    "usage.folder_in_use": "Stop it or wait for its end, then press Apply again.",
    "output.disk_full": "Free some space, then press Apply again.",
    "output.not_permitted": "Change its permissions, then press Apply again.",
    "output": "Look whether the folder can be written, then press Apply again.",
    "unexpected.no_memory": "Close other programs, then press Apply again.",
    "stopped.interrupted": "Press Apply again.",
}
"""Name of an error -> the hint while materials are corrected. These stand in the place of the hints of ERRORS, which tell
how to go on with a job."""

CAMERA_HINTS = {
    "output.disk_full": "Free some space, then press the button again.",
    "output.not_permitted": "Change its permissions, or copy the photos to another folder and choose that one.",
    "output": "Look whether the folder can be written, then press the button again.",
    "unexpected.no_memory": "Close other programs, or use smaller photos, then press the button again.",
    "stopped.interrupted": "Press the button again.",
}
"""Name of an error -> the hint while cameras are sought, as CORRECTION_HINTS."""

BATCH_HINTS = {
    "usage.folder_in_use": "Wait for its end, or choose another output folder.",
    "usage.other_version": "Choose another output folder, or choose all captures and Start All Again.",
    "output.disk_full": "Free some space, then press Reconstruct Shelf again: it goes on with what is left.",
    "unexpected.no_memory": "Close other programs, then press Reconstruct Shelf again: it goes on with what is left.",
    "output.not_permitted": "Change its permissions, then press Reconstruct Shelf again.",
    "output": "Look whether the folder can be written, then press Reconstruct Shelf again.",
    "bounds": "Reconstruct this object alone, with bounds of the scene.",
    "stopped.interrupted": "Reconstruct Shelf goes on with what is left.",
}
"""Name of an error -> the hint for a batch, as CORRECTION_HINTS."""

AND_MORE = "{names} and {count} more"
"""How a list of more than MOST_NAMES names is written."""
MOST_NAMES = 5


def texts() -> list[str]:
    """All texts of these tables that a translator translates, each once."""
    errors = (text for pair in ERRORS.values() for text in pair)
    hints = (*CORRECTION_HINTS.values(), *CAMERA_HINTS.values(), *BATCH_HINTS.values())
    return list(dict.fromkeys(text for text in (*MESSAGES.values(), *PARTS.values(), *errors, *hints, AND_MORE) if text))


@dataclass(frozen=True)
class EngineMessage:
    """A message of the engine: a warning, a sentence about the scene, or a note on progress."""

    code: str = ""
    values: dict[str, Any] = field(default_factory=dict)
    message: str = ""
    """The message in the engine's own English."""

    @classmethod
    def of(cls, told: object) -> "EngineMessage":
        """The message that an event, or a part of an event, holds. Older engines send a plain string instead of a dict."""
        if not isinstance(told, dict):
            return cls(message=one_line(told))
        values = told.get("values")
        return cls(str(told.get("code", "")), values if isinstance(values, dict) else {}, one_line(told.get("message", "")))

    def words(self, translate: Translate = str) -> str:
        """The text that the panel shows: the panel's own words, or the engine's where the panel has none."""
        found = self.own_words(translate)
        return found if found is not None else _capitalised(translate(self.message))

    def own_words(self, translate: Translate) -> str | None:
        """The panel's own words for this message; None where the panel has none."""
        return _filled(MESSAGES.get(self.code, ""), self.values, translate)


def error_words(
    name: str,
    values: dict[str, Any],
    message: str,
    hint: str,
    translate: Translate = str,
    hints: Mapping[str, str] = MappingProxyType({}),
) -> tuple[str, str]:
    """(message, hint) that the panel shows for the error `name`.

    `message` and `hint` are the engine's own texts. The panel shows them where it has no words of its own. `hints`, such as
    BATCH_HINTS, stand in the place of the panel's general hints.
    """
    own = ERRORS.get(name, ("", ""))
    own = (own[0], hints.get(name, own[1]))
    filled = (_filled(text, values, translate) for text in own)
    first, second = (
        _capitalised(translate(said)) if text is None else text for text, said in zip(filled, (message, hint), strict=True)
    )
    return first, second


def _capitalised(text: str) -> str:
    return text[:1].upper() + text[1:]


def _filled(template: str, values: dict[str, Any], translate: Translate) -> str | None:
    """A text of the tables with its values filled in; None where there is no text, or where a value is missing."""
    if not template:
        return None
    try:
        return _Formatter(translate).vformat(translate(template), (), values)
    except (LookupError, TypeError, ValueError):
        return None


class _Formatter(string.Formatter):
    """Fills values into a text, by five rules beside those of `str.format`.

    `{count:photo|photos}` gives the first form for 1 and the second for all other numbers. `{parts:parts}` gives a list of
    PARTS in words. A list of names is shortened to MOST_NAMES. A value that is a message itself is put into words. Control
    characters in a text are escaped. The formatter of blender_nep/messages.py has the same rules but the last, but Blender's
    Python cannot import it.
    """

    def __init__(self, translate: Translate):
        self._translate = translate

    def format_field(self, value: Any, format_spec: str) -> str:
        if "|" in format_spec:
            return format_spec.split("|")[value != 1]
        if format_spec == "parts":
            return ", ".join(self._translate(PARTS.get(part, part)) for part in value)
        if isinstance(value, dict):
            said = EngineMessage.of(value)
            found = said.own_words(self._translate)
            return self._translate(said.message) if found is None else found
        if isinstance(value, list):
            names = ", ".join(map(one_line, value[:MOST_NAMES]))
            more = len(value) - MOST_NAMES
            return names if more <= 0 else self._translate(AND_MORE).format(names=names, count=more)
        return super().format_field(one_line(value) if isinstance(value, str) else value, format_spec)
