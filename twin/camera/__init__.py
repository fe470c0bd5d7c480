"""EMVA 1288 camera: linear radiance to digital numbers."""

from twin.camera.exposure import Exposed, expose

__all__ = ["Exposed", "expose"]
