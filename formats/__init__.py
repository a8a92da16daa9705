"""Animations in the formats of others and in our own: `formats.save` writes all of them, the readers are beside it."""
