"""The thin sheet that wraps its specimen: finite rotation and stretch."""
