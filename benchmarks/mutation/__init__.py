"""Small changes of the physics, one at a time, and the tests that must see them."""
