"""Films: whole paths of one person, in which every frame keeps its own posterior."""
