"""The scene is frozen: a plane that is found makes a new one, and stage 1 ends the object there."""

import dataclasses

import numpy as np
import pytest

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.training import FieldsLearning
from blender_nep.scene.scene import Scene
from blender_nep.support.plane import Support
from support.brief_preset import brief_preset

PLANE, OTHER = (Support(np.array([0.0, 0.0, 1.0]), height) for height in (-0.3, -0.5))


@pytest.fixture
def scene(make_capture):
    capture = make_capture(masks=True, size=32)
    return Scene.of(PixelRays.from_capture(load_capture(capture.folder), 2_000, True))


def test_a_found_plane_makes_another_scene(scene):
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.support = PLANE
    found = scene.with_support(PLANE)
    assert found.support is PLANE and scene.support is None
    assert found.rays is scene.rays and found.photos is scene.photos and found.photos.masks
    assert found.with_support(None).support is PLANE, "to find nothing takes away nothing"


def test_the_colors_of_a_plane_belong_to_that_plane(scene):
    assert scene.plane_colors is None
    found = scene.with_support(PLANE)
    assert found.plane_colors is found.plane_colors, "they are made once"
    sdf = np.ones((8, 8, 8), np.float32)
    assert found.plane_colors.texture(sdf).support is PLANE
    assert found.with_support(OTHER).plane_colors.texture(sdf).support is OTHER


def test_stage_one_ends_the_object_at_the_plane_of_its_scene(scene):
    known = FieldsLearning(scene.with_support(OTHER), brief_preset(), 0)
    assert known.object_field.support is OTHER
    learning = FieldsLearning(scene, brief_preset(), 0)
    assert learning.object_field.support is None
    learning.stand_on(PLANE)
    assert learning.scene.support is PLANE and learning.object_field.support is PLANE and scene.support is None
    resumed = FieldsLearning(scene, brief_preset(), 0)
    resumed.load(learning.state())
    assert resumed.scene.support.height == resumed.object_field.support.height == PLANE.height
