"""What is frozen: the targets, the anatomy they share, and what is known of them exactly."""
