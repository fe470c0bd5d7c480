"""The built-in colour maps, see `reconstruction.colour_maps`."""
