"""The paper's stages as pure functions on arrays: no clock, thread, file, socket or behaviour tree."""
