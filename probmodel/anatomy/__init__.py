"""What anatomy allows: joint limits, bone lengths and torsos, their tables, and the published
ones."""
