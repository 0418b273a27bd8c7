"""The material of a part of an object, as plain values."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Substance:
    """The material of a part of the object: Base Color (linear), roughness and metallic of the Principled BSDF."""

    color: tuple[float, float, float]
    roughness: float
    metallic: float
