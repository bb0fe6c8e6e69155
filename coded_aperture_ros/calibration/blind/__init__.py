"""Finding an unknown mask from pictures of planes at unknown distances."""
