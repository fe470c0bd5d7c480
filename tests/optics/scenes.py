"""Scenes of a coated face with a tree of facets: rays are not marched over heights."""


def coated_scene(experiment, face):
    """Return the scene of the coated face only, in the experiment's own coat.

    Raises InputError if the face protrudes from the layers above it.
    """
    # Imports Mitsuba: its variant is set by the fixture `mi`.
    from twin.optics.scene import CoatedScene, check_below_layers, coating_in_layer

    check_below_layers(experiment.layers, face)
    return CoatedScene(face, coating_in_layer(experiment).bsdf())
