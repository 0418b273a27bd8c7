"""Blender extension: glossy objects from photos. Nothing here needs Blender before `register` is called."""


def register():
    from . import addon

    addon.register()


def unregister():
    from . import addon

    addon.unregister()
