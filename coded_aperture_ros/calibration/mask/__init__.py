"""Which mask made the blur: recognised among known ones, or found."""
