"""A heap on photographs: cut out, levelled, and measured by its flanks."""
