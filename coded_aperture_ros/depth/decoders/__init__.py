"""From the cost volume to the level of every pixel, with its deviation and confidence."""
