"""How similar two fingers are: the thesis's matcher, and a better one on ridge templates."""
