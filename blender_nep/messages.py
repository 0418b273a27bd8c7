"""The messages of the library to its user: codes with values, and their English words for a terminal.

Warnings, sentences about the scene, reasons for leaving something out, and notes on progress are each a `Message`: a code
and values. Programs read the code and the values. People who read a terminal get the English of `WORDS`. Blender's panel has
words of its own (`backend/engine/words.py`), because an artist has no command line. Errors are not messages: they have their
words with them (`errors.py`).
"""

from __future__ import annotations

import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Part(StrEnum):
    """The parts of a job that it may leave out, with their names in report.json."""

    ENVIRONMENT_FIELD = "environment field"
    COLOR_DETAIL = "color detail of the environment field"
    MASK_TERM = "mask term"
    PIXELS_OUTSIDE = "pixels outside the sphere"
    SURFACE_EXTRACTION = "surface extraction"
    OBJECT_FIELD = "object field"
    IRRADIANCE = "irradiance"
    INDIRECT_LIGHT = "indirect light"
    SECOND_BOUNCES = "second bounces"
    NARROW_CONES = "narrow cones"
    UNSEEN_LIGHT = "unseen light"
    CAMERA_RESPONSE = "camera response"
    OBJECT_GAINS = "object gains"
    PHOTOGRAPHER = "photographer"
    FURTHER_STEPS = "further steps of both fields"
    MATERIAL_BOUNDARIES = "material boundaries"
    VARIED_MATERIALS = "materials that vary from place to place"
    VOTES = "votes of all pixels"
    FINE_TEXTURES = "fine textures"
    METAL_AGAIN = "asking again whether it is metal"
    # refinements of stage 1: their names in `FieldsPreset.without`, too
    SUPPORT = "support"
    HULL = "hull"
    HIDDEN_PIXELS = "hidden_pixels"
    FINE_PAINT = "fine_paint"
    LEVELS = "levels"
    CARVE = "carve"
    CAVITIES = "cavities"
    RELIEF = "relief"
    OBJECT_PIXELS = "object_pixels"
    # evidence of stage 2: its names in `MaterialPreset.without`, too
    RESIDUAL = "residual"
    SPREAD = "spread"
    HUE = "hue"
    THIRD_MOMENT = "third_moment"
    REGIONS = "regions"


@dataclass(frozen=True)
class Message:
    """A code, which has an entry in `WORDS`, and the values that its words name."""

    code: str
    values: Mapping[str, Any] = field(default_factory=dict)
    """Numbers, strings, lists of names, and other messages"""

    def __str__(self) -> str:
        """The words for a terminal. If there are no words for the code (from another version), the code itself."""
        return _FORMATTER.vformat(WORDS[self.code], (), self.values) if self.code in WORDS else self.code

    def state(self) -> dict[str, Any]:
        """The message as plain values, without its words, as it is saved on the disk."""
        return {"code": self.code, "values": {k: _plain(v, Message.state) for k, v in self.values.items()}}

    @classmethod
    def from_state(cls, state: Mapping[str, Any]) -> Message:
        """The inverse of `state`, for messages whose values are not messages themselves."""
        return cls(state["code"], state["values"])

    def to_dict(self) -> dict[str, Any]:
        """The message as plain values for events and reports: `code`, `values`, and the words as `message`."""
        values = {k: _plain(v, Message.to_dict) for k, v in self.values.items()}
        return {"code": self.code, "values": values, "message": str(self)}


def _plain(value: Any, of_message: Any) -> Any:
    return of_message(value) if isinstance(value, Message) else value


def shortened(names: Sequence[str], most: int = 5) -> str:
    """The first few names, and how many more there are."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


class _Formatter(string.Formatter):
    """str.format with two additional specifications.

    `{count:photo|photos}` gives the first form for 1 and the second form for other numbers, without the number.
    `{parts:parts}` gives a list of parts in plain words. A list of names is shortened.
    """

    def format_field(self, value: Any, spec: str) -> str:
        if "|" in spec:
            return spec.split("|")[value != 1]
        if spec == "parts":
            return ", ".join(PARTS.get(part, part) for part in value)
        if isinstance(value, list | tuple):
            return shortened(value)
        return super().format_field(value, spec)


_FORMATTER = _Formatter()

PARTS: dict[str, str] = {
    Part.ENVIRONMENT_FIELD: "the surroundings",
    Part.COLOR_DETAIL: "fine detail of far surroundings",
    Part.MASK_TERM: "comparing with masks",
    Part.PIXELS_OUTSIDE: "pixels beside the object's sphere",
    Part.SURFACE_EXTRACTION: "making a mesh",
    Part.OBJECT_FIELD: "learning the shape",
    Part.IRRADIANCE: "diffuse light",
    Part.INDIRECT_LIGHT: "reflections of the object in itself",
    Part.SECOND_BOUNCES: "light that the object reflects twice",
    Part.NARROW_CONES: "sharp reflections",
    Part.UNSEEN_LIGHT: "light that no photo shows",
    Part.CAMERA_RESPONSE: "the camera's tone curve",
    Part.OBJECT_GAINS: "evening out how bright the object is from photo to photo",
    Part.PHOTOGRAPHER: "the photographer in the reflections",
    Part.FURTHER_STEPS: "the rest of learning shape and light",
    Part.MATERIAL_BOUNDARIES: "boundaries between materials",
    Part.VARIED_MATERIALS: "materials that vary from place to place",
    Part.VOTES: "finding the material of every pixel",
    Part.FINE_TEXTURES: "fine textures",
    Part.METAL_AGAIN: "checking again whether the object is metal",
    Part.SUPPORT: "finding the table",
    Part.HULL: "starting from the outline in all photos",
    Part.HIDDEN_PIXELS: "finding things before the object",
    Part.FINE_PAINT: "fine paint",
    Part.LEVELS: "a finer grid for the shape",
    Part.CARVE: "cutting away what is not the object",
    Part.CAVITIES: "opening the inside",
    Part.RELIEF: "fine relief",
    Part.OBJECT_PIXELS: "finding the pixels of the object",
    Part.RESIDUAL: "what materials leave unexplained",
    Part.SPREAD: "how much the light of a metal varies",
    Part.HUE: "the hue of reflections",
    Part.THIRD_MOMENT: "the reflections of colored paint",
    Part.REGIONS: "what small places tell of metal and paint",
}
"""{part: its name in sentences for people}"""

WORDS: dict[str, str] = {
    # cameras that were found from photos alone
    "cameras.video": "taking frames from the video ({percent:.0f} %)",
    "cameras.video_frames": "{count} of the {frames} frames of {video} became photos. Most cameras read the rows of a frame "
    "one after the other, which bends what moves: film slowly; photos give better cameras",
    "cameras.video_fast": "the camera moved fast: in many frames, the picture moves by {percent:.0f} % of its width in a "
    "second. Such frames are blurred and bent. Film more slowly",
    "cameras.video_damaged": "{count} of {frames} frames of the video cannot be read. It may be damaged, or not copied to "
    "its end",
    "cameras.video_interlaced": "the video is interlaced: each frame shows two moments. Film progressively (such as 30p), "
    "or deinterlace the video first",
    "cameras.video_hdr": "the video is HDR (HLG): its curve was undone as the standard says, but what the camera did to the "
    "contrast remains. Film without HDR, if you can",
    "cameras.photos": "reading photo {step} of {steps}",
    "cameras.surroundings": "looking for surroundings that stand still: {percent:.0f} %",
    "cameras.features": "finding features in photo {step} of {steps}",
    "cameras.matches": "comparing photos: pair {step} of {steps}",
    "cameras.places": "placing photo {step} of {steps}",
    "cameras.placed": "{count} of {photos} photos were placed; their features agree within {error:.2f} pixels",
    "cameras.turntable": "in {percent:.0f} % of the photos the surroundings stand still: taken as a turntable, so only "
    "features on what turned were used",
    "cameras.by_masks": "only features on the object of the masks were used, because those on the surroundings contradict "
    "them. The object may have turned on a turntable",
    "cameras.turntable_shifted": "in {percent:.0f} % of the photos the surroundings stand still, but shifted. "
    "Features on them were used, too. If the object turned on a turntable, put masks of the object into PHOTOS/masks, and "
    "give --turntable yes",
    "cameras.turntable_unsure": "in {percent:.0f} % of the photos the surroundings stand still, but the cameras that were "
    "found move. If the object turned on a turntable, put masks of the object into PHOTOS/masks. If you walked around "
    "the object, give --turntable no",
    "cameras.sure": "the cameras look right",
    "cameras.not_placed": "{count} {count:photo was|photos were} not placed, because {count:it shares|they share} too few "
    "points with the others: {names}. Take more photos in between, or leave {count:it|them} out",
    "cameras.many_not_placed": "only {count} of {photos} photos were placed, so a part of the object may be missing. The "
    "others share too few points with them: {list}. Take more photos in between, or take these out of the folder if the "
    "placed ones show the whole object",
    "cameras.next_way": "{count} of {photos} photos are placed so far: trying another way, which takes longer",
    "cameras.way_all_pairs": "the second way found them: finer features, and all photos compared with each other",
    "cameras.way_affine": "the third way found them: features of surfaces that are seen at a grazing angle",
    "cameras.groups": "the photos fall into {count} groups that share no points; the largest one is used. Take photos "
    "between the groups",
    "cameras.unsure": "the {count:place of this photo is|places of these photos are} unsure: {names}. Look whether "
    "{count:it is|they are} blurred, zoomed or cropped, or take more photos near {count:it|them}",
    "cameras.gap": "there is no photo within {degrees:.0f} degrees around the object, between {before} and {after}. Take "
    "some from there, if you can",
    "cameras.sphere": "looking for the object",
    "cameras.sphere_unsure": "the object's place and size are a guess. Look whether the sphere "
    "(object_center, object_radius) holds the whole object",
    "cameras.good_as_given": "the given cameras are kept: their features agree within {error:.2f} pixels, which cannot be "
    "improved",
    "cameras.improved": "the cameras were improved: their features agree within {after:.2f} pixels instead of "
    "{before:.2f}. They were turned by {degrees:.3f} degrees and moved by {percent:.2f} % of their distance (medians)",
    "cameras.backup": "the cameras that were replaced are kept in {file}",
    "cameras.kept": "{count} {count:photo shows|photos show} too few points of the scene, and {count:keeps its|keep their} "
    "given {count:camera|cameras}: {names}",
    # warnings about a capture
    "capture.photos_rescaled": "{count} {count:photo differs|photos differ} in size from the declared w x h (same aspect; "
    "intrinsics rescaled): {names}",
    "capture.frames_twice": "{count} {count:photo is|photos are} listed twice with the same camera: {names}",
    "capture.cameras_in_object": "{count} {count:photo is|photos are} left out: {count:its camera stands|their cameras "
    "stand} where the object is, as if no place had been found: {names}",
    "capture.two_forms": "{place} holds the model as binary and as text, and they differ: {used} counts ({photos} photos). "
    "Delete the other one, or the wrong one",
    "capture.photos_without_pose": "{count} {count:photo is|photos are} left out, because {count:it has|they have} no "
    "camera pose or {count:is|are} disabled: {names}",
    "capture.angles_disagree": "camera_angle_y (or y_fov) of {count} {count:photo|photos} does not fit camera_angle_x: "
    "pixels would be no squares. It is not used: {names}",
    "capture.focal_lengths_differ": "the lens of {count} {count:photo|photos} looks wrong: fl_x and fl_y differ by "
    "{percent:.0f} % ({names}). Look whether the cameras are right",
    "capture.principal_point_off": "the lens of {count} {count:photo|photos} looks wrong: the principal point is at "
    "{across:.0f} % of the width and {down:.0f} % of the height ({names}). If the photos were not cropped, look whether the "
    "cameras are right",
    "capture.distortion_large": "the lens of {count} {count:photo|photos} looks wrong: its distortion is larger than that "
    "of usual lenses ({names}). Look whether the cameras are right",
    "capture.view_angle_odd": "the lens of {count} {count:photo|photos} looks wrong: its angle of view is {degrees:.1f} "
    "degrees ({names}). Look whether the focal length is right, in pixels of the declared size",
    "capture.skew_large": "the lens of {count} {count:photo|photos} looks wrong: its pixels are skewed by {percent:.1f} % "
    "({names}). Look whether the cameras are right",
    "capture.cameras_scaled": "transform_matrix of {count} {count:photo|photos} scales: only its rotation and its "
    "position are used ({names})",
    "capture.cameras_transposed": "the rows and columns of transform_matrix are swapped: it is read that way",
    "capture.world_to_camera": "transform_matrix leads from the world to the camera, and is read so: the cameras fit each "
    "other and the photos better then",
    "capture.rotations_turned": "the rotations of transform_matrix lead from the world to the camera, and are read so: "
    "the cameras fit each other and the photos better then",
    "capture.opencv_axes": "the cameras have OpenCV's axes (y down, looking along +z), and are read so: they fit each "
    "other and the photos better then",
    "capture.mitsuba_axes": "the cameras have Mitsuba's axes (x left, y up, looking along +z), and are read so: they fit "
    "each other and the photos better then",
    "capture.opengl_axes": "the cameras have OpenGL's axes (y up, looking down -z) although from_mitsuba is true, and are "
    "read so: they fit each other and the photos better then",
    "capture.realityscan_angles": "the angles in {file} are not those of RealityScan. They are read so that all cameras "
    "look at one place, with the tops of the photos up",
    "capture.cameras_of_upright": "the {count:camera is for a photo that EXIF turns|cameras are for photos that EXIF "
    "turns} upright, and {count:was|were} turned to the pixels as the file stores them: {names}",
    "capture.brackets": "the {photos} photos seem to be brackets of {size} exposures each, {stops:.1f} stops apart: merge "
    "each bracket to one photo (OpenEXR), or leave only one exposure of each",
    "capture.photos_missing": "{count} of {photos} photos {count:is|are} missing and {count:is|are} left out: {names}",
    "capture.several_models": "the COLMAP project has {models} models: only the largest, {place}, with "
    "{photos} {photos:photo|photos} is used; {others} {others:photo is|photos are} in the others",
    "capture.masks_unmatched": "a folder of masks holds images, but none has the name of a photo (such as {example}): "
    "no masks are used",
    "capture.masks_found": "{count} of {photos} photos have a mask in {place}. No file names "
    "{count:this mask|these masks}. --masks ignore leaves masks out",
    "capture.masks_beside": "{count} of {photos} photos have a mask beside them. No file names "
    "{count:this mask|these masks}. --masks ignore leaves masks out",
    "capture.masks_other_size": "{count} {count:mask has|masks have} another size than {count:its photo|their photos}, and "
    "{count:is|are} not used: {names}. Save {count:it|them} with the size of {count:its photo|their photos}",
    "capture.masks_dim": "no value in the masks is above {percent:.2g} % of white: that value counts as white",
    "capture.masks_background": "white in the masks covers the surroundings, and black the object: the masks are "
    "inverted. If white is the object, give --masks object",
    "capture.masks_turned": "{count} {count:mask is|masks are} black where the others are white, "
    "and {count:is|are} inverted: {names}",
    "capture.masks_labels": "the masks show {count} things in different colors: the color where the cameras look "
    "({color}) is taken as the object, and all others as its surroundings. If that is wrong, save masks whose white is the "
    "object",
    "capture.masks_pictures": "the masks are pictures before one color ({color}): what has another color is taken as the "
    "object. Masks in black and white are more exact",
    "capture.masks_colors_unclear": "the masks are colored, and no color covers the borders: only their red channel "
    "counts. Save masks whose white is the object",
    "capture.alpha_inverted": "the photos are transparent where the object is: their alpha is inverted, and the photos "
    "count as whole ones. If that is wrong, give --masks object",
    "capture.masks_do_not_fit": "the masks are not used: seen from the places of their cameras, they show no common body "
    "(it would explain {percent:.0f} % of a mask). Look whether each mask is that of its photo. To use them all the same, "
    "give --masks object",
    "capture.masks_hardly_fit": "the masks hardly fit each other: seen from the places of their cameras, a common body "
    "explains {percent:.0f} % of a mask. Look whether each mask is that of its photo, and whether the cameras are right",
    "capture.masks_full": "{count} {count:photo is|photos are} left out: {count:its mask is|their masks are} white "
    "everywhere ({names})",
    "capture.alpha_usable": "the transparent pixels of the photos are not their surroundings: they ({percent:.1f} % of a "
    "photo) are left out, and the object is found without masks. If alpha shows the object, give --masks object",
    "capture.masks_rescaled": "{count} {count:mask has|masks have} another size than {count:its photo|their photos}, with "
    "the same aspect, and {count:is|are} scaled: {names}",
    "capture.masks_other_kind": "the files in {place} cannot be read as masks ({kinds}): save them as PNG",
    "capture.masks_usable": "white in the masks is not the object but what may be used: the black pixels ({percent:.1f} % "
    "of a photo) are left out, and the object is found without masks. If white is the object, give --masks object",
    "capture.masks_not_used": "the masks are not used: {percent:.0f} % of a photo is black, and white does not show the "
    "object. If white is the object, give --masks object",
    "capture.masks_white": "the masks are not used: they are white everywhere, so they do not show the object",
    "capture.masks_one_for_all": "all photos have the same mask, so it cannot show the object",
    "capture.masks_alike": "all masks are the same picture: look whether they show the object. If they do not, give "
    "--masks usable or --masks ignore",
    "capture.masks_unclear": "it is not clear what white in the masks means ({percent:.0f} % of a photo): it is taken as "
    "the object. Otherwise give --masks background, usable or ignore",
    "capture.masks_doubtful": "the masks are not used: white covers {percent:.0f} % of a photo and is not the object, and "
    "black may be the object or not. Say what white means: --masks background or --masks usable",
    "capture.masks_as_told": "white in the masks means {meaning}, because --masks says so. The masks look otherwise",
    "capture.same_place": "{count} {count:photo was|photos were} taken from the same place in the same direction as others "
    "and {count:adds|add} nothing to the shape: {names}",
    "capture.exr_is_linear": "OpenEXR photos are taken as linear, although color_space says srgb",
    "capture.half_a_sphere": "object_center and object_radius work only together: the one that is given is ignored",
    "capture.masks_disagree": "the masks contradict each other: the object's sphere is estimated from the cameras",
    "capture.sphere_not_seen": "{count} of {photos} photos {count:does|do} not see the object's sphere: {names}",
    "capture.cameras_far": "the cameras are {radii:.0f} object radii away: the object covers few pixels (is object_radius "
    "too small?)",
    "capture.sphere_cut": "most photos see less than half of the object's sphere (is object_radius too large?)",
    "capture.exposure_unclear": "the photos may differ in exposure, but show too little of the same surroundings to tell: "
    "if the camera was on automatic, take or develop them with one exposure",
    "capture.exposure_guessed": "the exposure of {count} {count:photo|photos} is a guess: {count:it shows|they show} hardly "
    "any of the surroundings that others show",
    "capture.pixels_not_finite": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:is|are} NaN or "
    "Inf and {pixels:is|are} left out: {names}",
    "capture.pixels_negative": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:is|are} negative "
    "and {pixels:is|are} taken as 0: {names}",
    "capture.pixels_too_bright": "{pixels} {pixels:pixel|pixels} in {photos} {photos:photo|photos} {pixels:is|are} brighter "
    "than {limit:.0f} and {pixels:is|are} set to that value: {names}",
    "capture.photos_black": "{count} {count:photo is|photos are} black and {count:is|are} left out: {names}",
    "capture.photos_reduced": "there are {photos} photos: each is scaled down to {pixels} pixels, because all photos "
    "together may have {limit}",
    "capture.masks_missing": "masks are not used: {count} {count:photo has|photos have} none ({names})",
    "capture.alpha_for_mask": "{count} {count:photo has|photos have} no mask, unlike the others: {count:its|their} alpha is "
    "the mask ({names})",
    "capture.masks_lacking": "{count} {count:photo is|photos are} left out: {count:it has|they have} no mask, unlike the "
    "others ({names})",
    "capture.masks_empty": "{count} {count:photo is|photos are} left out: {count:its mask shows|their masks show} nothing "
    "({names})",
    "capture.cut_outs_need_masks": "the photos are cut-outs (alpha) and their surroundings are black; results need the "
    "masks",
    "capture.few_photos": "only {photos} photos: 20 and more give a better shape",
    "capture.few_directions": "the cameras cover few directions: what no photo shows will be guessed",
    "capture.hole_above": "no photo was taken within {degrees:.0f} degrees of straight above",
    "capture.hole_below": "no photo was taken within {degrees:.0f} degrees of straight below",
    "capture.hole_beside": "no photo was taken within {degrees:.0f} degrees of azimuth {azimuth:.0f}, elevation "
    "{elevation:.0f}: take some between {before} and {after}",
    "capture.photos_blurred": "{count} {count:photo is|photos are} clearly more blurred than the photos beside "
    "{count:it|them}: {names}. Leave {count:it|them} out or take {count:it|them} again",
    "capture.other_light": "{count} {count:photo was|photos were} taken in another light than the others, and "
    "{count:is|are} left out: {names}. To learn from them all the same, give --all-photos",
    "capture.photos_darker": "{count} {count:photo is|photos are} up to {stops:.1f} stops darker than the others: {names}. "
    "Develop all photos with one exposure, or leave {count:it|them} out",
    "capture.photos_brighter": "{count} {count:photo is|photos are} up to {stops:.1f} stops brighter than the others: "
    "{names}. Develop all photos with one exposure, or leave {count:it|them} out",
    "capture.sphere_clipped": "{percent:g} % of the pixels around the object are burnt out (clipped): expose less, or take "
    "photos with a larger range (raw, OpenEXR)",
    "capture.cameras_look_away": "the object's center is not in the picture of {count} {count:photo|photos}: {names}. Look "
    "whether {count:its camera is|their cameras are} right",
    "capture.cameras_near": "{count} {count:camera stands|cameras stand} much nearer to the object than the others: "
    "{names}. Look whether {count:its place is|their places are} right",
    "capture.cameras_distant": "{count} {count:camera stands|cameras stand} much farther from the object than the others: "
    "{names}. Look whether {count:its place is|their places are} right",
    "capture.sphere_small": "the object's sphere is only about {pixels:.0f} pixels wide in the photos: go nearer, use "
    "larger photos, or make object_radius smaller if the object is smaller",
    "capture.sphere_at_edges": "{percent:.0f} % of the photos cut off a part of the object's sphere: if object_radius is "
    "not too large, step back, so that the photos show the whole object and its surroundings",
    "capture.on_turntable": "in {percent:.0f} % of the photos the surroundings stand still although the cameras differ: "
    "taken as a turntable, on which the object turned. If you walked around the object, give --turntable no",
    "capture.turntable_side": "the capture does not say how far the turntable had turned between the {rows} places of the "
    "camera: they are taken to be on the same side of the object. If they were not, write 'turn' into transforms.json",
    "capture.turntable_unfit": "the cameras do not fit a turntable, so a job would end: {reason}. If you walked around the "
    "object, give --turntable no",
    "capture.turntable_left_out": "{count} {count:photo was|photos were} left out, because the camera did not stand still "
    "for at least 3 photos: {names}",
    "capture.highlights_clipped": "8-bit photos clip highlights: mirror-like parts will come out darker than they are",
    "capture.cut_outs": "cut-outs show no surroundings: light can be learned from reflections alone",
    # warnings of a job
    "job.preview_ended": "there is no live preview any more: {reason}",
    "job.run_file_damaged": "checkpoints/run.json is damaged: the run starts from its beginning",
    "job.result_damaged": "{file} cannot be used: {reason}; its stage is done again",
    "job.checkpoint_damaged": "checkpoint {file} cannot be used: {reason}",
    "job.steps_left_out": "{count} {count:step|steps} of fields learning {count:was|were} left out: the loss or the "
    "gradient was not finite",
    "job.cut_by_sphere": "the object reaches out of its sphere and is cut there ({percent:.0f} % of the surface is the "
    "cut): make object_radius larger, or move object_center",
    "job.metal_unclear": "the photos hardly show whether the object is metal: if the result is wrong, choose --metal yes "
    "or --metal no",
    "job.photos_not_explained": "the asset does not explain its photos: {decibels:.1f} dB, and hues differ by "
    "{degrees:.1f} degrees. A usable one has at least {least:.0f} dB, and at most {most:.0f} degrees: shape, materials or "
    "light are wrong. Look at it beside its photos. Were all of them taken in one light? Then try --preset balanced, or "
    "masks",
    "job.surroundings_not_explained": "the recovered light explains what the photos show beside the object to "
    "{decibels:.1f} dB only, and {least:.0f} dB is the least that usable light has: do not trust the materials. Were all "
    "photos taken in one light, and did nothing move? Look whether the cameras are right",
    # what a batch says
    "batch.looking": "looking at capture {step} of {steps}",
    "batch.passed_over": "{count} {count:folder is|folders are} passed over, because {count:it holds|they hold} neither a "
    "capture nor photos (in itself or in images): {names}",
    "batch.captures_beside_photos": "{count} {count:folder with a capture or photos is|folders with captures or photos "
    "are} passed over, because the folder around {count:it|them} holds photos itself: name {count:it|them}, too ({names})",
    "batch.photos_deeper": "there are photos in {names}. Name {count:that folder|these folders}, or find their cameras "
    "first: {command}",
    "batch.progress": "{done} of {objects} done, {running} running, {waiting} waiting, {failed} failed",
    "batch.object_done": "{name}: done in {time}, {faces} faces, {materials} {materials:material|materials}",
    "batch.object_failed": "{name}: failed: {reason}",
    "batch.object_stopped": "{name}: stopped",
    "batch.tried_again": "{name}: {reason}; it is tried again",
    "batch.alone": "{name} may need {needed} MB, and there are {memory} MB: it runs alone. If it fails, try --preset "
    "preview or smaller photos",
    "batch.put_back": "{name} is put back and waits for its turn, because another object needs more memory than expected",
    "batch.leftovers": "{count} {count:job|jobs} of a batch that was killed {count:is|are} still writing "
    "{count:its checkpoint|their checkpoints}: waiting for {count:its|their} end",
    "batch.no_gallery": "the gallery cannot be written: {reason}. Write it later with blender-nep gallery",
    "batch.stopping": "stopping: {count} {count:job writes its checkpoint|jobs write their checkpoints}",
    # notes on progress
    "progress.warming_up": "warming up",
    # sentences about the scene
    "scene.surroundings": "The photos ({photos}) show the object among its surroundings, which are learned as its light.",
    "scene.cut_outs": "The photos ({photos}) are cut-outs: the light is learned from the object's reflections alone.",
    "scene.turntable": "The object turned, and the camera and the light stood still. environment.exr is the light around "
    "the object as it stood in the first photo.",
    "scene.masks_used": "Masks are there and are used.",
    "scene.masks_not_used": "No masks are used: the object is where the photos do not look like its surroundings.",
    "scene.object_clipped": "{percent:g} % of the object's pixels are burnt out (clipped) and say nothing about the "
    "material.",
    "scene.sphere_clipped": "{percent:g} % of the pixels around the object are burnt out (clipped) and say nothing about "
    "the material.",
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
    "scene.explains_photos": "The asset explains its photos to {decibels:.0f} dB; hues differ by {degrees:.0f} degrees.",
    "scene.explains_held_out": "The asset explains held-out photos to {decibels:.0f} dB; hues differ by "
    "{degrees:.0f} degrees.",
    "scene.surroundings_explained": "The recovered light explains what they show beside the object to {decibels:.0f} dB.",
    "scene.left_out": "Left out: {parts:parts}, because {reason}.",
    "scene.left_out_saving": "Left out: {parts:parts}, because {reason} (saves about {seconds:.0f} s).",
    "scene.acted": "Improved by: {parts:parts}.",
    # reasons for leaving something out
    "reason.cut_outs": "the photos are cut-outs",
    "reason.near_surroundings": "the surroundings are near",
    "reason.metal": "the object is metal",
    "reason.convex": "the object is convex",
    "reason.reflects_little_in_itself": "the object hardly reflects in itself",
    "reason.matte": "the object is matte and mirrors nothing",
    "reason.masks_ignored": "masks are ignored (--masks ignore)",
    "reason.no_masks": "the capture has no masks",
    "reason.sphere_fills_photos": "the sphere fills all photos",
    "reason.mesh_given": "a mesh was given (--mesh)",
    "reason.plateaued": "the error on held-out pixels did not fall any more",
    "reason.palette_explains": "a few materials explain the photos",
    "reason.one_material": "one material explains the photos",
    "reason.metal_known": "the photos have already decided it clearly",
    "reason.light_seen": "the photos show all light that matters",
    "reason.preset": "turned off by the preset",
    "reason.class_chosen": "it was chosen whether the object is metal (--metal)",
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
