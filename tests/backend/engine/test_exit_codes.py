"""Blender's side repeats some exit codes of the library, which its Python does not import."""

from backend.engine import exit_codes, install
from blender_nep import errors


def test_the_codes_are_those_of_the_library():
    assert exit_codes.NO_ENGINE == errors.UsageError.code
    assert exit_codes.OUTPUT_FAILED == errors.OutputError.code
    assert exit_codes.OBJECTS_FAILED == errors.ObjectsFailed.code
    assert exit_codes.STOPPED == install.CANCELLED == errors.Stopped.code


def test_blenders_own_code_is_none_of_the_librarys():
    kinds = [errors.NepError, *errors.NepError.__subclasses__()]
    assert exit_codes.BLENDER_FAILED not in {kind.code for kind in kinds}
