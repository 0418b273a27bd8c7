"""A viewport that shows the object in the recovered light, and its return to what it showed before.

The viewport's shading is kept in a custom property of its screen, and the visibility of the artist's lamps in one of each
lamp. So both come back also after the file was saved and opened.
"""

import math
from contextlib import suppress

import bpy
from mathutils import Vector

from ...backend.scene_io.data_blocks.selection import kept_selection

LAMP_KEY = "nep_lit_off"  # property of a lamp that `lamps_off` has turned off: [hide_viewport, hide_render] before
SHADING_KEY = "nep_shading"  # property of a screen: number of the area -> the shading before
VIEW = "view"  # in such a shading: location [3], rotation [4], distance, and whether it was a camera's view
ALONE = "alone"  # in such a shading: whether `show_alone` has made the Local View
SHADING_SETTINGS = {
    "SOLID": (),
    "WIREFRAME": (),
    "MATERIAL": ("use_scene_world", "use_scene_lights"),
    "RENDERED": ("use_scene_world_render", "use_scene_lights_render"),
}
"""Type of shading -> the settings that decide whether it shows the scene's own World and lamps."""
ROOM = 1.3  # so much larger than the object is what the viewport shows
SENSOR = 36.0  # half the width of the viewport's sensor in mm: Blender shows twice as much as a camera with the same lens


def lamps_off(scene: bpy.types.Scene) -> int:
    """Turn the scene's lamps off. Returns how many were on. Lamps of linked libraries cannot be turned off."""
    count = 0
    for item in scene.objects:
        if item.type == "LIGHT" and item.is_editable and not (item.hide_viewport and item.hide_render):
            item[LAMP_KEY] = [int(item.hide_viewport), int(item.hide_render)]
            item.hide_viewport = item.hide_render = True
            count += 1
    return count


def lamps_back(scene: bpy.types.Scene) -> None:
    """Turn on again what `lamps_off` has turned off."""
    for item in scene.objects:
        if LAMP_KEY in item:
            item.hide_viewport, item.hide_render = map(bool, item[LAMP_KEY])
            del item[LAMP_KEY]


def show_world(screen: bpy.types.Screen, area: bpy.types.Area) -> None:
    """Let the viewport show the scene's own World: Rendered stays, all other shading becomes Material Preview."""
    shading = area.spaces.active.shading
    key, known = _key(screen, area), dict(screen.get(SHADING_KEY) or {})
    if key not in known:
        settings = [name for names in SHADING_SETTINGS.values() for name in names]
        known[key] = {"type": shading.type} | {name: int(getattr(shading, name)) for name in settings}
        view = area.spaces.active.region_3d
        in_camera = float(view.view_perspective == "CAMERA")
        known[key][VIEW] = [*view.view_location, *view.view_rotation, view.view_distance, in_camera]
        screen[SHADING_KEY] = known
    if shading.type != "RENDERED":
        shading.type = "MATERIAL"
    for name in SHADING_SETTINGS[shading.type]:
        setattr(shading, name, True)


def shading_back(screen: bpy.types.Screen, area: bpy.types.Area) -> None:
    """Give the viewport the shading and the view that it had before `show_world`. A shading that was chosen since stays."""
    known, key = screen.get(SHADING_KEY), _key(screen, area)
    if known is None or key not in known:
        return
    before, shading = known[key].to_dict(), area.spaces.active.shading
    if before.pop(ALONE, 0) and area.spaces.active.local_view is not None:
        _switch_local_view(area)
    if place := before.pop(VIEW, None):
        view = area.spaces.active.region_3d
        view.view_location, view.view_rotation, view.view_distance = place[:3], place[3:7], place[7]
        if place[8]:
            view.view_perspective = "CAMERA"
    if shading.type in ("MATERIAL", "RENDERED"):
        for name, value in before.items():
            setattr(shading, name, value if name == "type" else bool(value))
    del known[key]
    if not known.keys():
        del screen[SHADING_KEY]


def is_shown(screen: bpy.types.Screen, area: bpy.types.Area) -> bool:
    """Whether `show_world` has changed this viewport."""
    return _key(screen, area) in (screen.get(SHADING_KEY) or {})


def _key(screen: bpy.types.Screen, area: bpy.types.Area) -> str:
    return str(list(screen.areas).index(area))


def show_alone(screen: bpy.types.Screen, area: bpy.types.Area, item: bpy.types.Object) -> None:
    """Let the viewport show nothing but the object, by Blender's Local View. A Local View of the artist stays as it is.

    The selection stays. A viewport in which the object is hidden shows all that it has shown.
    """
    if area.spaces.active.local_view is None and item.visible_get():
        with kept_selection() as layer:
            for other in list(layer.objects.selected):
                other.select_set(False, view_layer=layer)
            item.select_set(True, view_layer=layer)
            _switch_local_view(area)
        if area.spaces.active.local_view is not None:
            screen[SHADING_KEY][_key(screen, area)][ALONE] = 1


def _switch_local_view(area: bpy.types.Area) -> None:
    region = next(region for region in area.regions if region.type == "WINDOW")
    window = next(window for window in bpy.context.window_manager.windows if area in window.screen.areas[:])
    with bpy.context.temp_override(window=window, area=area, region=region), suppress(RuntimeError):
        bpy.ops.view3d.localview(frame_selected=False)


def frame_object(area: bpy.types.Area, item: bpy.types.Object) -> None:
    """Let the viewport look at the whole object, from where it looks now. The selection stays."""
    space, region = area.spaces.active, next(region for region in area.regions if region.type == "WINDOW")
    corners = [item.matrix_world @ Vector(corner) for corner in item.bound_box]
    center = sum(corners, Vector()) / len(corners)
    radius = max((corner - center).length for corner in corners)
    narrow = min(region.width, region.height) / max(region.width, region.height, 1)
    half_angle = math.atan(SENSOR / space.lens * (narrow or 1.0))
    view = space.region_3d
    if view.view_perspective == "CAMERA":
        view.view_perspective = "PERSP"
    view.view_location, view.view_distance = center, max(ROOM * radius / math.sin(half_angle), 2 * space.clip_start)


def viewport(context: bpy.types.Context) -> tuple[bpy.types.Screen, bpy.types.Area] | None:
    """The viewport in which a button was pressed, or else the largest one of the window; None without a 3D viewport."""
    screen = context.screen
    if screen is None:
        return None
    if context.area is not None and context.area.type == "VIEW_3D":
        return screen, context.area
    areas = [area for area in screen.areas if area.type == "VIEW_3D"]
    return (screen, max(areas, key=lambda area: area.width * area.height)) if areas else None
