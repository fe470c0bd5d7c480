"""Scenes of a coated face whose rays are intersected, never marched over heights."""


def coated_scene(experiment, face):
    """Return the scene of the coated face only, in the experiment's own coat.

    Raises InputError if the face pokes through the layers that it is seen through.
    """
    # Imports Mitsuba: its variant is set by the fixture `mi`.
    from twin.optics.scene import CoatedScene, check_below_layers, coating_in_layer

    check_below_layers(experiment.layers, face)
    return CoatedScene(face, coating_in_layer(experiment).bsdf())
